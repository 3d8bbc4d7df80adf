"""The parser of the command line and of each command."""

import argparse
import sys
from typing import IO


class Parser(argparse.ArgumentParser):
    """As `argparse.ArgumentParser`, but help that can't be written is an error."""

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        stream = file or sys.stderr
        if message and stream is not None:
            stream.write(message)
