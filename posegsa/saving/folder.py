"""A run's folder: one writer at a time, and all files of a result replaced at once.

The writer holds a lock. Files are first staged: written to a folder of their own and synced.
Renaming that folder commits them, and then they are moved into place. If the process dies in
between, readers find the committed files first, and the next writer moves the rest.
"""

import contextlib
import os
import shutil
import socket
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from posegsa.errors import RunFolderError
from posegsa.saving.atomic_files import NO_LINK, read_bounded, sync_folder, write_synced

RESULT, FIGURES, CHECKPOINTS = "result.json", "figures", "checkpoints"
CHECKPOINT_SUFFIX = ".checkpoint"

MAX_BYTES = 2**27
"""Maximum size of a file, except for the largest ones: 128 MiB."""

_LOCK = ".lock"
_STAGED, _COMMITTED = ".saving", ".saved"


# One writer ---------------------------------------------------------------------------------------


@contextlib.contextmanager
def locked_folder(folder: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """The folder of a run, created if missing, and locked within the context.

    Raises:
        RunFolderError: It contains a run already, finished or not, and `overwrite` is False; it is
            not a folder; it cannot be written; or another run is writing there.
    """
    folder = prepare_folder(folder, overwrite=overwrite)
    with lock(folder):
        finish_commit(folder)
        # Another process may have written a run before the lock.
        yield prepare_folder(folder, overwrite=overwrite)


def prepare_folder(folder: str | Path, *, overwrite: bool = False) -> Path:
    """Create a folder, after checking that a run may be written to it."""
    folder = as_path("folder", folder)
    if not overwrite:
        if any((folder / place / RESULT).exists() for place in ("", _COMMITTED)):
            raise RunFolderError(
                f"{folder}: holds a run already; choose another folder, or replace the run "
                "(--overwrite; overwrite=True)"
            )
        if any((folder / CHECKPOINTS).glob(f"*{CHECKPOINT_SUFFIX}")):
            raise RunFolderError(
                f"{folder}: holds an unfinished run; resume it (--resume; resume=...), choose "
                "another folder, or replace the run (--overwrite; overwrite=True)"
            )
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
def lock(folder: Path) -> Iterator[None]:
    """Keep other processes and threads from writing to a folder.

    The system releases the lock when the process ends in any way. On systems without such locks
    (Windows, some network file systems) this does nothing.

    Raises:
        RunFolderError: Another run is writing there.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    with write_errors(folder):
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | NO_LINK
        descriptor = os.open(folder / _LOCK, flags, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 200).decode("utf-8", "replace").strip()
            holder = holder if holder and holder.isprintable() else "unknown"
            raise RunFolderError(
                f"{folder}: another run is writing there ({holder}); wait for it, stop it, or "
                "choose another folder"
            ) from None
        except OSError:  # a file system without locks (ENOLCK, EOPNOTSUPP, ENOSYS)
            pass
        with contextlib.suppress(OSError):  # on a full disk the lock holds without its text
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def write_errors(folder: Path) -> Iterator[None]:
    """Turn system errors during writing into RunFolderErrors that name the folder."""
    try:
        yield
    except RunFolderError:
        raise
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be written: {error.strerror}") from error


# All files at once --------------------------------------------------------------------------------


def replace_files(folder: Path, files: Mapping[str, bytes], remove: Iterable[str]) -> None:
    """Replace files of a locked folder, by names such as `figures/gain.png`: all of them or none.

    Files in both `files` and `remove` stay.

    Raises:
        RunFolderError: They cannot be written; the folder is unchanged.
    """
    staged = folder / _STAGED
    with write_errors(folder):
        try:
            shutil.rmtree(staged, ignore_errors=True)
            staged.mkdir(parents=True)  # if the folder was removed, the result must not be lost
            for name, content in files.items():
                path = staged / name
                path.parent.mkdir(exist_ok=True)
                write_synced(path, content)
            for path in {(staged / name).parent for name in files}:
                sync_folder(path)
        except BaseException:
            shutil.rmtree(staged, ignore_errors=True)
            raise
        staged.rename(folder / _COMMITTED)
        sync_folder(folder)
        finish_commit(folder)
        for name in remove:
            if name not in files:
                (folder / name).unlink(missing_ok=True)


def finish_commit(folder: Path) -> None:
    """Move committed files into place, also those of a process that died before doing so."""
    committed = folder / _COMMITTED
    if not committed.is_dir():
        return
    _refuse_links(folder)
    for path in sorted(committed.rglob("*")):
        if path.is_file():
            target = folder / path.relative_to(committed)
            target.parent.mkdir(exist_ok=True)
            path.replace(target)
    sync_folder(folder)
    shutil.rmtree(committed)


# Reading ------------------------------------------------------------------------------------------


def read_text(folder: Path, name: str, of: str, limit: int = MAX_BYTES) -> str:
    """The text of a file of at most `limit` bytes in a run's folder, or of its committed version.

    Raises:
        RunFolderError: It cannot be read, is too large, is not UTF-8 text, or is missing; `of` says
            in words what it is part of.
    """
    for path in (folder / _COMMITTED / name, folder / name):
        try:
            return read_bounded(path, limit).decode("utf-8")
        except FileNotFoundError:
            continue  # a writer may have just moved it from the first place to the second
        except UnicodeDecodeError:
            raise RunFolderError(f"{path}: is not UTF-8 text") from None
        except RunFolderError:
            raise
        except OSError as error:
            raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from None
    raise RunFolderError(f"{folder}: holds no {of} ({name} is missing)")


def as_path(name: str, value: object) -> Path:
    """A path from a user.

    Raises:
        RunFolderError: It is not a path.
    """
    if not isinstance(value, str | os.PathLike) or not str(value) or "\0" in str(value):
        raise RunFolderError(f"{name} = {value!r}; allowed: a path")
    return Path(value)


def _refuse_links(folder: Path) -> None:
    """Refuse links in a folder from elsewhere, through which posegsa could write anywhere."""
    for name in (FIGURES, CHECKPOINTS, _STAGED, _COMMITTED, _LOCK):
        if (folder / name).is_symlink():
            kind = "file" if name == _LOCK else "folder"
            raise RunFolderError(f"{folder / name}: is a link; allowed: a {kind} of its own")
