"""`posegsa replay`."""

import argparse

from posegsa.cli.options import (
    RECORDING,
    add_bridge,
    add_figures,
    add_frame,
    add_run,
    add_window,
    as_read_with,
    read,
    result_of,
    warn_of_mistakes,
)
from posegsa.errors import ArgumentError, MeasurementError
from posegsa.progress import say


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "replay",
        help="run a tuned filter over recordings",
        description="Runs the filter of a finished run over recordings and, where they have a "
        "reference, shows root mean square errors by phase: total, heading, inclination and "
        "position. With --out, writes the table, the estimates (estimates.csv; with a position "
        "also TUM files) and figures to a folder. The exit status is 2 if a recording can't be "
        "read or gives no start; the filter runs on the others.",
    )
    add_run(parser)
    parser.add_argument("recordings", metavar="RECORDING", nargs="+", help=RECORDING)
    add_window(parser)
    add_bridge(parser)
    add_frame(parser, "its own, or that of the run, or ENU")
    parser.add_argument("--out", metavar="DIR", help="folder to write to")
    add_figures(parser)
    parser.add_argument(
        "--overwrite", action="store_true", help="replace the replays in the folder"
    )
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> int:
    """Run a filter over recordings and show its errors."""
    for name in ("overwrite", "figures"):
        if getattr(options, name) and options.out is None:
            raise ArgumentError(f"--{name}; allowed: with --out")
    from posegsa import replaying
    from posegsa.judging.replayed import replay_table

    result = result_of(options)
    refused = []

    def left_out(name: str, error: MeasurementError) -> None:
        text = str(error)
        say(f"posegsa: {text if text.startswith(name) else f'{name}: {text}'}")
        refused.append(name)

    recordings = []
    how = options.bridge, options.longest_gap, options.frame, result.frame
    for path in options.recordings:
        try:
            each = read([path], options.window, *how)
            warn_of_mistakes(each)
            recordings += as_read_with(options, result.filter.kind, each)
        except MeasurementError as error:  # the filter runs on the others all the same
            left_out(path, error)
    replays = replaying.replay(
        result,
        recordings,
        out=options.out,
        overwrite=options.overwrite,
        figures=options.figures,
        left_out=lambda one, error: left_out(one.name, error),
    )
    if not replays:
        return 2
    for one in replays:
        print(one.recording.describe())
    print(f"\n{replay_table(replays)}")
    if options.out is not None:
        print(f"\nWritten to {options.out}")
    elif not any(one.errors for one in replays):
        print("\nTo have the estimates as a file and as figures: --out DIR")
    return 2 if refused else 0
