"""Recorded motion: read, checked, started, run and compared with its reference."""
