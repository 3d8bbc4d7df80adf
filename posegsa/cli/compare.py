"""`posegsa compare`."""

import argparse

from posegsa import comparing, config
from posegsa.cli.arguments import add_search_arguments, whole_number
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
    parser.add_argument(
        "--repeats",
        type=whole_number(1),
        default=20,
        metavar="N",
        help="searches of each (default: %(default)s)",
    )
    parser.add_argument(
        "--evaluations",
        type=whole_number(1),
        default=25000,
        metavar="N",
        help="evaluations of a search; a gradient counts as gradient_price of them "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--levels",
        type=_numbers,
        metavar="LIST",
        help="costs to reach, with commas between (default: medians of the optimisers)",
    )
    parser.add_argument(
        "--function",
        metavar="NAME",
        help=f"a test function instead of the filter: {', '.join(FUNCTIONS)}",
    )
    parser.add_argument(
        "--dimensions",
        type=whole_number(1),
        default=30,
        metavar="N",
        help="of the function (default: %(default)s)",
    )
    parser.add_argument(
        "--shift",
        type=float,
        default=0.0,
        metavar="S",
        help="move the function's minimum by this in every coordinate, in half widths of the box",
    )
    parser.add_argument(
        "--rotation", type=int, metavar="SEED", help="turn the function about its minimum"
    )
    parser.set_defaults(command=_compare)


def _compare(options: argparse.Namespace) -> int:
    experiment = config.override(config.as_experiment(options.config), options.set)
    function = None
    if options.function is not None:
        function = ClassicalFunction(
            options.function, options.dimensions, options.shift, options.rotation
        )
    names = [name.strip() for name in options.optimisers.split(",") if name.strip()]
    names = list(dict.fromkeys(names))
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
            progress=show,
        )
    print(comparison.table(options.levels))
    if options.out is not None:
        print(f"\nWritten to {options.out}: comparison.json, comparison.txt, comparison.png")
    return 0


def _numbers(text: str) -> list[float]:
    """Read an argument as numbers with commas between."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: numbers, commas between") from None
