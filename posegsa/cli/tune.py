"""`posegsa tune`."""

import argparse
import shlex
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from posegsa import config
from posegsa.cli.arguments import (
    RECORDING,
    add_bridge,
    add_figures,
    add_imu,
    add_search_arguments,
    add_window,
    drawn,
    read,
    refuse_imu_options,
    window,
)
from posegsa.cli.progress import Display
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.saving.interrupt import resumable
from posegsa.search.recorded_schedules import RecordedSchedule

if TYPE_CHECKING:
    from posegsa.saving.checkpointing import CheckpointedRun

OUT = "posegsa-run"
"""Default folder."""


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "tune",
        help="tune a gain schedule and judge it on unseen scenarios",
        description="Tunes a gain schedule and judges it on scenarios it was not tuned on. "
        "Writes the result, tables, figures and report.html to a folder. With --recording it "
        "tunes on recordings, and writes only result and table.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment, or that of the run to resume",
        setting="filter.substeps=4",
        out=f"folder for results and checkpoints (default: {OUT})",
        replaced="the run in the folder",
    )
    add_figures(parser)
    resume = (
        "resume the run in this folder; CONFIG, settings and recordings must be those of the run, "
        "except that there may be more iterations"
    )
    parser.add_argument("--resume", metavar="DIR", help=resume)
    parser.add_argument(
        "--iterations", type=int, metavar="N", help="same as --set search.iterations=N"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="same as --set run.seed=N")
    group = parser.add_argument_group(
        "recordings", "Tunes on recorded motion instead of simulated scenarios."
    )
    group.add_argument("--recording", metavar="FILE", action="append", help=RECORDING)
    group.add_argument(
        "--held-out", metavar="FILE", action="append", help="a recording to judge on"
    )
    add_window(group)
    group.add_argument(
        "--held-out-window", metavar="A:B", type=window, help="--window for --held-out"
    )
    add_bridge(group)
    add_imu(group)
    group.add_argument(
        "--schedule",
        choices=get_args(RecordedSchedule),
        help="what is searched: k1 to k22 (default), one gain, or K(e) with three parameters",
    )
    together = parser.add_argument_group(
        "several processes",
        "Start the same command in each process, on one machine or several; the first process "
        "writes the files. Without addresses, JAX asks the cluster (Slurm, Open MPI, Kubernetes "
        "and others).",
    )
    searched = "search in several processes together"
    together.add_argument("--distributed", action="store_true", help=searched)
    waits = "address at which the first process waits for the others"
    together.add_argument("--coordinator", metavar="HOST:PORT", help=waits)
    together.add_argument("--processes", type=int, metavar="N", help="number of processes")
    together.add_argument("--process", type=int, metavar="I", help="this process's index, from 0")
    parser.set_defaults(command=run)


def run(options: argparse.Namespace) -> int:
    """Tune, judge and print the result."""
    from posegsa import tuning
    from posegsa.config.imu import names_imu
    from posegsa.saving.run import FILES

    first = _join(options)
    if names_imu(options.config):
        return _tune_imu(options)
    refuse_imu_options(options)
    if options.recording is not None:
        return _tune_on_recordings(options)
    for name in (
        *("held_out", "window", "held_out_window", "schedule"),
        *("bridge", "longest_gap"),
    ):
        if getattr(options, name) is not None:
            raise ArgumentError(f"--{name.replace('_', '-')}; allowed: with --recording")
    experiment = _experiment(options)
    out = OUT if options.out is None and options.resume is None else options.out
    # If more than the schedule is tuned, judging searches the best constant gains too.
    judging = f"then {'about as long' if experiment.also else 'seconds'} to judge what it finds"
    with Display(quiet=options.quiet or not first, after_search=judging) as show:
        where = {"out": out, "overwrite": options.overwrite, "resume": options.resume}
        where["figures"] = options.figures
        result = tuning.tune(experiment, **where)
    _say_if_finished(options, show)
    if first:
        print(result.summary())
        print(f"\nWritten to {out or options.resume}: {', '.join(FILES)}{drawn(options)}")
    return 0


def _tune_on_recordings(options: argparse.Namespace) -> int:
    from posegsa import tuning
    from posegsa.saving.recorded import FILES

    if options.distributed:
        raise ArgumentError("--recording with --distributed; allowed: one of them")
    _refuse_held_out_window(options)
    _refuse_figures(options)
    experiment, schedule = _experiment(options), options.schedule
    out = OUT if options.out is None and options.resume is None else options.out
    if schedule is None and options.resume is not None:
        task = _run_to_resume(options).recorded
        schedule = None if task is None else task.schedule
    bridge = options.bridge, options.longest_gap
    recordings = read(options.recording, options.window, *bridge)
    held_out = read(options.held_out or [], options.held_out_window, *bridge)
    for one in (*recordings, *held_out):
        print(one.describe())
    with Display(quiet=options.quiet, after_search="then seconds to judge what it finds") as show:
        result = tuning.tune(
            experiment,
            recordings=recordings,
            held_out=held_out,
            schedule=schedule or "fuzzy",
            out=out,
            overwrite=options.overwrite,
            resume=options.resume,
        )
    _say_if_finished(options, show)
    print(f"\n{result.summary()}")
    print(f"\nWritten to {out or options.resume}: {', '.join(FILES)}")
    print(f"\n{_how_to_compare(options, str(out or options.resume))}")
    return 0


