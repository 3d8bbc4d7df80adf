"""`posegsa tune`."""

import argparse
import warnings
from pathlib import Path
from typing import get_args

import jax

from posegsa import config, tuning
from posegsa.cli.arguments import add_search_arguments
from posegsa.cli.progress import TuneBar
from posegsa.cli.replay import RECORDING, add_window, read, window
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.saving import recorded
from posegsa.saving.checkpointing import CheckpointedRun, newest_checkpoint
from posegsa.search.devices import join_processes
from posegsa.search.recorded import RecordedSchedule

OUT = "posegsa-run"
"""Folder that is written to where none is given."""
FILES = "report.html, result.json, evaluation.json, .txt, history.csv, trajectory.csv, figures/"


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "tune",
        help="tune a gain schedule and judge it on unseen scenarios",
        description="Tunes a gain schedule and judges it on scenarios it was not tuned on. Writes "
        f"{FILES} to a folder.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment, or that of the run to resume",
        setting="filter.substeps=4",
        out=f"folder to write to, checkpoints too (default: {OUT})",
        replaced="the run that the folder holds",
    )
    resume = (
        "go on with the run in this folder; a CONFIG or settings must be those of the run, but for "
        "more iterations, and so must recordings"
    )
    parser.add_argument("--resume", metavar="DIR", help=resume)
    parser.add_argument("--iterations", type=int, metavar="N", help="replaces search.iterations")
    parser.add_argument("--seed", type=int, metavar="N", help="replaces run.seed")
    group = parser.add_argument_group(
        "recordings", "Tunes on recorded motion instead of simulated scenarios."
    )
    group.add_argument("--recording", metavar="FILE", action="append", help=RECORDING)
    group.add_argument("--held-out", metavar="FILE", action="append", help="one that only judges")
    add_window(group)
    group.add_argument(
        "--held-out-window", metavar="A:B", type=window, help="the same of those that only judge"
    )
    group.add_argument(
        "--schedule",
        choices=get_args(RecordedSchedule),
        help="what is searched: k1 to k22 (default), one gain, or K(e) of three numbers",
    )
    together = parser.add_argument_group(
        "several processes",
        "The same command in each, on one machine or many; the first writes the files. Without "
        "addresses, JAX asks the cluster (Slurm, Open MPI, Kubernetes and others).",
    )
    together.add_argument("--distributed", action="store_true", help="search together")
    waits = "where the first waits for the others"
    together.add_argument("--coordinator", metavar="HOST:PORT", help=waits)
    together.add_argument("--processes", type=int, metavar="N", help="how many they are")
    together.add_argument("--process", type=int, metavar="I", help="which one this is, from 0")
    parser.set_defaults(command=_tune)


def _tune(options: argparse.Namespace) -> int:
    first = _join(options)
    if options.recording is not None:
        return _tune_on_recordings(options)
    for name in ("held_out", "window", "held_out_window", "schedule"):
        if getattr(options, name) is not None:
            raise ArgumentError(f"--{name.replace('_', '-')}; allowed: with --recording")
    experiment = _experiment(options)
    out = OUT if options.out is None and options.resume is None else options.out
    with TuneBar(experiment.search.total_iterations, quiet=options.quiet or not first) as show:
        where = {"out": out, "overwrite": options.overwrite, "resume": options.resume}
        result = tuning.tune(experiment, **where, progress=show)
    if first:
        print(result.summary())
        print(f"\nWritten to {out or options.resume}: {FILES}")
    return 0


def _tune_on_recordings(options: argparse.Namespace) -> int:
    if options.distributed:
        raise ArgumentError("--recording with --distributed; allowed: one of them")
    experiment, schedule = _experiment(options), options.schedule
    out = OUT if options.out is None and options.resume is None else options.out
    if schedule is None and options.resume is not None:
        task = _run_to_resume(options).recorded
        schedule = None if task is None else task.schedule
    recordings = read(options.recording, options.window)
    held_out = read(options.held_out or [], options.held_out_window)
    for one in (*recordings, *held_out):
        print(one.describe())
    with TuneBar(experiment.search.total_iterations, quiet=options.quiet) as show:
        result = tuning.tune(
            experiment,
            recordings=recordings,
            held_out=held_out,
            schedule=schedule or "fuzzy",
            out=out,
            overwrite=options.overwrite,
            resume=options.resume,
            progress=show,
        )
    print(f"\n{result.summary()}")
    print(f"\nWritten to {out or options.resume}: {', '.join(recorded.FILES)}")
    return 0


def _join(options: argparse.Namespace) -> bool:
    """Join the other processes, if there are any; whether this is the one that shows and writes."""
    given = {name: getattr(options, name) for name in ("coordinator", "processes", "process")}
    if options.distributed:
        join_processes(**given)
        return jax.process_index() == 0
    for name, value in given.items():
        if value is not None:
            raise ArgumentError(f"--{name} = {value}; allowed: with --distributed")
    return True


def _run_to_resume(options: argparse.Namespace) -> CheckpointedRun:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)  # tune says it again
        return newest_checkpoint(Path(options.resume))


def _experiment(options: argparse.Namespace) -> config.Experiment:
    """What is to be searched: CONFIG, or that of the run to resume, with all settings."""
    if options.config is None and options.resume is not None:
        experiment = _run_to_resume(options).about.experiment
    else:
        experiment = config.as_experiment(options.config)
    replaced = {"run.seed": options.seed, "search.iterations": options.iterations}
    given = [f"{key}={value}" for key, value in replaced.items() if value is not None]
    return config.override(experiment, [*options.set, *given])
