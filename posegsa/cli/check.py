"""`posegsa check`."""

import argparse

from posegsa.cli.options import RECORDING, add_bridge, add_frame, add_window, read
from posegsa.errors import MeasurementError
from posegsa.progress import say


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "check",
        help="look for mistakes in recordings",
        description="Shows rates, gaps, noise and biases of the sensors of recordings, whether "
        "they determine the pose, and the usual mistakes that they seem to have: units, axes, "
        "frames, order of quaternions, exchanged sensors, delays. Nothing is changed. The exit "
        "status is 1 if something was found, 2 if a recording can't be read; the others are "
        "still checked.",
    )
    parser.add_argument("recordings", metavar="RECORDING", nargs="+", help=RECORDING)
    add_window(parser)
    add_bridge(parser)
    add_frame(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for a figure of each recording")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> int:
    """Check recordings and show what was found."""
    bridged = options.bridge, options.longest_gap
    found, refused = [], False
    for path in options.recordings:
        try:
            (one,) = read([path], options.window, *bridged, options.frame, landmark_outlier="off")
            from posegsa.recordings.data_check import check  # slow, as what follows

            found.append(check(one))
        except MeasurementError as error:  # the others are checked nevertheless
            say(f"posegsa: {error}")
            refused = True
            continue
        between = "\n" if len(found) > 1 else ""
        print(f"{between}{found[-1].text()}", flush=True)
    if options.out is not None and found:
        from posegsa.saving.replay_files import write_checks

        write_checks(found, options.out)
        print(f"\nWritten to {options.out}")
    if refused:
        return 2
    return 1 if any(one.findings for one in found) else 0
