"""`posegsa compare`."""

import argparse

from posegsa import config
from posegsa.cli.options import add_count, add_figures, add_search_arguments
from posegsa.defaults import EVALUATIONS, REPEATS
from posegsa.progress import Display
from posegsa.saving.interrupt import resumable


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "compare",
        help="compare optimisers at equal budgets",
        description="Runs several optimisers many times on the same training scenarios, or on a "
        "test function, each with the same number of evaluations. Prints a table with paired "
        "tests. With --out each search is kept in the folder, the same command resumes the "
        "comparison, and the table and a figure are written at the end.",
    )
    parser.late_epilog = _names
    add_search_arguments(
        parser,
        config="the recommended experiment",
        setting="search.agents=50",
        out="folder to write to, or to resume from",
        replaced="another comparison in the folder",
    )
    parser.add_argument(
        "--optimisers",
        metavar="LIST",
        help="names separated by commas; settings of an optimiser follow its name after colons, "
        "e.g. gsa:g0=1.0; the others are compared with the first (default: see below)",
    )
    add_count(parser, "--repeats", REPEATS, "searches per optimiser")
    counted = "evaluations per search; a gradient counts as gradient_price evaluations"
    add_count(parser, "--evaluations", EVALUATIONS, counted)
    levels = "costs to reach, separated by commas (default: medians of the optimisers)"
    parser.add_argument("--levels", type=_numbers, metavar="LIST", help=levels)
    function = "minimise a test function instead of tuning the filter (see below)"
    parser.add_argument("--function", metavar="NAME", help=function)
    add_count(parser, "--dimensions", 30, "dimensions of the test function")
    shift = "move the function's minimum by this in every coordinate, in half widths of the box"
    parser.add_argument("--shift", type=float, default=0.0, metavar="S", help=shift)
    rotation = "rotate the function about its minimum, by a random rotation from this seed"
    parser.add_argument("--rotation", type=int, metavar="SEED", help=rotation)
    add_figures(parser)
    parser.set_defaults(command=run)


def _names() -> str:
    """The epilogue of the help: the available optimisers and test functions."""
    from posegsa.optimisers import OPTIMISERS
    from posegsa.optimisers.functions import FUNCTIONS

    return (
        f"Optimisers (default: all): {','.join(OPTIMISERS)}. "
        f"Test functions: {', '.join(FUNCTIONS)}."
    )


def _numbers(text: str) -> list[float]:
    """Read an argument as numbers separated by commas."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}; allowed: numbers separated by commas"
        ) from None


def run(options: argparse.Namespace) -> int:
    """Compare optimisers."""
    from posegsa import comparing
    from posegsa.optimisers import OPTIMISERS
    from posegsa.optimisers.functions import ClassicalFunction
    from posegsa.saving.comparison_files import DATA, FIGURE, TABLE

    experiment = config.override(config.as_experiment(options.config), options.set)
    function = None
    if options.function is not None:
        function = ClassicalFunction(
            options.function, options.dimensions, options.shift, options.rotation
        )
    names = list(OPTIMISERS)
    if options.optimisers is not None:
        given = (name.strip() for name in options.optimisers.split(","))
        names = list(dict.fromkeys(filter(None, given)))
    kept = "finished searches are kept; the same command resumes the comparison"
    how = "nothing is kept without --out" if options.out is None else kept
    with resumable(lambda: f"interrupted; {how}"), Display(quiet=options.quiet):
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
        )
    print(comparison.table(options.levels))
    if options.out is not None:
        files = [DATA, TABLE] if options.figures == [] else [DATA, TABLE, FIGURE]
        print(f"\nWritten to {options.out}: {', '.join(files)}")
    return 0
