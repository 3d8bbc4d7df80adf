"""The main job: a configuration in, a tuned schedule out, judged on noise it has not seen."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa import config, results, trust
from posegsa.batch import TuneBatch
from posegsa.comparison import (
    CONSTANT,
    TUNED,
    best_constant,
    contender,
    evaluation,
    held_out_keys,
    run_scenario,
    training_keys,
)
from posegsa.errors import ConfigError
from posegsa.gain import FuzzyGain
from posegsa.keys import keys, scenario_keys
from posegsa.metrics import metrics_of, run, take
from posegsa.optimisers import GSA, Box, Optimiser, RandomSearch, Search, advance, start
from posegsa.parameters import ParameterSpace, parameter_space
from posegsa.population import Problem, population_costs, problem
from posegsa.results import TuneResult
from posegsa.runtime import environment
from posegsa.scenario import Scenario, scenario

CHUNKS = 50
"""How many times a search reports its progress, at most; results do not depend on it."""


class Progress(NamedTuple):
    """What a progress callback is told."""

    iteration: int
    """Iterations done."""
    iterations: int
    """Iterations in all."""
    best_cost: float
    """Best cost so far, of a batch the least; infinite before any finite one."""
    seconds: float
    """Time since the search began, compiling not counted."""


class Task(NamedTuple):
    """One experiment made ready."""

    experiment: config.Experiment
    scenario: Scenario
    everywhere: Problem
    """Training scenarios, then held-out ones."""
    training: Problem
    space: ParameterSpace
    optimiser: Optimiser


class Found(NamedTuple):
    """What a search found, and how long it took [s]."""

    search: Search
    compile_seconds: float
    search_seconds: float


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
        found = _search_batch(tasks, progress)
        return TuneBatch(tuple(_result(t, f) for t, f in zip(tasks, found, strict=True)))


def _experiment(experiment: config.Experiment | str | Path | None) -> config.Experiment:
    if experiment is None:
        return config.Experiment()
    return experiment if isinstance(experiment, config.Experiment) else config.load(experiment)


def make_ready(experiment: config.Experiment) -> Task:
    """An experiment's scenarios, parameter space and optimiser."""
    one, count = scenario(experiment), experiment.run.training_scenarios
    held_out = held_out_keys(experiment, experiment.run.held_out_scenarios)
    everywhere = problem(experiment, one, jnp.concatenate([training_keys(experiment), held_out]))
    return Task(
        experiment,
        one,
        everywhere,
        take(everywhere, slice(count)),
        parameter_space(experiment),
        make_optimiser(experiment),
    )


def make_optimiser(experiment: config.Experiment) -> Optimiser:
    """The optimiser that an experiment configures."""
    search = experiment.search
    if search.optimiser == "random_search":
        return RandomSearch(search.agents, search.iterations)
    return GSA(search.agents, search.iterations, **experiment.gsa.model_dump())


@partial(jax.jit, static_argnums=(0, 1))
def _advance(
    optimiser: Optimiser,
    objective: config.ObjectiveConfig,
    search: Search,
    training: Problem,
    space: ParameterSpace,
    stop: ArrayLike,
) -> Search:
    """Run the search on to iteration `stop`, one compiled loop over iterations, agents and time."""

    def costs(vectors: Array) -> Array:
        return population_costs(vectors, training, space, objective)

    return advance(optimiser, costs, Box(space.lower, space.upper), search, stop)


@partial(jax.jit, static_argnums=(0, 1))
def _advance_batch(
    optimiser: Optimiser,
    objective: config.ObjectiveConfig,
    search: Search,
    training: Problem,
    space: ParameterSpace,
    stop: ArrayLike,
) -> Search:
    """The same for R searches, leaves (R, ...), in one compiled loop over them.

    A search fills the vector units by itself, so that on CPUs a loop over searches is as fast as a
    further batch axis; and each search is, bit for bit, what it is alone.
    """
    return jax.lax.map(
        lambda one: _advance(optimiser, objective, *one, stop), (search, training, space)
    )


def _run(
    go: Callable[[Search, int], Search],
    search: Search,
    iterations: int,
    progress: Callable[[Progress], object] | None,
) -> Found:
    """Compile a search, run it in chunks, and time both."""
    begun = time.perf_counter()
    # No iterations yet: this compiles, unless a search of this structure has run in this process.
    search = jax.block_until_ready(go(search, 0))
    compiled = time.perf_counter()
    if progress is not None:
        progress(Progress(0, iterations, math.inf, 0.0))
    chunk = -(-iterations // CHUNKS)
    for done in range(0, iterations, chunk):
        stop = min(done + chunk, iterations)
        search = jax.block_until_ready(go(search, stop))
        if progress is not None:
            best, seconds = float(jnp.min(search.best_cost)), time.perf_counter() - compiled
            progress(Progress(stop, iterations, best, seconds))
    return Found(search, compiled - begun, time.perf_counter() - compiled)


def run_search(task: Task, progress: Callable[[Progress], object] | None = None) -> Found:
    """Search a task's parameter space; nothing held out is looked at."""
    experiment, space, optimiser = task.experiment, task.space, task.optimiser
    search = start(optimiser, Box(space.lower, space.upper), keys(experiment.run.seed).search)

    def go(search: Search, stop: int) -> Search:
        return _advance(optimiser, experiment.objective, search, task.training, space, stop)

    return _run(go, search, optimiser.iterations, progress)


def _search_batch(
    tasks: Sequence[Task], progress: Callable[[Progress], object] | None
) -> list[Found]:
    """Search all tasks in one compiled call."""
    optimiser, objective = tasks[0].optimiser, tasks[0].experiment.objective
    for name, differs in (
        ("search or gsa", any(t.optimiser != optimiser for t in tasks)),
        ("objective", any(t.experiment.objective != objective for t in tasks)),
    ):
        if differs:
            raise ConfigError(f"{name}: differs within the batch; allowed: the same in all of it")
    try:
        training, space = jax.tree.map(
            lambda *leaves: jnp.stack(leaves), *((t.training, t.space) for t in tasks)
        )
    except (ValueError, TypeError) as error:
        raise ConfigError(
            "the experiments of a batch differ in structure; allowed: differences in traced values "
            f"only, such as noise, gamma, weights, boxes and initial errors ({error})"
        ) from None
    search_keys = jnp.stack([keys(t.experiment.run.seed).search for t in tasks])
    search = jax.vmap(lambda s, key: start(optimiser, Box(s.lower, s.upper), key))(
        space, search_keys
    )

    def go(search: Search, stop: int) -> Search:
        return _advance_batch(optimiser, objective, search, training, space, stop)

    found = _run(go, search, optimiser.iterations, progress)
    share = len(tasks)
    return [
        Found(
            jax.tree.map(lambda a, i=i: a[i], found.search),
            found.compile_seconds / share,
            found.search_seconds / share,
        )
        for i in range(share)
    ]


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
        evaluations=task.optimiser.agents * task.optimiser.iterations,
        non_finite=int(search.non_finite),
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=trajectory,
        environment=environment(),
        version=results.VERSION,
    )
