"""The files of a result on recordings: the result, and its table."""

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
"""Number of the layout of recorded.json; it changes with its records."""
DATA, TABLE = FILES = RECORDED, RECORDED_TABLE


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
        same_run: Whether what else the folder holds belongs to the same run, and stays.
        own_checkpoints: Whether the checkpoints do, at least.

    Raises:
        RunFolderError: They can't be written; the folder is as it was.
    """
    files = {DATA: to_json(result, SCHEMA), TABLE: result.summary() + "\n"}
    # Of another run that was there nothing may stay: it would be read instead.
    stale = [] if same_run else [*RUN_FILES]
    if not (same_run or own_checkpoints):
        stale += [str(path.relative_to(folder)) for path in checkpoint_paths(folder)]
    contents = {name: text.encode() for name, text in files.items()}
    replace_files(folder, contents, remove=stale)


def holds_recorded(folder: str | Path) -> bool:
    """Whether a folder holds a result on recordings, and none of a run on scenarios."""
    path = as_path("folder", folder)
    return (path / DATA).exists() and not (path / RESULT).exists()


def load_recorded(folder: str | Path) -> RecordingResult:
    """Read a result on recordings back.

    It is that of a search on recordings, or that of a run on simulated scenarios which was judged
    on recordings later (`posegsa evaluate RUN --recording FILE`).

    Raises:
        RunFolderError: It is none, is damaged or of another layout; names the file and the field.
    """
    path = as_path("folder", folder)
    text = read_text(path, DATA, of="result on recordings", limit=MAX_BYTES)
    result = from_json(RecordingResult, text, SCHEMA, path / DATA)
    also = sorted(one.key for one in result.experiment.also)
    if sorted(result.filter.also) != also:
        raise RunFolderError(
            f"{path / DATA}: filter.also = {sorted(result.filter.also)}; in experiment: {also}"
        )
    try:
        _ = result.schedule, result.tuned
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise RunFolderError(f"{path / DATA}: filter: {error}") from None
    return result
