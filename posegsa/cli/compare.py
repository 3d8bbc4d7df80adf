"""The command line's `posegsa compare`."""

import argparse

from posegsa.cli.arguments import (
    add_config,
    add_folder,
    add_quiet,
    add_settings,
    numbers,
    whole_number,
)
from posegsa.cli.progress import CompareBar

# Everything that starts JAX is imported inside the command, after the fast path is set.


def add_compare(commands) -> None:
    """Add the command to the others."""
    compare = commands.add_parser(
        "compare",
        help="compare optimisers at equal budgets",
        description="Runs several optimisers many times on the same training scenarios, or on a "
        "test function, each with the same number of evaluations. Prints a table with paired "
        "tests; with --out it keeps each search in comparison.json, goes on where it was left, and "
        "ends with comparison.txt and .png.",
    )
    add_config(compare)
    compare.add_argument(
        "--optimisers",
        metavar="LIST",
        default="gsa,random,pso,de,cma_es,adam,gsa+adam",
        help="names with commas between, each with settings of its own after colons if wanted, "
        "such as gsa:g0=1.0; the others are compared with the first (default: %(default)s)",
    )
    compare.add_argument(
        "--repeats",
        type=whole_number(1),
        default=20,
        metavar="N",
        help="searches of each (%(default)s)",
    )
    compare.add_argument(
        "--evaluations",
        type=whole_number(1),
        default=25000,
        metavar="N",
        help="evaluations of a search; a gradient counts as adam.gradient_price (%(default)s)",
    )
    compare.add_argument(
        "--levels",
        type=numbers,
        metavar="LIST",
        help="costs to reach, with commas between (default: medians of the optimisers)",
    )
    compare.add_argument(
        "--function",
        metavar="NAME",
        help="a test function instead of the filter: sphere, ellipsoid, rosenbrock, rastrigin, "
        "ackley, griewank, schwefel",
    )
    compare.add_argument(
        "--dimensions", type=whole_number(1), default=30, metavar="N", help="of the function (30)"
    )
    compare.add_argument(
        "--shift",
        type=float,
        default=0.0,
        metavar="S",
        help="move the function's minimum by this in every coordinate, in half widths of the box",
    )
    compare.add_argument(
        "--rotation", type=int, metavar="SEED", help="turn the function about its minimum"
    )
    add_folder(
        compare,
        "folder to write to, and to go on from",
        replaced="another comparison in the folder",
    )
    add_settings(compare, "search.agents=50")
    add_quiet(compare)
    compare.set_defaults(command=_compare)


def _compare(options: argparse.Namespace) -> int:
    from posegsa import config
    from posegsa.comparing import compare
    from posegsa.errors import ConfigError
    from posegsa.optimisers.functions import ClassicalFunction

    experiment = config.override(config.as_experiment(options.config), options.set)
    function = None
    if options.function is not None:
        try:
            function = ClassicalFunction(
                options.function, options.dimensions, options.shift, options.rotation
            )
        except ValueError as error:
            raise ConfigError(str(error)) from None
    names = [name.strip() for name in options.optimisers.split(",") if name.strip()]
    names = list(dict.fromkeys(names))
    with CompareBar(names, options.repeats, quiet=options.quiet) as show:
        comparison = compare(
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
