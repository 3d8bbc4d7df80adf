"""`posegsa sweep`."""

import argparse
from typing import TYPE_CHECKING

from posegsa import config
from posegsa.cli.options import add_count, add_search_arguments
from posegsa.defaults import TOGETHER
from posegsa.errors import ArgumentError
from posegsa.progress import Display

if TYPE_CHECKING:
    from posegsa.judging.sweep_runs import Sweep

OUT = "posegsa-sweep"
"""Default folder."""


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "sweep",
        help="tune with every combination of values and seeds",
        description="Searches with every combination of values, each with several seeds. Each "
        "finished run is kept in the folder. The same command resumes the sweep, and more values "
        "or seeds are added to it. At the end, tables and figures are written to the folder.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment",
        setting="search.agents=50",
        out=f"folder to write to, or to resume from (default: {OUT})",
        replaced="another sweep in the folder",
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="SECTION.KEY=A,B,...",
        help="values of a key, e.g. filter.gamma=1,5,10; given several times, every combination "
        "is tried; a number set in this way is not searched",
    )
    add_count(parser, "--seeds", 1, "searches per combination, with the seeds from run.seed on")
    parser.add_argument(
        "--shard",
        type=_shard,
        default=(1, 1),
        metavar="I/N",
        help="run the I-th of N parts, I from 1; all parts may run at once and share the folder",
    )
    add_count(parser, "--together", TOGETHER, "maximum number of searches in one batch")
    parser.add_argument(
        "--merge",
        nargs="+",
        metavar="DIR",
        help="do not search: merge the runs of these folders into --out or the first folder",
    )
    parser.set_defaults(command=run)


def _shard(text: str) -> tuple[int, int]:
    """Read an argument as a part and the number of parts."""
    part, _, parts = text.partition("/")
    if not (part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: I/N with 1 <= I <= N")
    return int(part), int(parts)


def run(options: argparse.Namespace) -> int:
    """Search with other values and seeds, or merge the runs of several folders."""
    from posegsa import sweeping
    from posegsa.saving.sweep_folder import merge_sweeps

    if options.merge is not None:
        for name in ("config", "set", "vary"):
            if getattr(options, name):
                raise ArgumentError(f"--merge with {name}; allowed: folders, and --out")
        _show(merge_sweeps(options.merge, options.out), options.out or options.merge[0])
        return 0
    base = config.override(config.as_experiment(options.config), options.set)
    vary = dict(map(config.values_of, options.vary))
    if len(vary) < len(options.vary):
        raise ArgumentError("--vary: a key is given twice; allowed: once, with all its values")
    out, (part, parts) = options.out or OUT, options.shard
    with Display(quiet=options.quiet):
        found = sweeping.sweep(
            base,
            vary=vary,
            seeds=options.seeds,
            out=out,
            shard=options.shard,
            together=options.together,
            overwrite=options.overwrite,
        )
    if parts == 1:
        _show(found, out)
    else:
        print(f"Part {part} of {parts} is done. After all parts: posegsa sweep --merge {out}")
    return 0


def _show(found: "Sweep", folder: str) -> None:
    from posegsa.saving.folder import FIGURES
    from posegsa.saving.sweep_folder import FILES

    print(found.table())
    print(f"\nWritten to {folder}: {', '.join(FILES)}, {FIGURES}/")
