"""`posegsa evaluate`."""

import argparse

from posegsa import evaluating
from posegsa.cli.progress import Display
from posegsa.judging.evaluation import CONSTANT
from posegsa.saving.folder import locked_folder
from posegsa.saving.interrupt import resumable
from posegsa.saving.run import load, run_figures, write_run


def run(options: argparse.Namespace) -> int:
    """Judge a finished run anew."""
    load(options.run)  # where there is no run, nothing is made
    figures = run_figures(options.figures)
    with locked_folder(options.run, overwrite=True) as folder:  # before the minutes, not after
        result = load(folder)  # again: another process may have replaced it in between
        with resumable(lambda: "interrupted; the run is as it was"), Display(quiet=options.quiet):
            result = evaluating.evaluate(result, scenarios=options.scenarios, seed=options.seed)
            write_run(result, folder, figures)
    print(result.evaluation.table())
    print(f"\n{result.endurance.table(CONSTANT)}")
    for warning in result.warnings():
        print(f"  warning: {warning}")
    print(f"\nWritten to {options.run}: report.html, evaluation.json, evaluation.txt, figures/")
    return 0
