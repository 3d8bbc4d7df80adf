"""Writes and reads finished runs, tuned on scenarios or recordings."""

from collections.abc import Iterable
from pathlib import Path

from posegsa.arguments import refuse
from posegsa.errors import RunFolderError
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.saving import imu, run
from posegsa.saving.folder import as_path, holds_run, locked_folder
from posegsa.saving.recorded import holds_recorded, load_recorded, write_recorded


def save(
    result: TuneResult | RecordingResult,
    folder: str | Path,
    *,
    overwrite: bool = False,
    figures: Iterable[str] | None = None,
) -> Path:
    """Write a result to a folder: JSON and tables; if tuned on scenarios also figures and report.

    Args:
        result: From `tune`, `evaluate` or `by_hand`.
        folder: Where; created if missing.
        overwrite: Replace another run's files there.
        figures: Names of the figures to draw; by default all. A result on recordings has none.

    Returns:
        The folder.

    Raises:
        RunFolderError: The folder contains a run already, or cannot be written.
        ArgumentError: There is no figure with such a name, or the result is on recordings.
    """
    if not isinstance(result, RecordingResult):
        return run.save(result, folder, overwrite=overwrite, figures=figures)
    if figures is not None:
        refuse("figures of a result on recordings", "none; posegsa.replay draws them")
    with locked_folder(folder, overwrite=overwrite) as locked:
        write_recorded(result, locked)
    return locked


def load(folder: str | Path) -> TuneResult | RecordingResult:
    """Read a run's folder: a `RecordingResult` if it was tuned on recordings.

    Raises:
        RunFolderError: It is not a run's folder; or a file in it is damaged, has another format or
            contradicts the others, which names the file and the field; or it contains a filter for
            inertial sensors, which is not a run.
    """
    path = as_path("folder", folder)
    if path.name == imu.FILTER or ((path / imu.FILTER).exists() and not holds_run(path)):
        file = path if path.name == imu.FILTER else path / imu.FILTER
        raise RunFolderError(
            f"{path}: a filter for inertial sensors, and no run; `posegsa replay {file} RECORDING` "
            "runs it, in Python run_imu with config.load_imu(...). Its vectors are made in Python, "
            "so that it has no export (docs/imu.md says what can be exported of it)"
        )
    if path.is_file():
        raise RunFolderError(f"{path}: is a file; allowed: the folder of a run")
    return load_recorded(folder) if holds_recorded(folder) else run.load(folder)
