"""The main job: a configuration in, a tuned schedule out, judged on noise it has not seen."""

import json
import os
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path

import jax
import numpy as np

from posegsa import config
from posegsa.arguments import check_callable, check_type
from posegsa.errors import (
    ArgumentError,
    ConfigError,
    PosegsaWarning,
    RunFolderError,
    SaveError,
)
from posegsa.judging import trust
from posegsa.judging.baselines import best_constant
from posegsa.judging.evaluation import (
    CONSTANT,
    TUNED,
    contender,
    evaluation,
)
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.judging.result import VERSION, TuneResult
from posegsa.judging.trajectory import simulate_scenario
from posegsa.model.schedules import FuzzyGain
from posegsa.optimisers import lengthened
from posegsa.runtime import environment
from posegsa.saving import resume as checkpoints
from posegsa.saving.checkpoint import objects_in
from posegsa.saving.folder import as_path, claimed
from posegsa.saving.interrupt import deferred
from posegsa.saving.run import load, write
from posegsa.search import memory
from posegsa.search.build import TuningProblem, tuning_problem
from posegsa.search.keys import keys, scenario_keys
from posegsa.search.run import Found, Progress, first_search, run_search, search_batch


def tune(
    experiment: config.Experiment | str | Path | None = None,
    *,
    seed: int | None = None,
    iterations: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: str | Path | None = None,
    progress: Callable[[Progress], object] | None = None,
) -> TuneResult:
    """Tune a fuzzy gain schedule.

    The whole search, simulations included, is one compiled loop; it is run in chunks only so that
    it can report progress and save its state. With a folder it does the latter by itself, and
    Ctrl-C or SIGTERM stop it where it can go on. It runs on all devices of the process, or of all
    processes that have joined (`posegsa.search.devices.join`), to the same bits.

    Args:
        experiment: An experiment, or a TOML file; by default the recommended experiment, or that of
            the run to resume.
        seed: Replaces the experiment's seed.
        iterations: Replaces the experiment's number of iterations.
        out: Folder to write the result to, and checkpoints while it searches (none by pycma, whose
            state can't be saved).
        overwrite: Replace another run in that folder.
        resume: Folder of a run to go on with, interrupted or finished; instead of `out`. It must be
            of the same experiment (see `saving.resume.agreed`), but for more iterations: past those
            it began with, G and K_best hold their final values.
        progress: Called when the search is compiled, and after each chunk of iterations.

    Returns:
        The result, with the cost on held-out scenarios beside the training cost.

    Raises:
        ConfigError: The configuration is not valid, would need more memory than there is, or is not
            that of the run to resume.
        RunFolderError: `out` holds a run already, or can't be written, found before the search; or
            another process is writing there, or `resume` holds no run.
        SaveError: The result can't be written, only now; the error has it as `result`.
        SearchInterrupted: Ctrl-C or SIGTERM, with a folder; a KeyboardInterrupt.
    """
    check_callable("progress", progress)
    if resume is not None and jax.process_count() > 1:
        raise ArgumentError(
            f"resume = {resume!s} in {jax.process_count()} processes; allowed: in one, on all its "
            "devices, which gives the same bits"
        )
    if resume is None:
        one = _experiment(experiment, seed, iterations)
        if out is None or jax.process_index() > 0:  # of processes that have joined, one writes
            with jax.enable_x64(one.run.dtype == "float64"):
                task = tuning_problem(one)
                return _result(task, run_search(task, progress))
        with claimed(out, overwrite=overwrite) as folder:
            checkpoints.discard(folder)
            return _saved_run(one, folder, None, progress)
    with claimed(_folder_to_resume(resume, out, overwrite), overwrite=True) as folder:
        start = checkpoints.begun(folder)
        asked = _experiment(
            start.experiment if experiment is None else experiment, seed, iterations
        )
        one = checkpoints.agreed(start.experiment, asked)
        done = _finished(folder, one)
        return done if done is not None else _saved_run(one, folder, start, progress)


