"""The main job: tune a gain schedule and judge it on held-out scenarios or recordings."""

import os
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import NamedTuple, get_args, overload

import jax

from posegsa import config, steps
from posegsa.arguments import check_callable, check_number, refuse, several
from posegsa.errors import ArgumentError, ConfigError, RecordingError, RunFolderError, SaveError
from posegsa.judging.judge import judge
from posegsa.judging.recorded import RecordingResult, judge_on_recordings
from posegsa.judging.result import TuneBatch, TuneResult
from posegsa.recordings.fingerprint import fingerprint
from posegsa.recordings.recording import Recording
from posegsa.saving.checkpointing import (
    CheckpointedRun,
    RecordedTask,
    checkpoint_paths,
    how_to_resume,
    newest_checkpoint,
    search_with_checkpoints,
)
from posegsa.saving.folder import locked_folder
from posegsa.saving.interrupt import resumable
from posegsa.saving.recorded import write_recorded
from posegsa.saving.resume import (
    check_same_recordings,
    experiment_to_resume,
    finished_on_recordings,
    finished_result,
    folder_to_resume,
)
from posegsa.saving.run import run_figures, write_run
from posegsa.search import memory
from posegsa.search.build import TuningProblem, tuning_problem
from posegsa.search.population import TrackCost, check_same_cost
from posegsa.search.recorded import DEGREES_PER_METRE, recorded_problem, tuned_on_recordings
from posegsa.search.recorded_schedules import RecordedSchedule
from posegsa.search.run import Found, run_search, search_batch, tell_search
from posegsa.words import toml

Given = config.Experiment | str | Path | None
"""An experiment or a TOML file; None for the recommended experiment."""
Recordings = Recording | Iterable[Recording]
"""One recording, or several."""


