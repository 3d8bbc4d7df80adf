"""A finished run on recordings: what its filter makes of motion that was not simulated."""

from collections.abc import Iterable
from pathlib import Path

from posegsa.arguments import check_type, several
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.replay import Replay, replayed_on
from posegsa.judging.result import TuneResult
from posegsa.recordings.recording import Recording
from posegsa.saving.replay import write_replays


def replay(
    result: TuneResult | RecordingResult,
    recordings: Recording | Iterable[Recording],
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> list[Replay]:
    """Run a tuned filter over recordings, and judge it where they have a truth.

    Args:
        result: A tuned result, tuned on scenarios or on recordings.
        recordings: One, or several.
        out: Folder to write tables, trajectories (TUM) and figures to.
        overwrite: Replace the replays that it holds.

    Raises:
        ArgumentError: An argument is of another type.
        MeasurementError: A recording can't be started.
        RunFolderError: `out` holds replays already, or can't be written.
    """
    check_type("result", result, TuneResult, RecordingResult)
    given = [recordings] if isinstance(recordings, Recording) else recordings
    each = several("recordings", given, Recording, "recordings, or one")
    replays = [replayed_on(one, result.estimate(one)) for one in each]
    if out is not None:
        write_replays(replays, out, overwrite=overwrite)
    return replays
