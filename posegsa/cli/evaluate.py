"""`posegsa evaluate`."""

import argparse
from contextlib import suppress
from typing import TYPE_CHECKING

from posegsa.cli.options import (
    RECORDING,
    add_bridge,
    add_figures,
    add_frame,
    add_quiet,
    add_run,
    add_window,
    as_read_with,
    is_configuration,
    read,
    result_of,
    whole_number,
    window,
)
from posegsa.defaults import SCENARIOS
from posegsa.errors import ArgumentError
from posegsa.progress import Display
from posegsa.saving.interrupt import resumable

if TYPE_CHECKING:
    from posegsa.judging.result import Result


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "evaluate",
        help="compare a finished run with baselines on more unseen scenarios or on recordings",
        description="Compares a finished run on unseen scenarios with the best constant gain, "
        "a time switch and other schedules searched with as many evaluations, and with Kalman "
        "filters: fixed, iterated, gated and by the clock, whose noises are searched from those of "
        "the data sheet on, until 200 evaluations improve them by less than 1 %, at most 1000. "
        "Takes minutes. Writes the evaluation, figures and report.html to the run's "
        "folder, and the held-out means to its result.json. With --recording it compares the run "
        "on recordings instead, with the best constant gains and a Kalman filter.",
    )
    add_run(parser)
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
    add_frame(group, "its own, or that of the run, or ENU")
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
    _check(options)
    from posegsa.saving.folder import locked_folder
    from posegsa.saving.result_files import run_figures, write_result, written

    run_figures(options.figures)
    result = result_of(options)  # before `locked_folder`, which would make a missing folder
    if is_configuration(options.run):
        print(_words(options, _judged(options, result)))
        print(f"\nNothing was written: {options.run} is a configuration, not the folder of a run.")
        return 0
    with (
        locked_folder(options.run, overwrite=True) as folder,  # before the long evaluation
        resumable(lambda: "interrupted; the run is unchanged"),
    ):
        # Load again: another process may have replaced the run before the lock.
        judged = _judged(options, result_of(options))
        try:
            write_result(judged, folder, options.figures, own_checkpoints=True)
        except OSError:
            with suppress(OSError):  # the reason that it can't be written comes last
                print(_words(options, judged), flush=True)
            raise
    # Only now, as a closed pipe ends the process.
    print(_words(options, judged))
    print(f"\nWritten to {options.run}: {', '.join(written(options.run))}")
    return 0


def _check(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other."""
    on_recordings = options.recording is not None
    others = ("window", "bridge", "longest_gap", "frame", "training", "training_window")
    if on_recordings:
        others = ("scenarios", "seed")
    for name in (name for name in others if getattr(options, name) not in (None, [])):
        allowed = "without --recording" if on_recordings else "with --recording"
        raise ArgumentError(f"--{name.replace('_', '-')}; allowed: {allowed}")
    if options.training_window is not None and options.training is None:
        raise ArgumentError("--training-window; allowed: with --training")


def _judged(options: argparse.Namespace, result: "Result") -> "Result":
    """The result with the judgement that the command requests."""
    from posegsa import evaluating

    if options.recording is None:
        scenarios = SCENARIOS if options.scenarios is None else options.scenarios
        with Display(quiet=options.quiet):
            return evaluating.evaluate(result, scenarios=scenarios, seed=options.seed)
    how = options.bridge, options.longest_gap, options.frame, result.frame
    recordings = read(options.recording, options.window, *how)
    training = read(options.training or [], options.training_window, *how)
    recordings, training = (
        as_read_with(options, result.filter.kind, each) for each in (recordings, training)
    )
    for one in (*training, *recordings):
        print(one.describe())
    with Display(quiet=options.quiet):
        return evaluating.evaluate(result, recordings=recordings, training=training)


def _words(options: argparse.Namespace, result: "Result") -> str:
    """What is printed of a judgement."""
    judged = result.on_scenarios
    if options.recording is not None or judged is None:
        return f"\n{result.summary()}"
    long = result.experiment.run.endurance_scenarios
    parts = [judged.evaluation.table(), judged.long_after(long), judged.evaluation.verdict()]
    warnings = (f"\n  warning: {warning}" for warning in result.warnings())
    return "\n\n".join(part for part in parts if part) + "".join(warnings)
