"""`posegsa compare`."""

import argparse

from posegsa import comparing, config
from posegsa.cli.parsers.arguments import drawn
from posegsa.cli.progress import CompareDisplay
from posegsa.optimisers.functions import ClassicalFunction
from posegsa.saving.interrupt import resumable


def run(options: argparse.Namespace) -> int:
    """Compare optimisers."""
    experiment = config.override(config.as_experiment(options.config), options.set)
    function = None
    if options.function is not None:
        function = ClassicalFunction(
            options.function, options.dimensions, options.shift, options.rotation
        )
    names = list(comparing.USUAL)
    if options.optimisers is not None:
        given = (name.strip() for name in options.optimisers.split(","))
        names = list(dict.fromkeys(filter(None, given)))
    kept = "searches that are done are kept, the same command goes on"
    how = "nothing is kept without --out" if options.out is None else kept
    with (
        resumable(lambda: f"interrupted; {how}"),
        CompareDisplay(names, quiet=options.quiet) as show,
    ):
        comparison = comparing.compare(
            experiment,
            optimisers=names,
            repeats=options.repeats,
            evaluations=options.evaluations,
            function=function,
            out=options.out,
            overwrite=options.overwrite,
            levels=options.levels,
            figures=options.figures,
            progress=show,
        )
    print(comparison.table(options.levels))
    if options.out is not None:
        figure = drawn(options, "comparison.png")
        print(f"\nWritten to {options.out}: comparison.json, comparison.txt{figure}")
    return 0
