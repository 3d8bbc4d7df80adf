"""`posegsa configs` and `posegsa config show`."""

import argparse

from posegsa.config import shipped
from posegsa.errors import ArgumentError


def add(commands) -> None:
    """Add the two commands to the others."""
    parser = commands.add_parser(
        "configs",
        help="list the configurations that come with posegsa",
        description="Lists the configurations that come with posegsa. Other commands take their "
        "names instead of a file.",
    )
    parser.set_defaults(command=run, name=None)
    parser = commands.add_parser(
        "config",
        help="print one of these configurations",
        description="Prints a configuration that comes with posegsa, to read it or to start from "
        "it: `posegsa config show quick > mine.toml`. Keys of [filter] that it leaves out are "
        "shown with their defaults, meanings and units.",
        usage="posegsa config [show] NAME",
    )
    parser.add_argument("name", metavar="NAME", nargs="+", help="a name from `posegsa configs`")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> int:
    """List the configurations, a line for each, or print the named one."""
    if options.name is not None:
        name, *more = options.name[options.name[0] == "show" :] or [""]
        if more or not name:
            raise ArgumentError(f"{' '.join(options.name)}; allowed: posegsa config [show] NAME")
        text = shipped.find(name).read_text("utf-8")
        from posegsa.config.defaults_shown import with_defaults_shown
        from posegsa.config.toml_files import load

        print(with_defaults_shown(text, load(name)), end="")
        return 0
    names = shipped.names()
    width = max(map(len, names))
    for name in names:
        print(f"{name.ljust(width)}  {shipped.about(name)}")
    return 0
