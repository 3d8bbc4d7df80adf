"""The command line."""

from posegsa.cli.command import entry, main

__all__ = ["entry", "main"]
