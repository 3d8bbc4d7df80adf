"""What can be typed after `posegsa compare`."""

import argparse

from posegsa.cli.parsers.arguments import add_count, add_figures, add_search_arguments

# Named here too, as a test sees to: what defines them imports JAX, which takes longer than help.
USUAL = ("gsa", "random_search", "pso", "de", "cma_es", "adam", "gsa+adam")
"""The optimisers that are compared unless others are asked for."""
FUNCTIONS = ("sphere", "ellipsoid", "rosenbrock", "rastrigin", "ackley", "griewank", "schwefel")
"""The test functions."""


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "compare",
        help="compare optimisers at equal budgets",
        description="Runs several optimisers many times on the same training scenarios, or on a "
        "test function, each with the same number of evaluations. Prints a table with paired "
        "tests; with --out it keeps each search in comparison.json, goes on where it was left, and "
        "ends with comparison.txt and .png.",
        epilog=f"Optimisers without --optimisers: {','.join(USUAL)}. Test functions: "
        f"{', '.join(FUNCTIONS)}.",
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
        help="names with commas between, each with settings of its own after colons if wanted, "
        "such as gsa:g0=1.0; the others are compared with the first (default: see below)",
    )
    add_count(parser, "--repeats", 20, "searches of each")
    counted = "evaluations of a search; a gradient counts as gradient_price of them"
    add_count(parser, "--evaluations", 25000, counted)
    levels = "costs to reach, with commas between (default: medians of the optimisers)"
    parser.add_argument("--levels", type=_numbers, metavar="LIST", help=levels)
    function = "a test function instead of the filter (see below)"
    parser.add_argument("--function", metavar="NAME", help=function)
    add_count(parser, "--dimensions", 30, "of the function")
    shift = "move the function's minimum by this in every coordinate, in half widths of the box"
    parser.add_argument("--shift", type=float, default=0.0, metavar="S", help=shift)
    rotation = "turn the function about its minimum"
    parser.add_argument("--rotation", type=int, metavar="SEED", help=rotation)
    add_figures(parser)
    parser.set_defaults(command="compare")


def _numbers(text: str) -> list[float]:
    """Read an argument as numbers with commas between."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: numbers, commas between") from None
