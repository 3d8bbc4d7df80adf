"""`posegsa tune`."""

import argparse
import warnings
from pathlib import Path

import jax

from posegsa import config, tuning
from posegsa.cli.parsers.tune import FILES, OUT
from posegsa.cli.progress import TuneDisplay
from posegsa.cli.replay import read
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.saving import recorded
from posegsa.saving.checkpointing import newest_checkpoint
from posegsa.search.devices import join_processes


def run(options: argparse.Namespace) -> int:
    """Tune, judge and say what came out."""
    first = _join(options)
    if options.recording is not None:
        return _tune_on_recordings(options)
    for name in ("held_out", "window", "held_out_window", "schedule"):
        if getattr(options, name) is not None:
            raise ArgumentError(f"--{name.replace('_', '-')}; allowed: with --recording")
    experiment = _experiment(options)
    out = OUT if options.out is None and options.resume is None else options.out
    with TuneDisplay(_judging(experiment), quiet=options.quiet or not first) as show:
        where = {"out": out, "overwrite": options.overwrite, "resume": options.resume}
        where["figures"] = options.figures
        result = tuning.tune(experiment, **where, progress=show)
    if options.resume is not None and not show.began:
        print(f"{options.resume} is finished already: nothing was searched. --iterations has more.")
    if first:
        print(result.summary())
        print(f"\nWritten to {out or options.resume}: {FILES}")
    return 0


def _tune_on_recordings(options: argparse.Namespace) -> int:
    if options.resume is not None or options.distributed:
        raise ArgumentError("--recording with --resume or --distributed; allowed: one of them")
    if options.figures is not None:
        raise ArgumentError("--recording with --figures; allowed: one of them, as none are drawn")
    experiment, out = _experiment(options), options.out or OUT
    recordings = read(options.recording, options.window)
    held_out = read(options.held_out or [], options.held_out_window)
    for one in (*recordings, *held_out):
        print(one.describe())
    with TuneDisplay(_judging(experiment), quiet=options.quiet) as show:
        result = tuning.tune(
            experiment,
            recordings=recordings,
            held_out=held_out,
            schedule=options.schedule or "fuzzy",
            out=out,
            overwrite=options.overwrite,
            progress=show,
        )
    print(f"\n{result.summary()}")
    print(f"\nWritten to {out}: {', '.join(recorded.FILES)}")
    return 0


def _judging(experiment: config.Experiment) -> str:
    """What judging will take: the best constant gains are searched too where more is tuned."""
    return f"then {'about as long' if experiment.also else 'seconds'} to judge what it finds"


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


def _experiment(options: argparse.Namespace) -> config.Experiment:
    """What is to be searched: CONFIG, or that of the run to resume, with all settings."""
    if options.config is None and options.resume is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PosegsaWarning)  # tune says it again
            experiment = newest_checkpoint(Path(options.resume)).about.experiment
    else:
        experiment = config.as_experiment(options.config)
    replaced = {"run.seed": options.seed, "search.iterations": options.iterations}
    given = [f"{key}={value}" for key, value in replaced.items() if value is not None]
    return config.override(experiment, [*options.set, *given])
