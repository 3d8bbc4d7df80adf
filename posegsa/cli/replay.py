"""`posegsa replay`."""

import argparse
from typing import Literal, get_args

from posegsa import replaying
from posegsa.config.imu import SHIPPED, ImuConfig, load_imu
from posegsa.errors import ArgumentError
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.replay import replay_table
from posegsa.judging.result import TuneResult
from posegsa.recordings.bridging import Policy
from posegsa.recordings.imu import UP, as_imu
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


def add_imu(parser: argparse._ActionsContainer) -> None:
    """--frame and --rest, of the filter for inertial sensors."""
    words = "of imu: the inertial frame, x y z (default: %(default)s)"
    parser.add_argument("--frame", choices=tuple(UP), default="ENU", help=words)
    words = "of imu: time at rest at the start [s], 0 for none (default: found)"
    parser.add_argument("--rest", type=_rest, default="auto", metavar="S", help=words)


def add_bridge(parser: argparse._ActionsContainer) -> None:
    """--bridge and --longest-gap, what is done where a recording does not go on."""
    parser.add_argument(
        "--bridge",
        choices=get_args(Policy),
        help="what is done about gaps, stamps that go back and samples without velocities: "
        "refused (default), the last velocities held, or interpolated",
    )
    words = "time up to which anything is bridged [s] (default: 1)"
    parser.add_argument("--longest-gap", type=float, metavar="S", help=words)


def read(
    paths: list[str],
    part: tuple[float, float] | None,
    bridge: Policy | None = None,
    longest_gap: float | None = None,
) -> list[Recording]:
    """The recordings of some paths, bridged as stated, cut to a window."""
    if longest_gap is not None and bridge in (None, "refuse"):
        raise ArgumentError("--longest-gap; allowed: with --bridge hold or interpolate")
    stated = {"bridge": bridge, "longest_gap": longest_gap}
    more = {name: value for name, value in stated.items() if value is not None}
    found = [Recording.read(path, **more) for path in paths]
    return found if part is None else [each.window(*part) for each in found]


def _replay(options: argparse.Namespace) -> int:
    if options.overwrite and options.out is None:
        raise ArgumentError("--overwrite; allowed: with --out")
    recordings = read(options.recordings, options.window, options.bridge, options.longest_gap)
    result = _filter(options.run)
    if isinstance(result, ImuConfig):
        recordings = [
            as_imu(each, frame=options.frame, rest=options.rest, settings=result.vectors)
            for each in recordings
        ]
    elif options.frame != "ENU" or options.rest != "auto":
        raise ArgumentError("--frame, --rest; allowed: with the filter for inertial sensors (imu)")
    replays = replaying.replay(result, recordings, out=options.out, overwrite=options.overwrite)
    for one in replays:
        print(one.recording.describe())
    print(f"\n{replay_table(replays)}")
    if options.out is not None:
        print(f"\nWritten to {options.out}")
    return 0


def _filter(name: str) -> TuneResult | RecordingResult | ImuConfig:
    """The filter that RUN names: of a folder, of a file, or the shipped one."""
    return load_imu(name) if name == SHIPPED or name.endswith(".toml") else load(name)


def _rest(text: str) -> float | Literal["auto"]:
    """What reads --rest."""
    if text == "auto":
        return "auto"
    try:
        return float(text)
    except ValueError:
        words = f"{text!r}; allowed: auto, or a time in seconds"
        raise argparse.ArgumentTypeError(words) from None
