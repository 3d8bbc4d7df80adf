"""The parser of the command line and of each command. A command reports its own errors."""

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from typing import IO, Any, NoReturn

from posegsa.words import meant


class Parser(argparse.ArgumentParser):
    """An `argparse.ArgumentParser` whose errors show the usage of the command concerned.

    The error about an unknown option or choice suggests the most similar one. If the help can't be
    written, this is an error too.
    """

    late_epilog: Callable[[], str] | None = None
    """Makes the epilogue of the help. Called only when help is shown, because its imports are
    slow."""

    def format_help(self) -> str:
        """The help, followed by its epilogue."""
        if self.late_epilog is not None:
            self.epilog = self.late_epilog()
        return super().format_help()

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:
        """Parse all arguments. Unknown ones are refused here, so that a command shows its usage."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            option = next((one for one in unknown if one.startswith("-")), "")
            similar = meant(option.partition("=")[0], self._options())
            self.error(f"unrecognized arguments: {' '.join(unknown)}{similar}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Show usage and message, with the most similar choice if one is invalid."""
        if found := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            message += meant(found[1], re.findall(r"[\w-]+", found[2]))
        super().error(message)

    def _options(self) -> list[str]:
        return [name for action in self._actions for name in action.option_strings]

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        stream = file or sys.stderr
        if message and stream is not None:
            stream.write(message)
