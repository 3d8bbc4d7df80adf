"""`posegsa export`."""

import argparse
import sys
from pathlib import Path

from posegsa.errors import PosegsaError
from posegsa.export import FORMATS, export
from posegsa.saving.run import load


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "export",
        help="write a tuned schedule as JSON, CSV or C",
        description="Writes the schedule of a finished run: json holds all of it at full "
        "precision, csv the control surface, c a C99 file without dependencies for the gain.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    parser.add_argument("--format", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", metavar="FILE", help="file to write; default standard output")
    parser.set_defaults(command=_export)


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
