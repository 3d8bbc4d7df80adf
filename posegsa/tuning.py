"""The main job: a configuration in, a tuned schedule out, judged on noise it has not seen."""

from collections.abc import Callable, Iterable
from pathlib import Path

import jax
import numpy as np

from posegsa import config, results, trust
from posegsa.batch import TuneBatch
from posegsa.comparison import (
    CONSTANT,
    TUNED,
    best_constant,
    contender,
    evaluation,
    run_scenario,
)
from posegsa.errors import ConfigError
from posegsa.gain import FuzzyGain
from posegsa.keys import keys, scenario_keys
from posegsa.metrics import metrics_of, run, take
from posegsa.optimisers import evaluations_spent
from posegsa.results import TuneResult
from posegsa.runtime import environment
from posegsa.search import Found, Progress, Task, make_ready, run_search, search_batch


def tune(
    experiment: config.Experiment | str | Path | None = None,
    *,
    seed: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Callable[[Progress], object] | None = None,
) -> TuneResult:
    """Tune a fuzzy gain schedule.

    The whole search, simulations included, is one compiled loop; it is run in chunks only so that
    it can report progress.

    Args:
        experiment: An experiment, or a TOML file; by default the recommended experiment.
        seed: Replaces the experiment's seed.
        out: Folder to write the result to.
        overwrite: Replace another run in that folder.
        progress: Called once when the search is compiled, and after each chunk of iterations.

    Returns:
        The result, with the cost on held-out scenarios beside the training cost.

    Raises:
        ConfigError: The configuration is not valid.
        RunFolderError: `out` holds a run already, or can't be written; found before the search.
    """
    one = _experiment(experiment)
    if seed is not None:
        one = config.override(one, [f"run.seed={seed}"])
    if out is not None:
        results.claim(out, overwrite=overwrite)
    with jax.enable_x64(one.run.dtype == "float64"):
        task = make_ready(one)
        result = _result(task, run_search(task, progress))
    if out is not None:
        result.save(out, overwrite=True)
    return result


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
            (counts, names, switches, numbers of samples, agents or iterations).
    """
    if experiments is None or isinstance(experiments, config.Experiment | str | Path):
        many = [_experiment(experiments)]
    else:
        many = list(experiments)
    if seeds is not None:
        each = list(seeds)
        many = [config.override(one, [f"run.seed={seed}"]) for one in many for seed in each]
    if not many:
        raise ConfigError("nothing to tune: no experiments, or no seeds, were given")
    if len({one.run.dtype for one in many}) > 1:
        raise ConfigError("run.dtype: differs within the batch; allowed: the same in all of it")
    with jax.enable_x64(many[0].run.dtype == "float64"):
        tasks = [make_ready(one) for one in many]
        found = search_batch(tasks, progress)
        return TuneBatch(tuple(_result(t, f) for t, f in zip(tasks, found, strict=True)))


def _experiment(experiment: config.Experiment | str | Path | None) -> config.Experiment:
    if experiment is None:
        return config.Experiment()
    return experiment if isinstance(experiment, config.Experiment) else config.load(experiment)


def _result(task: Task, found: Found) -> TuneResult:
    """Judge what a search found."""
    experiment, everywhere, search = task.experiment, task.everywhere, found.search
    count = experiment.run.training_scenarios
    held_out = take(everywhere, slice(count, None))
    controller = task.space.controller(search.best_position)
    parameters = np.asarray(task.space.vector(controller), np.float64)
    schedule = FuzzyGain(controller)
    constant = best_constant(task.training, experiment.parameters.gain_range, experiment.objective)
    # Training and held-out scenarios together, so that each kind of schedule compiles once.
    tuned_tracks, constant_tracks = run(schedule, everywhere), run(constant, everywhere)
    contenders = {
        TUNED: contender(
            tuned_tracks.part(slice(count, None)), held_out, {"k": parameters.tolist()}
        ),
        CONSTANT: contender(
            constant_tracks.part(slice(count, None)), held_out, {"gain": float(constant.gain)}
        ),
    }
    first = scenario_keys(keys(experiment.run.seed).held_out, 1)[0]
    trajectory = run_scenario(schedule, task.scenario, experiment, first)
    return TuneResult(
        experiment=experiment,
        best_cost=float(search.best_cost),
        parameters=parameters,
        training_costs=metrics_of(tuned_tracks.part(slice(count)), task.training)[0].cost,
        constant_gain=float(constant.gain),
        constant_training_costs=metrics_of(constant_tracks.part(slice(count)), task.training)[
            0
        ].cost,
        evaluation=evaluation(contenders, held_out),
        trust=trust.check(
            experiment, parameters, everywhere, tuned_tracks, trajectory.error, trajectory.rate
        ),
        evaluations=int(evaluations_spent(task.optimiser)[-1]),
        non_finite=int(search.non_finite),
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=trajectory,
        environment=environment(),
        version=results.VERSION,
    )