def _saved_run(
    experiment: config.Experiment,
    folder: Path,
    begun: checkpoints.Begun | None,
    progress: Callable[[Progress], object] | None,
) -> TuneResult:
    """Tune with checkpoints, if there can be any, in a `locked` folder; write the result there."""
    with jax.enable_x64(experiment.run.dtype == "float64"):
        task = tuning_problem(experiment)
        search, before = first_search(task), (0.0, 0.0)
        if begun is not None:
            before = begun.search_seconds, begun.compile_seconds
            like = first_search(task._replace(experiment=begun.experiment))
            search = lengthened(begun.checkpoint.search(like), experiment.search.total_iterations)
        if objects_in(search):
            warnings.warn(
                f"search.optimiser = {experiment.search.optimiser!r} keeps a state that can't be "
                "saved: no checkpoints are made, and the run can't be resumed",
                PosegsaWarning,
                stacklevel=3,
            )
            found = run_search(task, progress, search=search)
        else:
            with deferred() as asked, checkpoints.Saver(folder, experiment, asked, before) as keep:
                found = run_search(task, progress, search=search, keep=keep)
        result = _result(
            task,
            found._replace(
                search_seconds=found.search_seconds + before[0],
                compile_seconds=found.compile_seconds + before[1],
            ),
        )
    try:
        write(result, folder)
    except RunFolderError as error:
        raise SaveError(str(error), result) from error
    return result


def _folder_to_resume(resume: str | Path, out: str | Path | None, overwrite: bool) -> Path:
    """The folder of a run to go on with."""
    folder = as_path("resume", resume)
    if overwrite:
        raise ArgumentError("overwrite = True; allowed: False, as resume goes on with a run")
    if out is not None and Path(out) != folder:
        raise ArgumentError(f"out = {out!s}; allowed: nothing, as resume = {folder} is the folder")
    if not folder.is_dir():
        raise RunFolderError(f"{folder}: is not a folder; needed: that of a run to go on with")
    return folder


def _finished(folder: Path, experiment: config.Experiment) -> TuneResult | None:
    """The result of this very experiment, if the folder has it."""
    try:
        result = load(folder)
    except RunFolderError:
        return None
    same = result.experiment.model_copy(update={"checkpoint": experiment.checkpoint})
    return result if same == experiment else None


@dataclass(frozen=True)
class TuneBatch:
    """Results of a batch, in the order of its experiments and seeds."""

    results: tuple[TuneResult, ...]

    def summary(self) -> str:
        """Median and range over the batch, of training beside held-out cost."""

        def row(label: str, values: list[float]) -> str:
            return (
                f"  {label:<34}{np.median(values):>10.4g}{min(values):>10.4g}{max(values):>10.4g}"
            )

        def held_out(name: str) -> list[float]:
            return [r.evaluation.cost(name).mean for r in self.results]

        rows = [
            f"  {f'{len(self.results)} searches':<34}{'median':>10}{'least':>10}{'largest':>10}",
            row(f"{TUNED}, training", [float(np.mean(r.training_costs)) for r in self.results]),
            row(f"{TUNED}, held out", held_out(TUNED)),
            row(f"{CONSTANT}, held out", held_out(CONSTANT)),
        ]
        return "\n".join(rows)


