"""What can be typed after `posegsa replay`."""

import argparse
from typing import Literal

from posegsa.cli.parsers.arguments import RECORDING, add_figures, add_window
from posegsa.recordings.frames import UP


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
    words = "of imu: the inertial frame, x y z (default: %(default)s)"
    parser.add_argument("--frame", choices=tuple(UP), default="ENU", help=words)
    words = "of imu: time at rest at the start [s], 0 for none (default: found)"
    parser.add_argument("--rest", type=_rest, default="auto", metavar="S", help=words)
    parser.add_argument("--out", metavar="DIR", help="folder to write to")
    add_figures(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace the replays it holds")
    parser.set_defaults(command="replay")


def _rest(text: str) -> float | Literal["auto"]:
    """What reads --rest."""
    if text == "auto":
        return "auto"
    try:
        return float(text)
    except ValueError:
        words = f"{text!r}; allowed: auto, or a time in seconds"
        raise argparse.ArgumentTypeError(words) from None
