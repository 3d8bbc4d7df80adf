"""The main job: tune a filter and judge it on held-out scenarios or recordings."""

import os
import warnings
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from posegsa import config, steps
from posegsa.arguments import check_callable, check_number, refuse, several
from posegsa.errors import (
    ArgumentError,
    ConfigError,
    PosegsaWarning,
    RecordingError,
    RunFolderError,
    SaveError,
)
from posegsa.judging.judge import Recorded, References, judge, references
from posegsa.judging.result import Result, TuneBatch
from posegsa.progress import shown
from posegsa.recordings.fingerprint import fingerprint
from posegsa.recordings.imu import as_read_by
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
from posegsa.saving.result_files import run_figures, write_result
from posegsa.saving.resume import (
    check_same_recordings,
    experiment_to_resume,
    finished_result,
    folder_to_resume,
)
from posegsa.search import memory
from posegsa.search.background import in_background
from posegsa.search.configured_filters import OwnFilter, filter_of
from posegsa.search.population import TrackCost, check_same_cost
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.recorded import (
    DEGREES_PER_METRE,
    default_experiment,
    most_sensors,
    recorded_problem,
    with_effect_on,
)
from posegsa.search.run_search import run_search, search_batch, tell_search
from posegsa.search.search_spaces import own_space
from posegsa.words import toml

Given = config.Experiment | str | Path | None
"""An experiment or a TOML file; None for the default."""
Recordings = Recording | Iterable[Recording]
"""One recording, or several."""

FEW_SHARED = 300
"""Maximum number of samples that two recordings may share without a warning."""


