"""The parser of the command line and of each command: what is wrong is said where it is wrong."""

import argparse
import difflib
import sys
from collections.abc import Callable, Sequence
from typing import IO, Any


class Parser(argparse.ArgumentParser):
    """As `argparse.ArgumentParser`, but what is wrong is said by the command that it is wrong for.

    Of an option that is not known, the nearest one is named. Help that can't be written is an
    error.
    """

    late_epilog: Callable[[], str] | None = None
    """Makes what ends the help, called only when help is shown, as what it imports takes long."""

    def format_help(self) -> str:
        """The help, its end included."""
        if self.late_epilog is not None:
            self.epilog = self.late_epilog()
        return super().format_help()

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:
        """Parse all arguments: none may be unknown, so that a command shows its own usage."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            option = next((one for one in unknown if one.startswith("-")), "")
            near = difflib.get_close_matches(option.partition("=")[0], self._options(), 1)
            meant = f"; did you mean {near[0]}?" if near else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")
        return found, unknown

    def _options(self) -> list[str]:
        return [name for action in self._actions for name in action.option_strings]

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        stream = file or sys.stderr
        if message and stream is not None:
            stream.write(message)
