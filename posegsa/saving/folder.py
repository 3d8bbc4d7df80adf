"""A run's folder: who may write to it, and how all files of a result change at once.

A save is staged: everything is written to a folder beside, synced, and that folder is then renamed,
which is the moment at which the new result holds. Its files are moved into place after that; should
the process die between, readers look there first and the next writer moves the rest.
"""

import contextlib
import os
import shutil
import socket
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from posegsa.errors import RunFolderError
from posegsa.saving.files import NO_LINK, read_bounded, sync_folder, write_synced

RESULT, FIGURES, CHECKPOINTS = "result.json", "figures", "checkpoints"
SUFFIX = ".checkpoint"

_LOCK = ".lock"
_STAGED, _SAVED = ".saving", ".saved"
_UNFINISHED = (
    "holds an unfinished run; go on with it (--resume; resume=...), choose another folder, or "
    "replace the run (--overwrite; overwrite=True)"
)


def claim(folder: str | Path, *, overwrite: bool = False) -> Path:
    """Make a folder and see that a run may be written there.

    Raises:
        RunFolderError: It holds a run already, is not a folder, or can't be written.
    """
    folder = as_path("folder", folder)
    if not overwrite:
        if _exists(folder, RESULT):
            raise RunFolderError(
                f"{folder}: holds a run already; choose another folder, or replace the run "
                "(--overwrite; overwrite=True)"
            )
        if any((folder / CHECKPOINTS).glob(f"*{SUFFIX}")):
            raise RunFolderError(f"{folder}: {_UNFINISHED}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except FileExistsError:
        raise RunFolderError(f"{folder}: is not a folder") from None
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be written: {error.strerror}") from None
    _refuse_links(folder)
    return folder


@contextlib.contextmanager
def claimed(folder: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A folder for one run to write to, while it lasts, kept from all others.

    Raises:
        RunFolderError: As `claim`'s, or another run is writing there.
    """
    folder = claim(folder, overwrite=overwrite)
    with locked(folder):
        settle(folder)
        yield claim(folder, overwrite=overwrite)  # somebody may have been there in between


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes and threads from writing to a folder.

    The system gives the lock back when the process ends, however it ends. Where it has no such
    locks (Windows, some file systems of networks), there is none.

    Raises:
        RunFolderError: Another run is writing there.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    with writing(folder):
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | NO_LINK
        descriptor = os.open(folder / _LOCK, flags, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 200).decode("utf-8", "replace").strip() or "unknown"
            raise RunFolderError(
                f"{folder}: another run is writing there ({holder}); wait for it, stop it, or "
                "choose another folder"
            ) from None
        except OSError:  # a file system without locks (ENOLCK, EOPNOTSUPP, ENOSYS)
            pass
        with contextlib.suppress(OSError):  # a full disk: the lock holds without its text
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """What can't be written says so by the folder's name."""
    try:
        yield
    except RunFolderError:
        raise
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be written: {error.strerror}") from error


def replace_files(folder: Path, files: Mapping[str, bytes], remove: Iterable[str]) -> None:
    """Replace files of a run's folder, all of them or none.

    Args:
        folder: The folder, `claimed`.
        files: Contents by name, such as `figures/gain.png`.
        remove: Names of files that go; those in `files` stay.

    Raises:
        RunFolderError: They can't be written; the folder is as it was.
    """
    staged = folder / _STAGED
    with writing(folder):
        try:
            shutil.rmtree(staged, ignore_errors=True)
            staged.mkdir()
            for name, content in files.items():
                path = staged / name
                path.parent.mkdir(exist_ok=True)
                write_synced(path, content)
            for path in {(staged / name).parent for name in files}:
                sync_folder(path)
        except BaseException:
            shutil.rmtree(staged, ignore_errors=True)
            raise
        staged.rename(folder / _SAVED)
        sync_folder(folder)
        settle(folder)
        for name in remove:
            if name not in files:
                (folder / name).unlink(missing_ok=True)


def settle(folder: Path) -> None:
    """Finish a save that was cut short after the moment from which it holds."""
    saved = folder / _SAVED
    if not saved.is_dir():
        return
    _refuse_links(folder)
    for path in sorted(saved.rglob("*")):
        if path.is_file():
            target = folder / path.relative_to(saved)
            target.parent.mkdir(exist_ok=True)
            path.replace(target)
    sync_folder(folder)
    shutil.rmtree(saved)


def read(folder: Path, name: str, limit: int) -> str:
    """The text of a file of a run, of at most `limit` bytes; its newest content.

    Raises:
        RunFolderError: It is too large, or not UTF-8 text.
        OSError: It can't be read.
    """
    for path in (folder / _SAVED / name, folder / name):
        with contextlib.suppress(FileNotFoundError):
            return _text(path, limit)
    raise FileNotFoundError(2, os.strerror(2), str(folder / name))


def as_path(name: str, value: object) -> Path:
    """A path from a user.

    Raises:
        RunFolderError: It is no path.
    """
    if not isinstance(value, str | os.PathLike) or not str(value) or "\0" in str(value):
        raise RunFolderError(f"{name} = {value!r}; allowed: a path")
    return Path(value)


def _text(path: Path, limit: int) -> str:
    content = read_bounded(path, limit)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        raise RunFolderError(f"{path}: is not UTF-8 text") from None


def _exists(folder: Path, name: str) -> bool:
    return (folder / _SAVED / name).exists() or (folder / name).exists()


def _refuse_links(folder: Path) -> None:
    """A folder from elsewhere could have what posegsa writes below it go anywhere."""
    for name in (FIGURES, CHECKPOINTS, _STAGED, _SAVED, _LOCK):
        if (folder / name).is_symlink():
            kind = "file" if name == _LOCK else "folder"
            raise RunFolderError(f"{folder / name}: is a link; allowed: a {kind} of its own")
