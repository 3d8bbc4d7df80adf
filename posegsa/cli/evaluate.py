"""`posegsa evaluate`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from posegsa.cli.arguments import (
    RECORDING,
    add_bridge,
    add_figures,
    add_quiet,
    add_window,
    drawn,
    read,
    whole_number,
    window,
)
from posegsa.cli.progress import Display
from posegsa.defaults import SCENARIOS
from posegsa.errors import ArgumentError
from posegsa.saving.interrupt import resumable

if TYPE_CHECKING:
    from posegsa.judging.recorded import RecordingResult
    from posegsa.judging.result import TuneResult


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "evaluate",
        help="compare a finished run with baselines on more unseen scenarios or on recordings",
        description="Compares a finished run on unseen scenarios with the best constant gain, "
        "a time switch and other schedules searched with as many evaluations, and with Kalman "
        "filters. Takes minutes. Writes the evaluation, figures and report.html to the run's "
        "folder, and the held-out means to its result.json. With --recording it compares the run "
        "on recordings instead, with the best constant gains and a Kalman filter.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    scenarios = f"number of held-out scenarios (default: {SCENARIOS})"
    parser.add_argument("--scenarios", type=whole_number(2), metavar="S", help=scenarios)
    seed = "use another held-out set than the run's own; any whole number from 0"
    parser.add_argument("--seed", type=whole_number(0), metavar="N", help=seed)
    add_figures(parser)
    add_quiet(parser)
    group = parser.add_argument_group("recordings", "Evaluates any run on recorded motion.")
    group.add_argument("--recording", metavar="FILE", action="append", help=RECORDING)
    add_window(group)
    add_bridge(group)
    words = (
        "a recording that the run was tuned on: constant gains and the Kalman filter are tuned on "
        "it too (without any, both are left out)"
    )
    group.add_argument("--training", metavar="FILE", action="append", help=words)
    words = "--window for the recordings of --training"
    group.add_argument("--training-window", metavar="A:B", type=window, help=words)
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> int:
    """Judge a finished run again."""
    from posegsa.saving.folder import locked_folder
    from posegsa.saving.loading import load

    judge = _on_scenarios if options.recording is None else _on_recordings
    _check(options, load(options.run))  # before `locked_folder`, which would make a missing folder
    with (
        locked_folder(options.run, overwrite=True) as folder,  # before the long evaluation
        resumable(lambda: "interrupted; the run is unchanged"),
    ):
        # Load again: another process may have replaced the run before the lock.
        return judge(options, load(folder), folder)


def _check(options: argparse.Namespace, result: "TuneResult | RecordingResult") -> None:
    """Refuse options that contradict each other or do not apply to this run."""
    from posegsa.judging.recorded import RecordingResult
    from posegsa.saving.run import run_figures

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
    from posegsa import evaluating
    from posegsa.judging.evaluation import CONSTANT
    from posegsa.saving.run import EVALUATION, REPORT, RESULT, TABLE, write_run

    scenarios = SCENARIOS if options.scenarios is None else options.scenarios
    with Display(quiet=options.quiet):
        result = evaluating.evaluate(result, scenarios=scenarios, seed=options.seed)
        write_run(result, folder, options.figures, same_run=True)
    print(result.evaluation.table())
    long = result.experiment.run.endurance_scenarios
    print(f"\n{result.endurance.table(CONSTANT, long)}")
    for warning in result.warnings():
        print(f"  warning: {warning}")
    print(f"\nWritten to {options.run}: {REPORT}, {EVALUATION}, {TABLE}{drawn(options)}")
    print(f"The held-out means in {RESULT} are now those of these scenarios.")
    return 0


def _on_recordings(options: argparse.Namespace, result, folder: Path) -> int:
    from posegsa import evaluating
    from posegsa.saving.recorded import FILES, write_recorded

    bridge = options.bridge, options.longest_gap
    recordings = read(options.recording, options.window, *bridge)
    training = read(options.training or [], options.training_window, *bridge)
    for one in (*training, *recordings):
        print(one.describe())
    with Display(quiet=options.quiet):
        judged = evaluating.evaluate(result, recordings=recordings, training=training)
    write_recorded(judged, folder, same_run=True)
    print(f"\n{judged.summary()}")
    print(f"\nWritten to {options.run}: {', '.join(FILES)}")
    return 0
