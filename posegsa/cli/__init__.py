"""The command line."""

from posegsa.cli.command import main

__all__ = ["main"]
