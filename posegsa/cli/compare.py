"""`posegsa compare`."""

import argparse

from posegsa import comparing, config
from posegsa.cli.arguments import add_count, add_figures, add_search_arguments
from posegsa.cli.progress import CompareBar
from posegsa.optimisers.functions import FUNCTIONS, ClassicalFunction


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "compare",
        help="compare optimisers at equal budgets",
        description="Runs several optimisers many times on the same training scenarios, or on a "
        "test function, each with the same number of evaluations. Prints a table with paired "
        "tests; with --out it keeps each search in comparison.json, goes on where it was left, and "
        "ends with comparison.txt and .png.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment",
        setting="search.agents=50",
        out="folder to write to, and to go on from",
        replaced="another comparison in the folder",
    )
    parser.add_argument(
        "--optimisers",
        metavar="LIST",
        default=",".join(comparing.USUAL),
        help="names with commas between, each with settings of its own after colons if wanted, "
        "such as gsa:g0=1.0; the others are compared with the first (default: %(default)s)",
    )
    add_count(parser, "--repeats", 20, "searches of each")
    counted = "evaluations of a search; a gradient counts as gradient_price of them"
    add_count(parser, "--evaluations", 25000, counted)
    levels = "costs to reach, with commas between (default: medians of the optimisers)"
    parser.add_argument("--levels", type=_numbers, metavar="LIST", help=levels)
    functions = f"a test function instead of the filter: {', '.join(FUNCTIONS)}"
    parser.add_argument("--function", metavar="NAME", help=functions)
    add_count(parser, "--dimensions", 30, "of the function")
    shift = "move the function's minimum by this in every coordinate, in half widths of the box"
    parser.add_argument("--shift", type=float, default=0.0, metavar="S", help=shift)
    rotation = "turn the function about its minimum"
    parser.add_argument("--rotation", type=int, metavar="SEED", help=rotation)
    add_figures(parser)
    parser.set_defaults(command=_compare)


def _compare(options: argparse.Namespace) -> int:
    experiment = config.override(config.as_experiment(options.config), options.set)
    function = None
    if options.function is not None:
        function = ClassicalFunction(
            options.function, options.dimensions, options.shift, options.rotation
        )
    given = (name.strip() for name in options.optimisers.split(","))
    names = list(dict.fromkeys(filter(None, given)))
    with CompareBar(names, options.repeats, quiet=options.quiet) as show:
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
        drawn = "" if options.figures == [] else ", comparison.png"
        print(f"\nWritten to {options.out}: comparison.json, comparison.txt{drawn}")
    return 0


def _numbers(text: str) -> list[float]:
    """Read an argument as numbers with commas between."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: numbers, commas between") from None
