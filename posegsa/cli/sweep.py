"""`posegsa sweep`."""

import argparse

from posegsa import config, sweeping
from posegsa.cli.parsers.sweep import FILES, OUT
from posegsa.cli.progress import SweepDisplay
from posegsa.errors import ArgumentError
from posegsa.judging.sweep import Sweep
from posegsa.saving.sweep import merge_sweeps


def run(options: argparse.Namespace) -> int:
    """Search with other values and seeds, or put such runs together."""
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
    with SweepDisplay(quiet=options.quiet) as show:
        found = sweeping.sweep(
            base,
            vary=vary,
            seeds=options.seeds,
            out=out,
            shard=options.shard,
            together=options.together,
            overwrite=options.overwrite,
            progress=show,
        )
    if parts == 1:
        _show(found, out)
    else:
        print(f"Part {part} of {parts} is done; with all of them: posegsa sweep --merge {out}")
    return 0


def _show(found: Sweep, folder: str) -> None:
    print(found.table())
    print(f"\nWritten to {folder}: {FILES}")
