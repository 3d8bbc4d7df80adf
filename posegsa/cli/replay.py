"""`posegsa replay`."""

import argparse

from posegsa import replaying
from posegsa.errors import ArgumentError
from posegsa.judging.replay import replay_table
from posegsa.recordings.recording import Recording
from posegsa.saving.loading import load

RECORDING = (
    "a recording: a .csv file (columns: docs/recordings.md), an .npz file, a .mat file of BROAD or "
    "the folder of a EuRoC sequence"
)


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "replay",
        help="run a tuned filter over recordings",
        description="Runs the filter of a finished run over recordings and, where they have a "
        "reference, shows its errors: total, heading, inclination and position, root mean squares "
        "by phase. Writes the table, trajectories (TUM) and figures to a folder.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    parser.add_argument("recordings", metavar="RECORDING", nargs="+", help=RECORDING)
    add_window(parser)
    parser.add_argument("--out", metavar="DIR", help="folder to write to")
    parser.add_argument("--overwrite", action="store_true", help="replace the replays it holds")
    parser.set_defaults(command=_replay)


def add_window(parser: argparse._ActionsContainer) -> None:
    """--window, which part of each recording is used."""
    words = "only these seconds of each recording, such as 0:40, 40: or :40"
    parser.add_argument("--window", metavar="A:B", type=window, help=words)


def window(text: str) -> tuple[float, float]:
    """What reads a window in seconds."""
    begin, colon, end = text.partition(":")
    try:
        found = float(begin or 0.0), float(end or "inf")
    except ValueError:
        found = (1.0, 0.0)
    if not colon or not 0 <= found[0] < found[1]:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: A:B in seconds, such as 0:40 or 40:")
    return found


def read(paths: list[str], part: tuple[float, float] | None) -> list[Recording]:
    """The recordings of some paths, cut to a window."""
    found = [Recording.read(path) for path in paths]
    return found if part is None else [each.window(*part) for each in found]


def _replay(options: argparse.Namespace) -> int:
    if options.overwrite and options.out is None:
        raise ArgumentError("--overwrite; allowed: with --out")
    result = load(options.run)
    recordings = read(options.recordings, options.window)
    replays = replaying.replay(result, recordings, out=options.out, overwrite=options.overwrite)
    for one in recordings:
        print(one.describe())
    print(f"\n{replay_table(replays)}")
    if options.out is not None:
        print(f"\nWritten to {options.out}")
    return 0
