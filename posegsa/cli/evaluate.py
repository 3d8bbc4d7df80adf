"""`posegsa evaluate`."""

import argparse
import sys

from posegsa import evaluating
from posegsa.arguments import MAX_INTEGER
from posegsa.cli.arguments import add_figures, whole_number
from posegsa.judging.evaluation import CONSTANT
from posegsa.saving.folder import locked_folder
from posegsa.saving.run import load, run_figures, write_run


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "evaluate",
        help="judge a finished run on more unseen scenarios, beside all baselines",
        description="Judges a finished run on unseen scenarios beside the best constant gain, "
        "a time switch and other schedules searched with as many evaluations, and Kalman filters; "
        "minutes. "
        "Writes evaluation.json, evaluation.txt, figures and report.html to the run's folder.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    scenarios = "number of held-out scenarios (default: %(default)s)"
    count = whole_number(2)
    parser.add_argument("--scenarios", type=count, default=1000, metavar="S", help=scenarios)
    seed = "another held-out set than the run's own; any whole number from 0"
    parser.add_argument("--seed", type=whole_number(0, MAX_INTEGER), metavar="N", help=seed)
    add_figures(parser)
    parser.set_defaults(command=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    load(options.run)  # where there is no run, nothing is made
    figures = run_figures(options.figures)
    with locked_folder(options.run, overwrite=True) as folder:  # before the minutes, not after
        result = load(folder)  # again: another process may have replaced it in between
        result = evaluating.evaluate(
            result, scenarios=options.scenarios, seed=options.seed, progress=_say
        )
        write_run(result, folder, figures)
    print(result.evaluation.table())
    print(f"\n{result.endurance.table(CONSTANT)}")
    for warning in result.warnings():
        print(f"  warning: {warning}")
    print(f"\nWritten to {options.run}: report.html, evaluation.json, evaluation.txt, figures/")
    return 0


def _say(text: str) -> None:
    print(f"{text} ...", file=sys.stderr, flush=True)
