"""`posegsa configs` and `posegsa config show`."""

import argparse

from posegsa.config import shipped


def run(options: argparse.Namespace) -> int:
    """List the names with a line each, or print the one that is named."""
    if options.name is not None:
        print(shipped.find(options.name).read_text("utf-8"), end="")
        return 0
    names = shipped.names()
    width = max(map(len, names))
    for name in names:
        print(f"{name.ljust(width)}  {shipped.about(name)}")
    return 0
