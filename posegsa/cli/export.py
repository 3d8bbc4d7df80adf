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
        help=f"write a tuned schedule as {', '.join(FORMATS)}",
        description="Writes the schedule of a finished run. "
        + " ".join(f"{name}: {first_line(write)}" for name, write in FORMATS.items()),
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    parser.add_argument("--format", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", metavar="FILE", help="file to write; default standard output")
    parser.set_defaults(command=_export)


def first_line(function: Callable[..., str]) -> str:
    """What the docstring of a function begins with."""
    return (function.__doc__ or "").partition("\n")[0]


def _export(options: argparse.Namespace) -> int:
    text = export(load(options.run), options.format)
    if options.out is None:
        sys.stdout.write(text)
        return 0
    try:
        Path(options.out).write_text(text, encoding="utf-8")
    except OSError as error:
        raise PosegsaError(f"{options.out}: cannot be written: {error.strerror}") from None
    print(f"Written: {options.out}")
    return 0
