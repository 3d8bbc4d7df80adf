"""`posegsa replay`."""

import argparse

from posegsa import replaying
from posegsa.config.imu import SHIPPED, ImuConfig, load_imu
from posegsa.errors import ArgumentError
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.replay import replay_table
from posegsa.judging.result import TuneResult
from posegsa.recordings.imu import as_imu
from posegsa.recordings.policies import Policy
from posegsa.recordings.recording import Recording
from posegsa.saving.loading import load


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


def refuse_imu_options(options: argparse.Namespace) -> None:
    """Raise an ArgumentError where --frame or --rest is given, for a filter that has neither."""
    if options.frame != "ENU" or options.rest != "auto":
        raise ArgumentError("--frame, --rest; allowed: with the filter for inertial sensors (imu)")


def run(options: argparse.Namespace) -> int:
    """Run a filter over recordings and say how it errs."""
    for name in ("overwrite", "figures"):
        if getattr(options, name) and options.out is None:
            raise ArgumentError(f"--{name}; allowed: with --out")
    recordings = read(options.recordings, options.window, options.bridge, options.longest_gap)
    result = _filter(options.run)
    if isinstance(result, ImuConfig):
        recordings = [
            as_imu(each, frame=options.frame, rest=options.rest, settings=result.vectors)
            for each in recordings
        ]
    else:
        refuse_imu_options(options)
    where = {"out": options.out, "overwrite": options.overwrite, "figures": options.figures}
    replays = replaying.replay(result, recordings, **where)
    for one in replays:
        print(one.recording.describe())
    print(f"\n{replay_table(replays)}")
    if options.out is not None:
        print(f"\nWritten to {options.out}")
    return 0


def _filter(name: str) -> TuneResult | RecordingResult | ImuConfig:
    """The filter that RUN names: of a folder, of a file, or the shipped one."""
    return load_imu(name) if name == SHIPPED or name.endswith(".toml") else load(name)
