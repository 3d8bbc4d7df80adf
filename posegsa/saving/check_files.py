"""The files of a check of recordings: a text, and a figure of each recording."""

from collections.abc import Sequence
from pathlib import Path

from posegsa.figures.check_figures import plot_check
from posegsa.figures.style import png
from posegsa.recordings.data_check import DataCheck
from posegsa.saving.folder import as_path, lock, replace_files, write_errors
from posegsa.saving.replay_files import folder_names

TEXT = "check.txt"


def write_checks(checks: Sequence[DataCheck], folder: str | Path) -> Path:
    """Write checks to a folder, created if missing: check.txt and a figure of each recording.

    Raises:
        RunFolderError: The folder cannot be written.
    """
    folder = as_path("folder", folder)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    names = folder_names([each.recording.name for each in checks])
    files = {f"{n}.png": png(plot_check(one)) for n, one in zip(names, checks, strict=True)}
    files[TEXT] = ("\n\n".join(one.text() for one in checks) + "\n").encode()
    with lock(folder):
        replace_files(folder, files, remove=[])
    return folder
