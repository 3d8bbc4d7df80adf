"""The files of a tuned attitude filter for inertial sensors: the filter and its table."""

from pathlib import Path

from posegsa.errors import RunFolderError
from posegsa.judging.imu import ImuResult
from posegsa.saving.folder import holds_run, lock, prepare_folder, replace_files

FILTER, TABLE = "imu.toml", "imu.txt"
FILES = (FILTER, TABLE)


def prepare_imu_folder(folder: str | Path, *, overwrite: bool) -> Path:
    """The folder for the files, created if missing.

    Raises:
        RunFolderError: It contains a run or an attitude filter already, or cannot be written.
    """
    path = prepare_folder(folder, overwrite=True)
    if holds_run(path):
        raise RunFolderError(
            f"{path}: holds a run, which no filter for inertial sensors replaces; choose another "
            "folder"
        )
    if not overwrite and (path / FILTER).exists():
        raise RunFolderError(
            f"{path}: holds a filter already ({FILTER}); choose another folder, or replace it "
            "(--overwrite; overwrite=True)"
        )
    return path


def write_imu(result: ImuResult, folder: Path) -> None:
    """Write imu.toml, for `posegsa replay FOLDER/imu.toml` and `load_imu`, and imu.txt.

    Raises:
        RunFolderError: They cannot be written; the folder is unchanged.
    """
    by = "# " + result.summary().replace("\n", "\n# ").replace("# \n", "#\n")
    files = {FILTER: f"{by}\n\n{result.config.to_toml()}", TABLE: f"{result.summary()}\n"}
    contents = {name: text.encode("utf-8") for name, text in files.items()}
    with lock(folder):
        replace_files(folder, contents, remove=())
