"""A parser whose help may end with words that are only worked out when it is shown."""

import argparse
from collections.abc import Callable


class Parser(argparse.ArgumentParser):
    """As `argparse.ArgumentParser`; its epilog may be a function that returns the text."""

    epilog: str | Callable[[], str] | None

    def format_help(self) -> str:
        """The whole help."""
        if callable(self.epilog):
            self.epilog = self.epilog()
        return super().format_help()
