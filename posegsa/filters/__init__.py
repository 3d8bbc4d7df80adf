"""Filters, each a file, and the one loop that runs them all (`rollout`)."""
