"""`posegsa export`."""

import argparse
import sys
from pathlib import Path

from posegsa.cli.options import RECORDING, add_frame, add_run, read, result_of
from posegsa.errors import PosegsaError
from posegsa.export.formats import FORMATS, export
from posegsa.progress import say
from posegsa.words import counted


def add(commands) -> None:
    """Add the command to the others."""
    width = max(map(len, FORMATS)) + 2
    parser = commands.add_parser(
        "export",
        help=f"write a tuned filter or its schedule as {', '.join(FORMATS)}",
        description="Writes the filter of a finished run, or the controller of its gain.\n\n"
        + "\n".join(f"  {name:{width}}{format.about}" for name, format in FORMATS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_run(parser)
    words = f"the filter knows the vectors and landmarks of {RECORDING}"
    parser.add_argument("--recording", metavar="FILE", help=words)
    add_frame(parser, "that of the recording or the run, or ENU")
    parser.add_argument("--format", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", metavar="FILE", help="file to write (default: standard output)")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.add_argument("--name", help="prefix of names in C (default: posegsa)")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> int:
    """Write a finished run in a format."""
    recording = None
    if options.recording is not None:
        (recording,) = read([options.recording], None, frame=options.frame)
    result = result_of(options, recording)
    if options.frame is not None:
        result = result.in_frame(options.frame)
    path = None if options.out is None else Path(options.out)
    text = export(result, options.format, options.name, None if path is None else path.name)
    if FORMATS[options.format].references and result.knows_scenario:
        known = result.known_sensors
        say(
            f"note: it has {counted(len(known.vectors), 'vector')} and "
            f"{counted(len(known.landmarks), 'landmark')} of the configuration's [scenario]; those "
            "of your own sensors: --recording FILE"
        )
    if path is None:
        sys.stdout.write(text)
        return 0
    _write_new(path, text, overwrite=options.overwrite)
    print(f"Written: {options.out}")
    if words := result.verdict():
        print(f"\n{words}")
    return 0


def _write_new(path: Path, text: str, *, overwrite: bool) -> None:
    """Write a file; refuse to replace an existing one without `overwrite`."""
    try:
        with path.open("w" if overwrite else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise PosegsaError(f"{path}: exists already; --overwrite replaces it") from None
    except OSError as error:
        raise PosegsaError(f"{path}: cannot be written: {error.strerror}") from None
