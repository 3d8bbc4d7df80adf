"""`python -m posegsa`."""

from posegsa.cli.command import entry

entry()
