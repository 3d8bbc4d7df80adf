"""`posegsa replay`: the filter of a finished run on recorded motion."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from posegsa.arguments import check_type, refuse, several
from posegsa.config.imu import SHIPPED, ImuConfig, load_imu
from posegsa.figures.figure_choice import chosen_figures
from posegsa.figures.replay_figures import REPLAY_FIGURES
from posegsa.judging.replayed import Replay, replayed_on
from posegsa.judging.result import Result
from posegsa.recordings.imu import ImuRecording, as_imu
from posegsa.recordings.imu_filter import run_imu
from posegsa.recordings.recording import Recording
from posegsa.saving.replay_files import write_replays


def replay(
    result: Result | ImuConfig | Literal["imu"],
    recordings: Recording | Iterable[Recording],
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    figures: Iterable[str] | None = None,
) -> list[Replay]:
    """Run a tuned filter over recordings, and compute its errors where they have a ground truth.

    Args:
        result: A result tuned on scenarios or on recordings; or the attitude filter for inertial
            sensors, where "imu" is the shipped one. With that filter, `as_imu` computes vectors and
            start of recordings that were not made by `imu` or `as_imu`.
        recordings: One recording, or several.
        out: Folder for tables, trajectories (TUM) and figures.
        overwrite: Replace replays in that folder.
        figures: Names of the figures to draw there; by default all.

    Raises:
        ArgumentError: An argument has the wrong type, or has no effect without `out`.
        MeasurementError: A recording gives no initial pose.
        RunFolderError: `out` already holds replays, or can't be written.
    """
    drawn = chosen_figures(figures, REPLAY_FIGURES)
    for name, stated in (("overwrite", overwrite), ("figures", figures is not None)):
        if stated and out is None:
            refuse(f"{name} without out", "both, or neither")
    if result == SHIPPED:
        result = load_imu()
    allowed = 'a Result (of tune, load or configured), an ImuConfig or "imu"'
    check_type("result", result, Result, ImuConfig, allowed=allowed)
    given = [recordings] if isinstance(recordings, Recording) else recordings
    each = several("recordings", given, Recording, "recordings, or one")
    replays = [_replayed(result, one) for one in each]
    if out is not None:
        write_replays(replays, out, overwrite=overwrite, figures=drawn)
    return replays


def _replayed(result: Result | ImuConfig, recording: Recording) -> Replay:
    if not isinstance(result, ImuConfig):
        return replayed_on(recording, result.estimate(recording))
    if not isinstance(recording, ImuRecording):
        recording = as_imu(recording, settings=result.vectors)
    return replayed_on(recording, run_imu(recording, result))