def tune(
    experiment: Given = None,
    *,
    filter: OwnFilter | None = None,
    recordings: Recordings | None = None,
    held_out: Recordings | None = None,
    position_weight: float = DEGREES_PER_METRE,
    seed: int | None = None,
    iterations: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: str | Path | None = None,
    figures: Iterable[str] | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> Result:
    """Tune a filter, on drawn scenarios or on recordings, and judge it on others.

    The whole search, simulations included, is one compiled loop; it is run in chunks only so that
    it can report progress and save its state. With a folder it saves its state, and Ctrl-C,
    SIGTERM and SIGUSR1 stop it so that it can be resumed. It runs on all devices of the process, or
    of all processes that have joined (`posegsa.search.devices.join_processes`), with bit-identical
    results.

    Args:
        experiment: An experiment, or a TOML file; by default that of the run to resume, the
            recommended experiment, or on recordings a Kalman filter with the noises that they show
            (without a body velocity the attitude filter, `imu`). Its [filter] says what is tuned:
            the observer with a fuzzy, constant or smooth gain, the Kalman filter, or a filter of
            the user's own. On recordings, its filter, signal, fuzzy inference, boxes,
            `parameters.also`, objective and optimiser are used, and the weights of its scenario's
            vectors and landmarks, in order.
        filter: The user's own filter (`filters.base.Filter`), if `filter.kind` is "own": its class,
            or any function that makes a filter from the numbers of [filter], passed by name; or a
            filter, which then gets them by its `with_values`.
        recordings: Recordings to tune on instead of simulated scenarios: any number, length and
            rate. The cost of one is the RMSE of its attitude [deg] plus `position_weight` times the
            RMSE of its position, over its judged samples. If the experiment's
            `objective.simulated_share` is above 0, simulated scenarios with the same cost have that
            share of the total (`search.recorded`).
        held_out: Held-out recordings.
        position_weight: Weight of the position's RMSE in the cost on recordings [deg/m].
        seed: Replaces the experiment's seed.
        iterations: Replaces the experiment's number of iterations.
        out: Folder for the result, and for checkpoints during the search.
        overwrite: Replace another run in that folder.
        resume: Folder of an interrupted or finished run to continue; instead of `out`. The
            experiment must be the same (`saving.resume.experiment_to_resume`), except that it may
            have more iterations: beyond the original number G and K_best keep their final values.
            For a run on recordings give the same recordings again: a folder does not store them.
        figures: Names of the figures to draw in the folder; by default all.
        cost: A cost to minimise instead of the configured one: a JAX function of a simulation's
            errors (`ErrorTrack`) and times (N,) [s]. Before a start from the sensors the errors are
            those of the start. Not on recordings.
        progress: Called with each `steps.Step`: for "searching" when the search is compiled, and
            after each chunk of iterations.

    Returns:
        The result, with what the filter is worth on training and held-out data. On recordings it
        says whether any were held out.

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
    if figures is not None and out is None and resume is None:
        refuse("figures without a folder", "with out or resume")
    recorded = _recorded(recordings, held_out, position_weight)
    if recorded is not None and cost is not None:
        refuse("recordings with cost", "one of them")
    with shown(progress):
        if resume is not None:
            folder = folder_to_resume(resume, out, overwrite)
            return _resume(folder, experiment, seed, iterations, recorded, filter, cost, drawn)
        if experiment is None and recorded is not None:
            experiment = default_experiment(recorded.training)
        chosen = _chosen(experiment, seed, iterations)
        task = _Task(chosen, _as_read(recorded, chosen), filter, cost)
        task.check()
        # Only one of the joined processes writes.
        if out is not None and jax.process_index() == 0:
            with locked_folder(out, overwrite=overwrite) as folder:
                return _tune_in_folder(task, folder, None, drawn)
        with jax.enable_x64(task.experiment.run.dtype == "float64"):
            problem = task.problem()
            known = task.references(problem)
            return judge(problem, run_search(problem, tell_search), recorded, known)


class _Task(NamedTuple):
    """The experiment to tune, and the data to tune it on."""

    experiment: config.Experiment
    recorded: Recorded | None
    """None on drawn scenarios."""
    own: OwnFilter | None
    cost: TrackCost | None

    def check(self) -> None:
        """Refuse a filter that cannot be made or has nothing to tune, before a folder is made."""
        section = self.experiment.filter
        with jax.enable_x64(self.experiment.run.dtype == "float64"):
            filter_of(self.experiment, self.own)
            scheduled = own_space(self.experiment).lower.size > 0
        if not (scheduled or self.experiment.also):
            raise ConfigError(
                "parameters.also: none; allowed: at least one number to tune, as a filter of kind "
                f"{section.kind!r} has no schedule"
            )

    def problem(self) -> TuningProblem:
        """The problem to search, which is compiled next."""
        steps.begin("preparing")
        if self.recorded is None:
            problem = tuning_problem(self.experiment, self.cost, self.own)
        else:
            training, weight = self.recorded.training, self.recorded.position_weight
            problem = recorded_problem(self.experiment, training, weight, own=self.own)
        steps.begin("compiling")
        return problem

    def references(self, problem: TuningProblem) -> Callable[[], References] | None:
        """What judges the filter whatever is found, started while the search is compiled."""
        return None if self.recorded else in_background(partial(references, problem))


def _stored(recorded: Recorded | None) -> RecordedTask | None:
    """Recordings as checkpoints store them."""
    if recorded is None:
        return None
    return RecordedTask(
        position_weight=float(recorded.position_weight),
        training=list(map(fingerprint, recorded.training)),
        held_out=list(map(fingerprint, recorded.held_out)),
    )


def _recorded(
    recordings: Recordings | None, held_out: Recordings | None, position_weight: float
) -> Recorded | None:
    """The recordings of the user's arguments, checked; None if there are none."""
    if recordings is None:
        given = {
            "held_out": held_out is not None,
            "position_weight": position_weight != DEGREES_PER_METRE,
        }
        for name in (name for name, stated in given.items() if stated):
            refuse(f"{name} without recordings", "both, or neither")
        return None
    training, unseen = (
        several(name, [given] if isinstance(given, Recording) else given, Recording, "recordings")
        for name, given in (("recordings", recordings), ("held_out", held_out or []))
    )
    if not training:
        refuse("recordings: none", "at least one")
    if both := {id(one) for one in training} & {id(one) for one in unseen}:
        name = next(one.name for one in training if id(one) in both)
        refuse(f"held_out: {name} is tuned on", "recordings that are not")
    for one in unseen:
        for other in training:
            if share := _share_in(other, one):
                warnings.warn(
                    f"held_out: {100 * share:.0f} % of {one.name} is in {other.name} too, which is "
                    "tuned on: its errors say little about other motion",
                    PosegsaWarning,
                    stacklevel=3,
                )
    for one in (*training, *unseen):
        if not one.masks()["judged"].any():
            raise RecordingError(f"{one.name}: no sample is judged where the truth is known")
    check_number("position_weight", position_weight, 0.0, 1e6)
    return Recorded(training, unseen, position_weight)


def _share_in(one: Recording, other: Recording) -> float:
    """The share of the samples of `other` that are in `one` too: velocities and vectors.

    It is 0 below a few hundred, and for a body at rest, where samples may agree by chance, as those
    of a gyroscope with few digits do.
    """
    measured = (one.measurements, other.measurements)
    vectors = [np.asarray(m.vectors) for m in measured]
    if np.shape(vectors[0])[1:] != np.shape(vectors[1])[1:]:
        vectors = [each[:, :0] for each in vectors]
    samples = (
        np.concatenate([m.angular_velocity, m.velocity, v.reshape(len(v), -1)], axis=1)
        for m, v in zip(measured, vectors, strict=True)
    )
    a, b = (
        np.ascontiguousarray(each, np.float64).view(f"V{8 * each.shape[1]}")[:, 0]
        for each in samples
    )
    both = np.isin(b, a)
    certain = np.count_nonzero(both) > FEW_SHARED and len(np.unique(b)) > 0.5 * len(b)
    return float(np.mean(both)) if certain else 0.0


def _as_read(recorded: Recorded | None, experiment: config.Experiment) -> Recorded | None:
    """Recordings as the experiment's filter reads them, each with a vector or a landmark."""
    if recorded is None:
        return None
    training, unseen = (
        [as_read_by(experiment.filter.kind, one) for one in some]
        for some in (recorded.training, recorded.held_out)
    )
    for one in (*training, *unseen):
        one.check_seen()
    return recorded._replace(training=training, held_out=unseen)


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
    with shown(progress), jax.enable_x64(many[0].run.dtype == "float64"):
        problems = [tuning_problem(one) for one in steps.each("preparing", many)]
        steps.begin("compiling")
        found = search_batch(problems, tell_search)
        return TuneBatch(tuple(map(judge, problems, found)))


def _tune_in_folder(
    task: _Task, folder: Path, run: CheckpointedRun | None, figures: list[str]
) -> Result:
    """Tune in a locked folder with checkpoints, from a run's state if given; write the result."""
    stored = _stored(task.recorded)
    with jax.enable_x64(task.experiment.run.dtype == "float64"):
        problem = task.problem()
        known = task.references(problem)
        found = search_with_checkpoints(problem, folder, run, tell_search, stored)
        with _resumable(folder, stored):
            result = judge(problem, found, task.recorded, known)
    try:
        with _resumable(folder, stored):
            write_result(result, folder, figures, own_checkpoints=True)
    except RunFolderError as error:
        raise SaveError(str(error), result) from error
    return result


def _resumable(folder: Path, recorded: RecordedTask | None) -> AbstractContextManager[None]:
    """A context for the work after the search: an interruption says how to resume."""
    if not checkpoint_paths(folder):
        return nullcontext()
    how = how_to_resume(folder, recorded)
    return resumable(lambda: f"interrupted; all iterations are done and saved, {how}")


def _resume(
    folder: Path,
    experiment: Given,
    seed: int | None,
    iterations: int | None,
    recorded: Recorded | None,
    own: OwnFilter | None,
    cost: TrackCost | None,
    figures: list[str],
) -> Result:
    """Continue the run in a folder, or read its result if it is finished."""
    if jax.process_count() > 1:
        raise ArgumentError(
            f"resume = {folder} in {jax.process_count()} processes; allowed: in one, on all its "
            "devices, which gives the same bits"
        )
    with locked_folder(folder, overwrite=True):
        run = newest_checkpoint(folder)
        recorded = _as_read(recorded, run.about.experiment)
        asked_for = _stored(recorded)
        check_same_recordings(run.about.recorded, asked_for, folder)
        check_same_cost(cost, run.about.cost)
        stored = run.about.experiment
        asked = _chosen(stored if experiment is None else experiment, seed, iterations)
        if recorded is not None:
            asked = with_effect_on(asked, *most_sensors(recorded.training))
        agreed = experiment_to_resume(stored, asked)
        finished = finished_result(folder, agreed, asked_for, own)
        task = _Task(agreed, recorded, own, cost)
        return finished or _tune_in_folder(task, folder, run, figures)


def _all_chosen(
    experiments: Given | Iterable[config.Experiment], seeds: Iterable[int] | None
) -> list[config.Experiment]:
    """The user's experiments, each with each seed; at least one, all with the same dtype."""
    if experiments is None or isinstance(experiments, config.Experiment | str | os.PathLike):
        experiments = [config.as_experiment(experiments)]
    each = several("experiments", experiments, object, "experiments, or one")
    many = list(map(_chosen, each))
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
    chosen = config.override(config.as_experiment(experiment), settings)
    # A search replaces the numbers of the last search.
    return chosen.model_copy(update={"tuned": config.TunedConfig()})
