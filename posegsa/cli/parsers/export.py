"""What can be typed after `posegsa export`."""

import argparse

from posegsa.export.formats import FORMATS


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "export",
        help=f"write a tuned filter or its schedule as {', '.join(FORMATS)}",
        description="Writes the filter of a finished run, or the controller of its gain.\n\n"
        + "\n".join(f"  {name:7}{format.about}" for name, format in FORMATS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    parser.add_argument("--format", choices=tuple(FORMATS), required=True)
    parser.add_argument("--out", metavar="FILE", help="file to write; default standard output")
    parser.add_argument("--overwrite", action="store_true", help="replace the file if there is one")
    parser.add_argument("--name", help="what names in C begin with; default posegsa")
    parser.set_defaults(command="export")
