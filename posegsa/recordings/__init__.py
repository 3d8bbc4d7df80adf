"""Recorded motion: reading, checking, initial estimates, running filters, errors."""
