"""`posegsa export`."""

import argparse
import sys
from pathlib import Path

from posegsa.errors import PosegsaError
from posegsa.export import export
from posegsa.saving.loading import load


def run(options: argparse.Namespace) -> int:
    """Write a finished run in a format."""
    text = export(load(options.run), options.format, options.name)
    if options.out is None:
        sys.stdout.write(text)
        return 0
    write_new(Path(options.out), text, overwrite=options.overwrite)
    print(f"Written: {options.out}")
    return 0


def write_new(path: Path, text: str, *, overwrite: bool) -> None:
    """Write a file, and refuse one that is there already unless it may be overwritten."""
    try:
        with path.open("w" if overwrite else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise PosegsaError(f"{path}: is there already; --overwrite replaces it") from None
    except OSError as error:
        raise PosegsaError(f"{path}: cannot be written: {error.strerror}") from None
