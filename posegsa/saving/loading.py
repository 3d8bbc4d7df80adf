"""Finished runs read back, whatever they were tuned on."""

from pathlib import Path

from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.saving import run
from posegsa.saving.recorded import holds_recorded, load_recorded


def load(folder: str | Path) -> TuneResult | RecordingResult:
    """Read a run's folder back: a `RecordingResult` where it was tuned on recordings.

    Raises:
        RunFolderError: It is not a run's folder, or a file in it is damaged, of another layout, or
            does not fit to the others; names the file and the field.
    """
    return load_recorded(folder) if holds_recorded(folder) else run.load(folder)
