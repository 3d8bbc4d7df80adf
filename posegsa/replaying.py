"""`posegsa replay`: the filter of a finished run on recorded motion."""

from collections.abc import Iterable
from pathlib import Path

from posegsa.arguments import check_type, refuse, several
from posegsa.configuring import configured
from posegsa.figures.figure_choice import chosen_figures
from posegsa.figures.replay_figures import REPLAY_FIGURES
from posegsa.judging.replayed import Replay, replayed_on
from posegsa.judging.result import Result
from posegsa.recordings.imu import as_read_by
from posegsa.recordings.recording import Recording
from posegsa.saving.replay_files import write_replays


def replay(
    result: Result | str,
    recordings: Recording | Iterable[Recording],
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    figures: Iterable[str] | None = None,
) -> list[Replay]:
    """Run a tuned filter over recordings, and compute its errors where they have a ground truth.

    Args:
        result: A result tuned on scenarios or on recordings; or the name of a configuration, such
            as "imu", for the filter with the numbers in it.
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
    check_type("result", result, Result, str, allowed="a Result, or the name of a configuration")
    if isinstance(result, str):
        result = configured(result)
    given = [recordings] if isinstance(recordings, Recording) else recordings
    each = several("recordings", given, Recording, "recordings, or one")
    each = [as_read_by(result.filter.kind, one) for one in each]
    replays = [replayed_on(one, result.estimate(one)) for one in each]
    if out is not None:
        write_replays(replays, out, overwrite=overwrite, figures=drawn)
    return replays
