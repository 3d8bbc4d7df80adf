"""The files of a result on recordings: the result and its table."""

from pathlib import Path

from posegsa.errors import RunFolderError
from posegsa.judging.recorded import RecordingResult
from posegsa.saving.checkpointing import checkpoint_paths
from posegsa.saving.folder import (
    MAX_BYTES,
    RECORDED,
    RECORDED_TABLE,
    RESULT,
    as_path,
    read_text,
    replace_files,
)
from posegsa.saving.records import from_json, to_json
from posegsa.saving.run import RUN_FILES

SCHEMA = 3
"""Version of the format of recorded.json."""
FILES = (RECORDED, RECORDED_TABLE)


def write_recorded(
    result: RecordingResult,
    folder: Path,
    *,
    same_run: bool = False,
    own_checkpoints: bool = False,
) -> None:
    """Write the files of a result at once, to a folder that the caller has locked.

    Args:
        result: What is written.
        folder: Where.
        same_run: Keep all other files: they belong to the same run.
        own_checkpoints: Keep at least the checkpoints.

    Raises:
        RunFolderError: They cannot be written; the folder is unchanged.
    """
    files = {RECORDED: to_json(result, SCHEMA), RECORDED_TABLE: result.summary() + "\n"}
    # Files of another run must go, or they would be read instead.
    stale = [] if same_run else [*RUN_FILES]
    if not (same_run or own_checkpoints):
        stale += [str(path.relative_to(folder)) for path in checkpoint_paths(folder)]
    contents = {name: text.encode() for name, text in files.items()}
    replace_files(folder, contents, remove=stale)


def holds_recorded(folder: str | Path) -> bool:
    """Whether a folder contains a result on recordings, and none of a run on scenarios."""
    path = as_path("folder", folder)
    return (path / RECORDED).exists() and not (path / RESULT).exists()


def load_recorded(folder: str | Path) -> RecordingResult:
    """Read a result on recordings.

    It is from a search on recordings, or from a run on simulated scenarios that was judged on
    recordings later (`posegsa evaluate RUN --recording FILE`).

    Raises:
        RunFolderError: There is none, or it is damaged or has another format; names the file and
            the field.
    """
    path = as_path("folder", folder)
    text = read_text(path, RECORDED, of="result on recordings", limit=MAX_BYTES)
    result = from_json(RecordingResult, text, SCHEMA, path / RECORDED)
    also = sorted(one.key for one in result.experiment.also)
    if sorted(result.filter.also) != also:
        raise RunFolderError(
            f"{path / RECORDED}: filter.also = {sorted(result.filter.also)}; in experiment: {also}"
        )
    try:
        _ = result.schedule, result.tuned
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise RunFolderError(f"{path / RECORDED}: filter: {error}") from None
    return result
