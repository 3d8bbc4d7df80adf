"""The search: an experiment made ready, and its parameter space searched in one compiled loop."""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from posegsa import config
from posegsa.comparison import held_out_keys, training_keys
from posegsa.errors import ConfigError
from posegsa.keys import keys
from posegsa.metrics import take
from posegsa.named_optimisers import make_optimiser
from posegsa.optimisers import (
    AnyOptimiser,
    Box,
    Search,
    advance,
    advance_on_host,
    forward_mode,
    start,
)
from posegsa.parameters import ParameterSpace, parameter_space
from posegsa.population import Problem, evaluate_population, population_costs, problem
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
    optimiser: AnyOptimiser


class Found(NamedTuple):
    """What a search found, and how long it took [s]."""

    search: Search
    compile_seconds: float
    search_seconds: float


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


@partial(jax.jit, static_argnums=(0, 1))
def _advance(
    optimiser: AnyOptimiser,
    objective: config.ObjectiveConfig,
    search: Search,
    training: Problem,
    space: ParameterSpace,
    stop: ArrayLike,
) -> Search:
    """Run the search on to iteration `stop`, one compiled loop over iterations, agents and time."""

    def costs(vectors: Array) -> Array:
        return population_costs(vectors, training, space, objective)

    box = Box(space.lower, space.upper)
    return advance(optimiser, forward_mode(costs), box, search, stop)


@partial(jax.jit, static_argnums=(0, 1))
def _advance_batch(
    optimiser: AnyOptimiser,
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
    return run_search_from(task, keys(task.experiment.run.seed).search, progress)


def run_search_from(
    task: Task, key: Array, progress: Callable[[Progress], object] | None = None
) -> Found:
    """The same with another random key of the search."""
    experiment, space, optimiser = task.experiment, task.space, task.optimiser
    box = Box(space.lower, space.upper)
    search = start(optimiser, box, key)

    def go(search: Search, stop: int) -> Search:
        return _advance(optimiser, experiment.objective, search, task.training, space, stop)

    def costs(vectors: Array) -> Array:
        return evaluate_population(vectors, task.training, space, objective=experiment.objective)

    def go_on_host(search: Search, stop: int) -> Search:
        if stop == 0:  # compile
            anything = jnp.tile(space.lower[None], (experiment.search.agents, 1))
            jax.block_until_ready(costs(anything))
        return advance_on_host(optimiser, costs, box, search, stop, numpy_objective=False)

    on_host = getattr(optimiser, "on_host", False)
    return _run(go_on_host if on_host else go, search, optimiser.iterations, progress)


def search_batch(
    tasks: Sequence[Task], progress: Callable[[Progress], object] | None
) -> list[Found]:
    """Search all tasks in one compiled call."""
    optimiser, objective = tasks[0].optimiser, tasks[0].experiment.objective
    for name, differs in (
        ("search or the optimiser's section", any(t.optimiser != optimiser for t in tasks)),
        ("objective", any(t.experiment.objective != objective for t in tasks)),
    ):
        if differs:
            raise ConfigError(f"{name}: differs within the batch; allowed: the same in all of it")
    if getattr(optimiser, "on_host", False):
        name = tasks[0].experiment.search.optimiser
        raise ConfigError(
            f"search.optimiser = {name!r} can't be compiled, and so not run in a batch"
        )
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
