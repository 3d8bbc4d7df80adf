"""Finished runs written and read back, whatever they were tuned on."""

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
    """Write a result to the folder of a run: JSON, tables, and of simulations figures and report.

    Args:
        result: From `tune`, `evaluate` or `by_hand`.
        folder: Where; made if missing.
        overwrite: Replace another run's files there.
        figures: Names of those to draw; by default all. Not of a result on recordings, which has
            none.

    Returns:
        The folder.

    Raises:
        RunFolderError: It holds a run already, or can't be written.
        ArgumentError: There is no figure of such a name, or the result is one on recordings.
    """
    if not isinstance(result, RecordingResult):
        return run.save(result, folder, overwrite=overwrite, figures=figures)
    if figures is not None:
        refuse("figures of a result on recordings", "none; posegsa.replay draws them")
    with locked_folder(folder, overwrite=overwrite) as locked:
        write_recorded(result, locked)
    return locked


def load(folder: str | Path) -> TuneResult | RecordingResult:
    """Read a run's folder back: a `RecordingResult` where it was tuned on recordings.

    Raises:
        RunFolderError: It is not a run's folder, or a file in it is damaged, of another layout, or
            does not fit to the others; names the file and the field. Or a filter for inertial
            sensors, which is no run.
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