def tune_batch(
    experiments: config.Experiment | str | Path | Iterable[config.Experiment] | None = None,
    *,
    seeds: Iterable[int] | None = None,
    progress: Callable[[Progress], object] | None = None,
) -> TuneBatch:
    """Tune many problems in one compiled call: many seeds, or experiments that differ in numbers.

    Args:
        experiments: One experiment (or a TOML file, by default the recommended experiment), or
            several that differ only in values that are traced: noise, biases, gamma, gain limit,
            weights, scales, boxes, initial errors, motion, seed.
        seeds: Seeds to run each experiment with; by default each has its own.
        progress: As `tune`'s.

    Returns:
        All results, and their spread: for each experiment all its seeds, in order.

    Raises:
        ConfigError: A configuration is not valid, there are none, or they differ in structure
            (counts, names, switches, numbers of samples, agents or iterations); or they would need
            more memory than there is.
    """
    check_callable("progress", progress)
    if experiments is None or isinstance(experiments, config.Experiment | str | os.PathLike):
        many = [_experiment(experiments)]
    else:
        check_type("experiments", experiments, Iterable, allowed="experiments, or one")
        many = [_experiment(one) for one in experiments]
    if seeds is not None:
        check_type("seeds", seeds, Iterable, allowed="several whole numbers")
        each = list(seeds)
        many = [_experiment(one, seed) for one in many for seed in each]
    if not many:
        raise ConfigError("nothing to tune: no experiments, or no seeds, were given")
    if len({one.run.dtype for one in many}) > 1:
        raise ConfigError("run.dtype: differs within the batch; allowed: the same in all of it")
    memory.check(many)
    with jax.enable_x64(many[0].run.dtype == "float64"):
        tasks = [tuning_problem(one) for one in many]
        found = search_batch(tasks, progress)
        return TuneBatch(tuple(_result(t, f) for t, f in zip(tasks, found, strict=True)))


def _experiment(
    experiment: config.Experiment | str | Path | None,
    seed: int | None = None,
    iterations: int | None = None,
) -> config.Experiment:
    """The experiment that a user means, with a seed and a number of iterations if given."""
    given = {"run.seed": seed, "search.iterations": iterations}
    settings = [f"{key}={_written(value)}" for key, value in given.items() if value is not None]
    return config.override(config.as_experiment(experiment), settings)


def _written(value: object) -> str:
    """A number, also NumPy's, as a setting writes it; anything else so that it is refused."""
    if isinstance(value, Integral) and not isinstance(value, bool):
        return str(int(value))
    return json.dumps(str(value))


def _result(task: TuningProblem, found: Found) -> TuneResult:
    """Judge what a search found."""
    experiment, everywhere, search = task.experiment, task.everywhere, found.search
    count = experiment.run.training_scenarios
    held_out = everywhere.select(slice(count, None))
    controller = task.space.controller(search.best_position)
    parameters = np.asarray(task.space.vector(controller), np.float64)
    schedule = FuzzyGain(controller)
    constant = best_constant(task.training, experiment.parameters.gain_range, experiment.objective)
    # Training and held-out scenarios together, so that each kind of schedule compiles once.
    tuned_tracks, constant_tracks = (
        error_tracks(schedule, everywhere),
        error_tracks(constant, everywhere),
    )
    contenders = {
        TUNED: contender(
            tuned_tracks.select(slice(count, None)), held_out, {"k": parameters.tolist()}
        ),
        CONSTANT: contender(
            constant_tracks.select(slice(count, None)), held_out, {"gain": float(constant.gain)}
        ),
    }
    first = scenario_keys(keys(experiment.run.seed).held_out, 1)[0]
    trajectory = simulate_scenario(schedule, task.scenario, experiment, first)
    return TuneResult(
        experiment=experiment,
        best_cost=float(search.best_cost),
        parameters=parameters,
        training_costs=metrics_of(tuned_tracks.select(slice(count)), task.training)[0].cost,
        constant_gain=float(constant.gain),
        constant_training_costs=metrics_of(constant_tracks.select(slice(count)), task.training)[
            0
        ].cost,
        evaluation=evaluation(contenders, held_out),
        trust=trust.check(
            experiment, parameters, everywhere, tuned_tracks, trajectory.error, trajectory.rate
        ),
        evaluations=experiment.search.evaluations,
        non_finite=int(search.non_finite),
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=trajectory,
        environment=environment(),
        version=VERSION,
    )
