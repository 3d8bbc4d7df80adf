"""`posegsa evaluate`."""

import argparse
from pathlib import Path

from posegsa import evaluating
from posegsa.cli.parsers.arguments import drawn
from posegsa.cli.progress import Display
from posegsa.cli.replay import read
from posegsa.errors import ArgumentError
from posegsa.judging.evaluation import CONSTANT
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.saving import recorded
from posegsa.saving.folder import locked_folder
from posegsa.saving.interrupt import resumable
from posegsa.saving.loading import load
from posegsa.saving.recorded import write_recorded
from posegsa.saving.run import run_figures, write_run


def run(options: argparse.Namespace) -> int:
    """Judge a finished run anew."""
    judge = _on_scenarios if options.recording is None else _on_recordings
    _check(options, load(options.run))  # where there is no run, nothing is made
    with (
        locked_folder(options.run, overwrite=True) as folder,  # before the minutes, not after
        resumable(lambda: "interrupted; the run is as it was"),
    ):
        # Again: another process may have replaced it in between.
        return judge(options, load(folder), folder)


def _check(options: argparse.Namespace, result: TuneResult | RecordingResult) -> None:
    """Refuse options that mean nothing together, or for this run."""
    on_recordings = options.recording is not None
    others = ("window", "bridge", "longest_gap", "training", "training_window")
    if on_recordings:
        others = ("scenarios", "seed", "figures")
    for name in (name for name in others if getattr(options, name) not in (None, [])):
        allowed = "without --recording" if on_recordings else "with --recording"
        raise ArgumentError(f"--{name.replace('_', '-')}; allowed: {allowed}")
    if options.training_window is not None and options.training is None:
        raise ArgumentError("--training-window; allowed: with --training")
    if isinstance(result, RecordingResult) and not on_recordings:
        raise ArgumentError(
            f"{options.run}: was not tuned on scenarios; allowed: with --recording, which judges it"
        )
    run_figures(options.figures)


def _on_scenarios(options: argparse.Namespace, result, folder: Path) -> int:
    scenarios = evaluating.SCENARIOS if options.scenarios is None else options.scenarios
    with Display(quiet=options.quiet):
        result = evaluating.evaluate(result, scenarios=scenarios, seed=options.seed)
        write_run(result, folder, options.figures, same_run=True)
    print(result.evaluation.table())
    long = result.experiment.run.endurance_scenarios
    print(f"\n{result.endurance.table(CONSTANT, long)}")
    for warning in result.warnings():
        print(f"  warning: {warning}")
    files = f"report.html, evaluation.json, evaluation.txt{drawn(options)}"
    print(f"\nWritten to {options.run}: {files}")
    print("The held-out means in its result.json are those of these scenarios now.")
    return 0


def _on_recordings(options: argparse.Namespace, result, folder: Path) -> int:
    bridge = options.bridge, options.longest_gap
    recordings = read(options.recording, options.window, *bridge)
    training = read(options.training or [], options.training_window, *bridge)
    for one in (*training, *recordings):
        print(one.describe())
    with Display(quiet=options.quiet):
        judged = evaluating.evaluate(result, recordings=recordings, training=training)
    write_recorded(judged, folder, same_run=True)
    print(f"\n{judged.summary()}")
    print(f"\nWritten to {options.run}: {', '.join(recorded.FILES)}")
    return 0
