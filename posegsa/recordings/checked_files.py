"""Checks of files before they are read, and errors that name them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from posegsa.arguments import check_type
from posegsa.errors import MeasurementError, RecordingError

MAX_BYTES = 4 * 2**30
"""Maximum size of a file: 4 GiB."""


def as_path(value: str | Path) -> Path:
    """A path from a user."""
    check_type("path", value, str, os.PathLike, allowed="a path")
    return Path(value)


def file_of(value: str | Path) -> Path:
    """The path of a regular file that is small enough to read.

    Raises:
        RecordingError: there is none.
    """
    path = as_path(value)
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    if (size := path.stat().st_size) > MAX_BYTES:
        raise RecordingError(f"{path}: {size} bytes; allowed: up to 4 GiB")
    return path


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file's name before errors about its contents, which name only an array."""
    try:
        yield
    except MeasurementError as error:
        if str(error).startswith(str(path)):
            raise
        raise type(error)(f"{path}: {error}") from error


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn any error while a file is read into a RecordingError that names the file."""
    try:
        yield
    except RecordingError:
        raise
    except Exception as error:  # readers of damaged files raise all kinds
        what = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(f"{path}: cannot be read: {what}") from error