def _how_to_compare(options: argparse.Namespace, folder: str) -> str:
    """The command that compares a run on recordings with other filters, or what it needs."""
    if options.held_out is None:
        return (
            "To compare the schedule with constant gains and a Kalman filter, hold out a recording "
            "with --held-out FILE; it may be another part of the same file (--held-out-window)."
        )
    files = {"recording": options.held_out, "training": options.recording}
    parts = {"window": options.held_out_window, "training-window": options.window}
    words = [f"--{name} {shlex.quote(path)}" for name, paths in files.items() for path in paths]
    words += [f"--{name} {a!r}:{b!r}" for name, part in parts.items() if part for a, b in [part]]
    words += [f"--bridge {options.bridge}"] if options.bridge else []
    words += [f"--longest-gap {options.longest_gap!r}"] if options.longest_gap else []
    return (
        "To compare it with the best constant gains and a Kalman filter, in about twice the time "
        f"of this search:\n  posegsa evaluate {shlex.quote(folder)} {' '.join(words)}"
    )


def _tune_imu(options: argparse.Namespace) -> int:
    from posegsa import imu_tuning
    from posegsa.saving.imu import FILES

    if options.recording is None:
        raise ArgumentError(
            f"{options.config}: is tuned only on recordings; allowed: with --recording FILE"
        )
    if options.resume is not None or options.distributed or options.schedule is not None:
        raise ArgumentError(
            f"--resume, --distributed, --schedule; allowed: without {options.config}, whose gain "
            "is constant, and which is searched in one process"
        )
    _refuse_figures(options)
    _refuse_held_out_window(options)
    given = [] if options.iterations is None else [f"search.iterations={options.iterations}"]
    filter = config.override_imu(config.load_imu(options.config), [*options.set, *given])
    bridge, out = (options.bridge, options.longest_gap), options.out or OUT
    recordings = read(options.recording, options.window, *bridge)
    held_out = read(options.held_out or [], options.held_out_window, *bridge)
    with (
        resumable(lambda: "interrupted; nothing is kept"),
        Display(quiet=options.quiet, after_search="then seconds to judge what it finds"),
    ):
        result = imu_tuning.tune_imu(
            filter,
            recordings=recordings,
            held_out=held_out,
            frame=options.frame,
            rest=options.rest,
            seed=options.seed or 0,
            out=out,
            overwrite=options.overwrite,
        )
    print(result.summary())
    print(f"\nWritten to {out}: {', '.join(FILES)}")
    return 0


def _say_if_finished(options: argparse.Namespace, show: Display) -> None:
    if options.resume is not None and not show.started_any:
        print(
            f"{options.resume} is finished already: nothing was searched. "
            "For more iterations use --iterations."
        )


def _refuse_held_out_window(options: argparse.Namespace) -> None:
    if options.held_out_window is not None and options.held_out is None:
        raise ArgumentError("--held-out-window; allowed: with --held-out")


def _refuse_figures(options: argparse.Namespace) -> None:
    if options.figures:
        raise ArgumentError(
            "--figures; allowed: without --recording, as a search on recordings draws none "
            "(`posegsa replay RUN FILE --out DIR` does)"
        )


def _join(options: argparse.Namespace) -> bool:
    """Join the other processes, if any. Returns whether this process prints and writes files."""
    given = {name: getattr(options, name) for name in ("coordinator", "processes", "process")}
    if options.distributed:
        import jax

        from posegsa.search.devices import join_processes

        join_processes(**given)
        return jax.process_index() == 0
    for name, value in given.items():
        if value is not None:
            raise ArgumentError(f"--{name} = {value}; allowed: with --distributed")
    return True


def _run_to_resume(options: argparse.Namespace) -> "CheckpointedRun":
    from posegsa.saving.checkpointing import newest_checkpoint

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)  # `tune` repeats the warnings
        return newest_checkpoint(Path(options.resume))


def _experiment(options: argparse.Namespace) -> "config.Experiment":
    """The experiment to search: CONFIG, or that of the run to resume, with all settings."""
    if options.config is None and options.resume is not None:
        experiment = _run_to_resume(options).about.experiment
    else:
        experiment = config.as_experiment(options.config)
    replaced = {"run.seed": options.seed, "search.iterations": options.iterations}
    given = [f"{key}={value}" for key, value in replaced.items() if value is not None]
    return config.override(experiment, [*options.set, *given])
