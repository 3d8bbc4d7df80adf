"""Figures of results, evaluations and comparisons."""
