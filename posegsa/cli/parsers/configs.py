"""What can be typed after `posegsa configs` and `posegsa config`."""


def add(commands) -> None:
    """Add the commands to the others."""
    parser = commands.add_parser(
        "configs",
        help="list the configurations that come with posegsa",
        description="Lists the configurations that come with posegsa, by the names that other "
        "commands take instead of a file.",
    )
    parser.set_defaults(command="configs", name=None)
    parser = commands.add_parser(
        "config",
        help="print one of them",
        description="Prints a configuration that comes with posegsa, to read or to begin from: "
        "`posegsa config show quick > mine.toml`.",
    )
    parser.add_argument("show", choices=["show"])
    parser.add_argument("name", metavar="NAME", help="what `posegsa configs` lists")
    parser.set_defaults(command="configs")
