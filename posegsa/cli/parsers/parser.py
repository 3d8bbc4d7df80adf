"""The parser of the command line and of each command."""

import argparse
import sys
from collections.abc import Callable
from typing import IO


class Parser(argparse.ArgumentParser):
    """As `argparse.ArgumentParser`, but for two things.

    Its epilog may be a function that returns the text, called when the help is shown. And help that
    can't be written is an error.
    """

    epilog: str | Callable[[], str] | None

    def format_help(self) -> str:
        """The whole help."""
        if callable(self.epilog):
            self.epilog = self.epilog()
        return super().format_help()

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        stream = file or sys.stderr
        if message and stream is not None:
            stream.write(message)
