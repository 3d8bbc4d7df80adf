"""`posegsa tune`."""

import argparse
import shlex
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posegsa import config
from posegsa.cli.options import (
    RECORDING,
    add_bridge,
    add_figures,
    add_filter,
    add_frame,
    add_search_arguments,
    add_window,
    as_read_with,
    own_filter,
    read,
    warn_of_mistakes,
    window,
)
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.progress import Display

if TYPE_CHECKING:
    from posegsa.recordings.recording import Recording
    from posegsa.saving.checkpointing import CheckpointedRun

OUT = "posegsa-run"
"""Default folder."""


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "tune",
        help="tune a filter and judge it on unseen scenarios or recordings",
        description="Tunes a filter and judges it on scenarios that it was not tuned on, or, with "
        "--recording, on recordings. Writes the result, tables, figures and report.html to a "
        "folder. The filter is that of CONFIG, such as "
        "recommended, observer, kalman or imu, or your own with --filter.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment, or that of the run to resume; with --recording a "
        "Kalman filter with the noises that are found",
        setting="filter.substeps=4",
        out=f"folder for results and checkpoints (default: {OUT})",
        replaced="the run in the folder",
    )
    add_figures(parser)
    add_filter(parser)
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
    add_frame(group)
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
    from posegsa.saving.result_files import written

    first = _join(options)
    found = _recordings(options)
    experiment = _experiment(options, found.get("recordings"))
    recorded: dict[str, Any] = {
        name: as_read_with(options, experiment.filter.kind, each) for name, each in found.items()
    }
    for one in (each for several in recorded.values() for each in several):
        print(one.describe())
    out = OUT if options.out is None and options.resume is None else options.out
    # If more than the schedule is tuned, judging searches the best constant gains too.
    long = experiment.also and not recorded and experiment.filter.kind == "observer"
    judging = f"then {'about as long' if long else 'seconds'} to judge what it finds"
    with Display(quiet=options.quiet or not first, after_search=judging) as show:
        result = tuning.tune(
            experiment,
            **recorded,
            filter=own_filter(options),
            out=out,
            overwrite=options.overwrite,
            resume=options.resume,
            figures=options.figures,
        )
    if options.resume is not None and not show.started_any:
        print(
            f"{options.resume} is finished already: nothing was searched or written. --iterations "
            "has more."
        )
    if first:
        folder = str(out or options.resume)
        print(("\n" if recorded else "") + result.summary())
        if show.started_any:
            print(f"\nWritten to {folder}: {', '.join(written(folder))}")
        if recorded:
            print(f"\n{_how_to_compare(options, folder, experiment.filter.kind)}")
    return 0


def _recordings(options: argparse.Namespace) -> "dict[str, list[Recording]]":
    """The recordings to tune on and those held out, as `tune` takes them; {} on scenarios."""
    if options.held_out_window is not None and options.held_out is None:
        raise ArgumentError("--held-out-window; allowed: with --held-out")
    if options.recording is None:
        for name in ("held_out", "window", "held_out_window", "bridge", "longest_gap", "frame"):
            if getattr(options, name) is not None:
                raise ArgumentError(f"--{name.replace('_', '-')}; allowed: with --recording")
        return {}
    if options.distributed:
        raise ArgumentError("--recording with --distributed; allowed: one of them")
    how = options.bridge, options.longest_gap, options.frame
    found = {
        "recordings": read(options.recording, options.window, *how),
        "held_out": read(options.held_out or [], options.held_out_window, *how),
    }
    for each in found.values():
        warn_of_mistakes(each)
    return found


def _tell_noises(experiment: "config.Experiment") -> None:
    """Say what filter was chosen for the recordings."""
    kind = experiment.filter.kind
    if kind == "imu":
        print("Without CONFIG: imu, the attitude filter, as there is no body velocity.")
        return
    noises = experiment.filter.model_dump(exclude_defaults=True, exclude={"kind"})
    found = []
    for key, value in noises.items():
        if value != "estimated":
            numbers = value if isinstance(value, tuple) else (value,)  # scales are one by one
            found.append(f"{key} {' '.join(f'{x:.3g}' for x in numbers)}")
    listed = ", ".join(found)
    print(f"Without CONFIG: a Kalman filter with the noises found in the recordings: {listed}.")


def _how_to_compare(options: argparse.Namespace, folder: str, kind: str) -> str:
    """The command that compares a run on recordings with other filters, or what it lacks."""
    inertial = kind == "imu"
    others = "VQF and others" if inertial else "the best constant gains and a Kalman filter"
    if options.held_out is None:
        return (
            f"Whether the filter is better than {others}, a recording that was held out says: "
            "--held-out FILE, which may be the same with --held-out-window."
        )
    files = {"recording": options.held_out} | ({} if inertial else {"training": options.recording})
    parts = {"window": options.held_out_window}
    parts |= {} if inertial else {"training-window": options.window}
    words = [f"--{name} {shlex.quote(path)}" for name, paths in files.items() for path in paths]
    words += [f"--{name} {a!r}:{b!r}" for name, part in parts.items() if part for a, b in [part]]
    words += [f"--filter {shlex.quote(options.filter)}"] if options.filter else []
    words += [f"--bridge {options.bridge}"] if options.bridge else []
    words += [f"--longest-gap {options.longest_gap!r}"] if options.longest_gap else []
    words += [f"--frame {options.frame}"] if options.frame else []
    time = "" if inertial else ", in about twice the time of this search"
    command = f"posegsa evaluate {shlex.quote(folder)} {' '.join(words)}"
    return f"To compare it with {others}{time}:\n  {command}"


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


def _experiment(
    options: argparse.Namespace, recordings: "list[Recording] | None"
) -> "config.Experiment":
    """The experiment to search: CONFIG, or that of the run to resume, with all settings."""
    if options.config is None and options.resume is not None:
        experiment = _run_to_resume(options).about.experiment
    elif options.config is None and recordings is not None:
        from posegsa.search.recorded import default_experiment

        experiment = default_experiment(recordings)
        _tell_noises(experiment)
    else:
        experiment = config.as_experiment(options.config)
    replaced = {"run.seed": options.seed, "search.iterations": options.iterations}
    given = [f"{key}={value}" for key, value in replaced.items() if value is not None]
    return config.override(experiment, [*options.set, *given])