@overload
def tune(
    experiment: Given = None,
    *,
    recordings: None = None,
    held_out: None = None,
    schedule: RecordedSchedule = "fuzzy",
    position_weight: float = DEGREES_PER_METRE,
    seed: int | None = None,
    iterations: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: str | Path | None = None,
    figures: Iterable[str] | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> TuneResult: ...


@overload
def tune(
    experiment: Given = None,
    *,
    recordings: Recordings,
    held_out: Recordings | None = None,
    schedule: RecordedSchedule = "fuzzy",
    position_weight: float = DEGREES_PER_METRE,
    seed: int | None = None,
    iterations: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: str | Path | None = None,
    figures: None = None,
    cost: None = None,
    progress: steps.Listener | None = None,
) -> RecordingResult: ...


def tune(
    experiment: Given = None,
    *,
    recordings: Recordings | None = None,
    held_out: Recordings | None = None,
    schedule: RecordedSchedule = "fuzzy",
    position_weight: float = DEGREES_PER_METRE,
    seed: int | None = None,
    iterations: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: str | Path | None = None,
    figures: Iterable[str] | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> TuneResult | RecordingResult:
    """Tune a fuzzy gain schedule, on simulated scenarios or on recordings.

    The whole search, simulations included, is one compiled loop; it is run in chunks only so that
    it can report progress and save its state. With a folder it saves its state, and Ctrl-C,
    SIGTERM and SIGUSR1 stop it so that it can be resumed. It runs on all devices of the process, or
    of all processes that have joined (`posegsa.search.devices.join_processes`), with bit-identical
    results.

    Args:
        experiment: An experiment, or a TOML file; by default the recommended experiment, or that of
            the run to resume. On recordings, its filter, signal, fuzzy inference, boxes,
            `parameters.also`, objective and optimiser are used, and the weights of its scenario's
            vectors and landmarks, in order.
        recordings: Recordings to tune on instead of simulated scenarios: any number, length and
            rate. The cost of one is the RMSE of its attitude [deg] plus `position_weight` times the
            RMSE of its position, over its judged samples. If the experiment's
            `objective.simulated_share` is above 0, simulated scenarios with the same cost have that
            share of the total (`search.recorded`).
        held_out: Held-out recordings.
        schedule: The schedule to search on recordings: "fuzzy", k1 to k22; "constant", one gain;
            "smooth", K(e) of three numbers; each with `parameters.also`.
        position_weight: Weight of the position's RMSE in the cost on recordings [deg/m].
        seed: Replaces the experiment's seed.
        iterations: Replaces the experiment's number of iterations.
        out: Folder for the result, and for checkpoints during the search (pycma has none, because
            its state can't be saved).
        overwrite: Replace another run in that folder.
        resume: Folder of an interrupted or finished run to continue; instead of `out`. The
            experiment must be the same (`saving.resume.experiment_to_resume`), except that it may
            have more iterations: beyond the original number G and K_best keep their final values.
            For a run on recordings give the same recordings again: a folder does not store them.
        figures: Names of the figures to draw in the folder; by default all. Not on recordings.
        cost: A cost to minimise instead of the configured one: a JAX function of a simulation's
            errors (`ErrorTrack`) and times (N,) [s].
        progress: Called with each `steps.Step`: for "searching" when the search is compiled, and
            after each chunk of iterations.

    Returns:
        The result, with the costs on training and held-out scenarios. On recordings, a
        `RecordingResult`; it has the errors on the held-out recordings, or says that there are
        none.

    Raises:
        ArgumentError: An argument has the wrong type, or has no effect together with the others; or
            the run to resume was tuned on other recordings.
        ConfigError: The configuration is invalid, would need more memory than available, or is not
            that of the run to resume.
        RunFolderError: `out` already holds a run, can't be written, or another process is writing
            there; or `resume` holds no run. Raised before the search.
        SaveError: The result can't be written after the search. Its `result` holds it.
        SearchInterrupted: Ctrl-C, SIGTERM or SIGUSR1, with a folder; a KeyboardInterrupt.
    """
    check_callable("progress", progress)
    check_callable("cost", cost)
    drawn = run_figures(figures)
    if figures is not None and (recordings is not None or (out is None and resume is None)):
        refuse("figures with recordings, or without a folder", "with out or resume")
    with steps.listening(progress):
        if recordings is not None:
            if cost is not None:
                refuse("recordings with cost", "one of them")
            task = _recorded_task(recordings, held_out, schedule, position_weight)
            if resume is not None:
                folder = folder_to_resume(resume, out, overwrite)
                return _resume_on_recordings(folder, experiment, seed, iterations, task)
            chosen = _chosen(experiment, seed, iterations)
            if out is not None:
                with locked_folder(out, overwrite=overwrite) as folder:
                    return _tune_on_recordings(chosen, task, folder, None)
            return _tune_on_recordings(chosen, task, None, None)
        given = {
            "held_out": held_out is not None,
            "schedule": schedule != "fuzzy",
            "position_weight": position_weight != DEGREES_PER_METRE,
        }
        for name in (name for name, stated in given.items() if stated):
            refuse(f"{name} without recordings", "both, or neither")
        if resume is not None:
            folder = folder_to_resume(resume, out, overwrite)
            return _resume(folder, experiment, seed, iterations, drawn, cost)
        chosen = _chosen(experiment, seed, iterations)
        # Only one of the joined processes writes.
        if out is not None and jax.process_index() == 0:
            with locked_folder(out, overwrite=overwrite) as folder:
                return _tune_in_folder(chosen, folder, None, drawn, cost)
        with jax.enable_x64(chosen.run.dtype == "float64"):
            problem = _prepared(chosen, cost)
            return judge(problem, run_search(problem, tell_search))


class _RecordedTask(NamedTuple):
    """A tuning task on recordings."""

    training: list[Recording]
    held_out: list[Recording]
    schedule: RecordedSchedule
    position_weight: float

    def stored(self) -> RecordedTask:
        """The task as checkpoints store it."""
        return RecordedTask(
            schedule=self.schedule,
            position_weight=float(self.position_weight),
            training=list(map(fingerprint, self.training)),
            held_out=list(map(fingerprint, self.held_out)),
        )


def _recorded_task(
    recordings: Recordings,
    held_out: Recordings | None,
    schedule: RecordedSchedule,
    position_weight: float,
) -> _RecordedTask:
    """The task that the user's arguments describe, checked."""
    training, unseen = (
        several(name, [given] if isinstance(given, Recording) else given, Recording, "recordings")
        for name, given in (("recordings", recordings), ("held_out", held_out or []))
    )
    if not training:
        refuse("recordings: none", "at least one")
    if both := {id(one) for one in training} & {id(one) for one in unseen}:
        name = next(one.name for one in training if id(one) in both)
        refuse(f"held_out: {name} is tuned on", "recordings that are not")
    for one in (*training, *unseen):
        one.check_seen()
        if not one.masks()["judged"].any():
            raise RecordingError(f"{one.name}: no sample is judged where the truth is known")
    if schedule not in get_args(RecordedSchedule):
        refuse(f"schedule = {schedule!r}", ", ".join(get_args(RecordedSchedule)))
    check_number("position_weight", position_weight, 0.0, 1e6)
    return _RecordedTask(training, unseen, schedule, position_weight)


def _tune_on_recordings(
    experiment: config.Experiment,
    task: _RecordedTask,
    folder: Path | None,
    run: CheckpointedRun | None,
) -> RecordingResult:
    """Tune on recordings; with a locked folder, write checkpoints; with a run, continue it."""
    with jax.enable_x64(experiment.run.dtype == "float64"):
        steps.begin("preparing")
        problem = recorded_problem(experiment, task.training, task.schedule, task.position_weight)
        steps.begin("compiling")
        if folder is None:
            found = run_search(problem, tell_search)
            return _judged_on_recordings(problem, found, task)
        stored = task.stored()
        found = search_with_checkpoints(problem, folder, run, tell_search, stored)
        with _resumable(folder, stored):
            result = _judged_on_recordings(problem, found, task)
    try:
        with _resumable(folder, stored):
            write_recorded(result, folder, own_checkpoints=True)
    except RunFolderError as error:
        raise SaveError(str(error), result) from error
    return result


def _judged_on_recordings(
    problem: TuningProblem, found: Found, task: _RecordedTask
) -> RecordingResult:
    weight = task.position_weight
    return judge_on_recordings(problem, found, weight, task.training, task.held_out)


def _resume_on_recordings(
    folder: Path,
    experiment: Given,
    seed: int | None,
    iterations: int | None,
    task: _RecordedTask,
) -> RecordingResult:
    """Continue the run on recordings in a folder, or read its result if it is finished."""
    with locked_folder(folder, overwrite=True):
        run = newest_checkpoint(folder)
        asked_for = task.stored()
        check_same_recordings(run.recorded, asked_for, folder)
        stored = run.about.experiment
        asked = _chosen(stored if experiment is None else experiment, seed, iterations)
        asked = tuned_on_recordings(asked, task.training, task.schedule)
        agreed = experiment_to_resume(stored, asked)
        finished = finished_on_recordings(folder, agreed, asked_for)
        return finished or _tune_on_recordings(agreed, task, folder, run)


def tune_batch(
    experiments: Given | Iterable[config.Experiment] = None,
    *,
    seeds: Iterable[int] | None = None,
    progress: steps.Listener | None = None,
) -> TuneBatch:
    """Tune many problems in one compiled loop: many seeds, or experiments that differ in numbers.

    Args:
        experiments: One experiment (or a TOML file, by default the recommended experiment), or
            several that differ only in traced values: noise, biases, gamma, gain limit, weights,
            scales, boxes, initial errors, motion, seed.
        seeds: Seeds for each experiment; by default each experiment's own seed.
        progress: As in `tune`.

    Returns:
        All results and their spread, ordered by experiment, then seed.

    Raises:
        ConfigError: A configuration is invalid, there are none, they differ in structure (counts,
            names, switches, numbers of samples, agents or iterations), or they would need more
            memory than available.
    """
    check_callable("progress", progress)
    many = _all_chosen(experiments, seeds)
    memory.check(many)
    with steps.listening(progress), jax.enable_x64(many[0].run.dtype == "float64"):
        problems = [tuning_problem(one) for one in steps.each("preparing", many)]
        steps.begin("compiling")
        found = search_batch(problems, tell_search)
        return TuneBatch(tuple(map(judge, problems, found)))


def _tune_in_folder(
    experiment: config.Experiment,
    folder: Path,
    run: CheckpointedRun | None,
    figures: list[str],
    cost: TrackCost | None,
) -> TuneResult:
    """Tune in a locked folder with checkpoints, from a run's state if given; write the result."""
    with jax.enable_x64(experiment.run.dtype == "float64"):
        problem = _prepared(experiment, cost)
        found = search_with_checkpoints(problem, folder, run, tell_search)
        with _resumable(folder):
            result = judge(problem, found)
    try:
        with _resumable(folder):
            write_run(result, folder, figures)
    except RunFolderError as error:
        raise SaveError(str(error), result) from error
    return result


def _resumable(folder: Path, recorded: RecordedTask | None = None) -> AbstractContextManager[None]:
    """A context for the work after the search: an interruption says how to resume."""
    if not checkpoint_paths(folder):
        return nullcontext()
    how = how_to_resume(folder, recorded)
    return resumable(lambda: f"interrupted; all iterations are done and saved, {how}")


def _prepared(experiment: config.Experiment, cost: TrackCost | None) -> TuningProblem:
    """Build the problem of an experiment; its search is compiled next."""
    steps.begin("preparing")
    problem = tuning_problem(experiment, cost)
    steps.begin("compiling")
    return problem


def _resume(
    folder: Path,
    experiment: Given,
    seed: int | None,
    iterations: int | None,
    figures: list[str],
    cost: TrackCost | None,
) -> TuneResult:
    """Continue the run in a folder, or read its result if it is finished."""
    if jax.process_count() > 1:
        raise ArgumentError(
            f"resume = {folder} in {jax.process_count()} processes; allowed: in one, on all its "
            "devices, which gives the same bits"
        )
    with locked_folder(folder, overwrite=True):
        run = newest_checkpoint(folder)
        if run.recorded is not None:
            refuse(
                f"resume = {folder} without recordings",
                "with those that it is tuned on and those held out (recordings=, held_out=; "
                "--recording, --held-out)",
            )
        check_same_cost(cost, run.about.cost)
        stored = run.about.experiment
        asked = _chosen(stored if experiment is None else experiment, seed, iterations)
        agreed = experiment_to_resume(stored, asked)
        finished = finished_result(folder, agreed)
        return finished or _tune_in_folder(agreed, folder, run, figures, cost)


def _all_chosen(
    experiments: Given | Iterable[config.Experiment], seeds: Iterable[int] | None
) -> list[config.Experiment]:
    """The user's experiments, each with each seed; at least one, all with the same dtype."""
    if experiments is None or isinstance(experiments, config.Experiment | str | os.PathLike):
        experiments = [config.as_experiment(experiments)]
    each = several("experiments", experiments, object, "experiments, or one")
    many = list(map(config.as_experiment, each))
    if seeds is not None:
        each = several("seeds", seeds, object, "several whole numbers")
        many = [_chosen(one, seed) for one in many for seed in each]
    if not many:
        raise ConfigError("nothing to tune: no experiments, or no seeds, were given")
    if len({one.run.dtype for one in many}) > 1:
        raise ConfigError("run.dtype: differs within the batch; allowed: the same in all of it")
    return many


def _chosen(
    experiment: Given, seed: int | None = None, iterations: int | None = None
) -> config.Experiment:
    """The user's experiment, with a seed and a number of iterations if given."""
    given = {"run.seed": seed, "search.iterations": iterations}
    settings = [f"{key}={toml(value)}" for key, value in given.items() if value is not None]
    return config.override(config.as_experiment(experiment), settings)
