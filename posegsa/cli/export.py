"""`posegsa export`."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from posegsa.errors import PosegsaError
from posegsa.export import FORMATS, export
from posegsa.saving.loading import load


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "export",
        help=f"write a tuned filter or its schedule as {', '.join(FORMATS)}",
        description="Writes the filter of a finished run, or its schedule. "
        + " ".join(f"{name}: {first_line(write)}" for name, write in FORMATS.items()),
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    parser.add_argument("--format", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", metavar="FILE", help="file to write; default standard output")
    parser.add_argument("--overwrite", action="store_true", help="replace the file if there is one")
    parser.add_argument("--name", help="what names in C begin with; default posegsa")
    parser.set_defaults(command=_export)


def first_line(function: Callable[..., str]) -> str:
    """What the docstring of a function begins with."""
    return (function.__doc__ or "").partition("\n")[0]


def _export(options: argparse.Namespace) -> int:
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
