"""`posegsa evaluate`."""

import argparse
import sys

from posegsa import evaluating
from posegsa.arguments import MAX_INTEGER
from posegsa.cli.arguments import whole_number
from posegsa.cli.replay import RECORDING, add_window, read, window
from posegsa.errors import ArgumentError
from posegsa.judging.evaluation import CONSTANT
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.saving import recorded
from posegsa.saving.folder import locked_folder
from posegsa.saving.loading import load
from posegsa.saving.recorded import write_recorded
from posegsa.saving.run import write_run


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "evaluate",
        help="judge a finished run on more unseen scenarios or recordings, beside baselines",
        description="Judges a finished run on unseen scenarios beside the best constant gain, "
        "a time switch and other schedules searched with as many evaluations, and Kalman filters; "
        "minutes. "
        "Writes evaluation.json, evaluation.txt, figures and report.html to the run's folder. "
        "With --recording it judges the run on recordings instead, beside the best constant gains "
        f"and a Kalman filter, and writes {', '.join(recorded.FILES)}.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    scenarios = f"number of held-out scenarios (default: {evaluating.SCENARIOS})"
    parser.add_argument("--scenarios", type=whole_number(2), metavar="S", help=scenarios)
    seed = "another held-out set than the run's own; any whole number from 0"
    parser.add_argument("--seed", type=whole_number(0, MAX_INTEGER), metavar="N", help=seed)
    group = parser.add_argument_group(
        "recordings", "Judges a run on recorded motion, whatever it was tuned on."
    )
    group.add_argument("--recording", metavar="FILE", action="append", help=RECORDING)
    add_window(group)
    words = (
        "of a run that was tuned on recordings, one of these: constant gains and the Kalman filter "
        "are tuned on them (without any, both are left out)"
    )
    group.add_argument("--training", metavar="FILE", action="append", help=words)
    words = "the same as --window of those"
    group.add_argument("--training-window", metavar="A:B", type=window, help=words)
    parser.set_defaults(command=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    judge = _on_scenarios if options.recording is None else _on_recordings
    _check(options, load(options.run))  # where there is no run, nothing is made
    with locked_folder(options.run, overwrite=True) as folder:  # before the minutes, not after
        # Again: another process may have replaced it in between.
        return judge(options, load(folder), folder)


def _check(options: argparse.Namespace, result: TuneResult | RecordingResult) -> None:
    """Refuse options that mean nothing together, or for this run."""
    on_recordings = options.recording is not None
    others = ("scenarios", "seed") if on_recordings else ("window", "training", "training_window")
    for name in (name for name in others if getattr(options, name) is not None):
        allowed = "without --recording" if on_recordings else "with --recording"
        raise ArgumentError(f"--{name.replace('_', '-')}; allowed: {allowed}")
    if options.training_window is not None and options.training is None:
        raise ArgumentError("--training-window; allowed: with --training")
    if isinstance(result, RecordingResult) and not on_recordings:
        raise ArgumentError(
            f"{options.run}: was not tuned on scenarios; allowed: with --recording, which judges it"
        )


def _on_scenarios(options: argparse.Namespace, result, folder) -> int:
    scenarios = evaluating.SCENARIOS if options.scenarios is None else options.scenarios
    result = evaluating.evaluate(result, scenarios=scenarios, seed=options.seed, progress=_say)
    write_run(result, folder, same_run=True)
    print(result.evaluation.table())
    print(f"\n{result.endurance.table(CONSTANT)}")
    for warning in result.warnings():
        print(f"  warning: {warning}")
    print(f"\nWritten to {options.run}: report.html, evaluation.json, evaluation.txt, figures/")
    return 0


def _on_recordings(options: argparse.Namespace, result, folder) -> int:
    recordings = read(options.recording, options.window)
    training = read(options.training or [], options.training_window)
    for one in (*training, *recordings):
        print(one.describe())
    judged = evaluating.evaluate(result, recordings=recordings, training=training, progress=_say)
    write_recorded(judged, folder, same_run=True)
    print(f"\n{judged.summary()}")
    print(f"\nWritten to {options.run}: {', '.join(recorded.FILES)}")
    return 0


def _say(text: str) -> None:
    print(f"{text} ...", file=sys.stderr, flush=True)
