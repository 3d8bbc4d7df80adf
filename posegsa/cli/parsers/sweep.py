"""What can be typed after `posegsa sweep`."""

import argparse

from posegsa.cli.parsers.arguments import add_count, add_search_arguments

OUT = "posegsa-sweep"
"""Folder that is written to where none is given."""
FILES = "sweep.txt, sweep.csv, runs.csv, figures/"


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "sweep",
        help="tune with other values and seeds, side by side",
        description="Searches with every combination of values, each with several seeds. Each run "
        "is kept in the folder as it is done; the same command goes on where it was left, and more "
        f"values or seeds come to those that are there. Ends with {FILES} in the folder.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment",
        setting="search.agents=50",
        out=f"folder to write to, and to go on from (default: {OUT})",
        replaced="another sweep in the folder",
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="SECTION.KEY=A,B,...",
        help="values of a key, e.g. filter.gamma=1,5,10; may be given again, for every "
        "combination; what is set so is not searched",
    )
    add_count(parser, "--seeds", 1, "searches of each, with the seeds from run.seed on")
    parser.add_argument(
        "--shard",
        type=_shard,
        default=(1, 1),
        metavar="I/N",
        help="make the I-th of N parts, from 1; they may run at once and share the folder",
    )
    add_count(parser, "--together", 16, "searches of one batch, at most")
    parser.add_argument(
        "--merge",
        nargs="+",
        metavar="DIR",
        help="search nothing: put the runs of these folders together, in --out or the first",
    )
    parser.set_defaults(command="sweep")


def _shard(text: str) -> tuple[int, int]:
    """Read an argument as a part and the number of parts."""
    part, _, parts = text.partition("/")
    if not (part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: I/N with 1 <= I <= N")
    return int(part), int(parts)
