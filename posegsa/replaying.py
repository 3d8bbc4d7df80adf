"""`posegsa replay`: the filter of a finished run on recorded motion."""

from collections.abc import Callable, Iterable
from pathlib import Path

from posegsa.arguments import check_type, refuse, several
from posegsa.configuring import configured
from posegsa.errors import MeasurementError
from posegsa.figures.figure_choice import chosen_figures
from posegsa.figures.replay_figures import REPLAY_FIGURES
from posegsa.judging.replayed import Replay, replayed_on
from posegsa.judging.result import Result
from posegsa.recordings.recording import Recording
from posegsa.saving.replay_files import refuse_replays_in, write_replays


def replay(
    result: Result | str,
    recordings: Recording | Iterable[Recording],
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    figures: Iterable[str] | None = None,
    left_out: Callable[[Recording, MeasurementError], None] | None = None,
) -> list[Replay]:
    """Run a tuned filter over recordings, and compute its errors where they have a ground truth.

    A recording that gives no initial pose is refused before the filter runs on any.

    Args:
        result: A result tuned on scenarios or on recordings; or the name of a configuration, such
            as "imu", for the filter with the numbers in it.
        recordings: One recording, or several.
        out: Folder for tables, estimates (CSV; with a position also TUM) and figures.
        overwrite: Replace replays in that folder.
        figures: Names of the figures to draw there; by default all.
        left_out: Called with each recording that gives no initial pose, or that the filter can't
            read, and with why; it is left out then instead of refused.

    Raises:
        ArgumentError: An argument has the wrong type, or has no effect without `out`.
        MeasurementError: A recording gives no initial pose, or lacks what the filter reads.
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
    if out is not None:
        refuse_replays_in(out, overwrite=overwrite)
    ready = []
    for one in each:
        try:
            read = result.as_read(one)
            read.initial()
        except MeasurementError as error:
            if left_out is None:
                raise
            left_out(one, error)
        else:
            ready.append(read)
    replays = [replayed_on(one, result.estimate(one)) for one in ready]
    if out is not None and replays:
        write_replays(replays, out, overwrite=overwrite, figures=drawn)
    return replays
