"""What can be typed after `posegsa replay`."""

from posegsa.cli.parsers.arguments import RECORDING, add_bridge, add_figures, add_imu, add_window


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "replay",
        help="run a tuned filter over recordings",
        description="Runs the filter of a finished run over recordings and, where they have a "
        "reference, shows its errors: total, heading, inclination and position, root mean squares "
        "by phase. Writes the table, trajectories (TUM) and figures to a folder.",
    )
    parser.add_argument(
        "run",
        metavar="RUN",
        help='folder of a finished run; "imu" for the attitude filter for inertial sensors, or its '
        "numbers in a .toml file",
    )
    parser.add_argument("recordings", metavar="RECORDING", nargs="+", help=RECORDING)
    add_window(parser)
    add_bridge(parser)
    add_imu(parser)
    parser.add_argument("--out", metavar="DIR", help="folder to write to")
    add_figures(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace the replays it holds")
    parser.set_defaults(command="replay")
