"""The command line's `posegsa compare`."""

import argparse

# Everything that starts JAX is imported inside the command, after the fast path is set.


def add_compare(commands) -> None:
    """Add the command to the others."""
    compare = commands.add_parser(
        "compare",
        help="compare optimisers at equal budgets",
        description="Runs several optimisers many times on the same training scenarios, or on a "
        "test function, each with the same number of evaluations. Prints a table with paired "
        "tests; with --out it writes comparison.json, .txt and .png after each search, and goes on "
        "where it was left.",
    )
    compare.add_argument(
        "config",
        nargs="?",
        metavar="CONFIG",
        help="TOML file of the experiment; without it, the recommended experiment",
    )
    compare.add_argument(
        "--optimisers",
        metavar="LIST",
        default="gsa,random,pso,de,cma_es,adam,gsa+adam",
        help="names with commas between, each with settings of its own after colons if wanted, "
        "such as gsa:g0=1.0; the others are compared with the first (default: %(default)s)",
    )
    compare.add_argument(
        "--repeats", type=_positive, default=20, metavar="N", help="searches of each (%(default)s)"
    )
    compare.add_argument(
        "--evaluations",
        type=_positive,
        default=25000,
        metavar="N",
        help="evaluations of a search; a gradient counts as adam.gradient_price (%(default)s)",
    )
    compare.add_argument(
        "--levels",
        type=_numbers,
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
        "--dimensions", type=_positive, default=30, metavar="N", help="of the function (30)"
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
    compare.add_argument("--out", metavar="DIR", help="folder to write to, and to go on from")
    compare.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="replaces a value of the experiment, e.g. search.agents=50; may be given again",
    )
    compare.add_argument(
        "--overwrite", action="store_true", help="replace another comparison in the folder"
    )
    compare.add_argument("--quiet", action="store_true", help="show no progress")
    compare.set_defaults(command=_compare)


def _positive(text: str) -> int:
    if not (text.isdecimal() and int(text) >= 1):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number from 1")
    return int(text)


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: numbers, commas between") from None


def _compare(options: argparse.Namespace) -> int:
    from posegsa import config
    from posegsa.compare import compare
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
    show = _Progress(len(names), options.repeats, quiet=options.quiet)
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
    show.close()
    print(comparison.table(options.levels))
    if options.out is not None:
        print(f"\nWritten to {options.out}: comparison.json, comparison.txt, comparison.png")
    return 0


class _Progress:
    """A progress bar over all searches."""

    def __init__(self, optimisers: int, repeats: int, *, quiet: bool) -> None:
        from tqdm import tqdm

        self.bar = tqdm(
            total=optimisers * repeats,
            desc="compiling",
            disable=quiet,
            dynamic_ncols=True,
            bar_format="{desc} {bar} {percentage:3.0f}% [{elapsed}<{remaining}{postfix}]",
        )
        self.names: list[str] = []

    def __call__(self, status) -> None:
        if status.optimiser not in self.names:
            self.names.append(status.optimiser)
        done = (len(self.names) - 1) * status.repeats + status.repeat + status.share
        self.bar.set_description_str(f"{status.optimiser} {status.repeat + 1}/{status.repeats}")
        self.bar.set_postfix_str(f"best cost {status.best_cost:.4g}", refresh=False)
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        """End the bar's line."""
        self.bar.set_description_str("done")
        self.bar.close()
