"""Atomic writes and bounded reads of single files.

A file is written under a temporary name, synced to the disk and renamed. So at any time its name
refers either to the complete old content or to the complete new one.
"""

import contextlib
import os
import stat
from pathlib import Path

from posegsa.errors import RunFolderError

PART = ".part"
"""Suffix of temporary files, which are not part of a run."""

NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""Flag of `os.open` against following links; 0 if the system has none (Windows)."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file completely or not at all, even if the power fails.

    Raises:
        OSError: It cannot be written; the old content stays.
    """
    temporary = path.with_name(path.name + PART)
    try:
        write_synced(temporary, content)
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_synced(path: Path, data: bytes) -> None:
    """Write a file, and wait until it is on the disk.

    Raises:
        OSError: It cannot be written, or its name is a link, which could lead anywhere.
    """
    with open(path, "wb", opener=_open_no_link) as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _open_no_link(path: str, flags: int) -> int:
    return os.open(path, flags | NO_LINK, 0o666)


def sync_folder(folder: Path) -> None:
    """Wait until a folder's names are on the disk, on systems that support it."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def read_bounded(path: Path, limit: int) -> bytes:
    """The content of a regular file of at most `limit` bytes.

    Raises:
        RunFolderError: It is too large, or not a regular file, such as a pipe, which could block
            its reader for ever.
        OSError: It cannot be read.
    """
    # Opening a pipe without O_NONBLOCK waits for a writer.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise RunFolderError(f"{path}: is not a regular file")
        if status.st_size > limit:
            raise RunFolderError(
                f"{path}: has {status.st_size} bytes; allowed: at most {limit} in such a file"
            )
        return file.read(limit)
