"""The search: an experiment made ready, and its parameter space searched in one compiled loop."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.sharding import Mesh
from jax.typing import ArrayLike

from posegsa import config
from posegsa.errors import ConfigError
from posegsa.optimisers import (
    AnyOptimiser,
    Box,
    Search,
    advance,
    advance_on_host,
    forward_mode,
    start,
)
from posegsa.search.build import TuningProblem
from posegsa.search.devices import AXIS, collect, mesh_for, on_each, spread
from posegsa.search.keys import keys
from posegsa.search.parameters import ParameterSpace
from posegsa.search.population import ScenarioBatch, population_costs

CHUNKS = 50
"""Parts in which a search reports its progress; results do not depend on it."""
LONGEST_CHUNK = 2.0
"""Time after which a search reports all the same, if an iteration does not take longer [s]."""


class Progress(NamedTuple):
    """What a progress callback is told."""

    iteration: int
    """Iterations done."""
    iterations: int
    """Iterations in all."""
    best_cost: float
    """Best cost so far, of a batch the least; infinite before any finite one."""
    seconds: float
    """Time since the search began or went on, compiling not counted."""


Keep = Callable[[Search, float, float], object]
"""Told the search before it begins and after each chunk, with the time that this process has
searched and compiled [s]; what it raises stops the search."""


class Found(NamedTuple):
    """What a search found, and how long it took [s]."""

    search: Search
    compile_seconds: float
    search_seconds: float


@partial(jax.jit, static_argnums=(0, 1, 2))
def _advance(
    optimiser: AnyOptimiser,
    objective: config.ObjectiveConfig,
    mesh: Mesh | None,
    search: Search,
    training: ScenarioBatch,
    space: ParameterSpace,
    stop: ArrayLike,
) -> Search:
    """Run the search on to iteration `stop`, one compiled loop over iterations, agents and time.

    On a mesh, every device runs the search and its share of the simulations.
    """
    axis = None if mesh is None else AXIS

    def on_each_device(
        search: Search, training: ScenarioBatch, space: ParameterSpace, stop: Array
    ) -> Search:
        def costs(vectors: Array) -> Array:
            return population_costs(vectors, training, space, objective, axis)

        return advance(optimiser, forward_mode(costs), Box(space.lower, space.upper), search, stop)

    return on_each(mesh, on_each_device)(search, training, space, jnp.asarray(stop))


@partial(jax.jit, static_argnums=(0, 1, 2))
def _advance_batch(
    optimiser: AnyOptimiser,
    objective: config.ObjectiveConfig,
    mesh: Mesh | None,
    search: Search,
    training: ScenarioBatch,
    space: ParameterSpace,
    stop: ArrayLike,
) -> Search:
    """The same for R searches, leaves (R, ...), in one compiled loop over them.

    A search fills the vector units by itself, so that on CPUs a loop over searches is as fast as a
    further batch axis; and each search is, bit for bit, what it is alone.
    """
    return jax.lax.map(
        lambda one: _advance(optimiser, objective, mesh, *one, stop), (search, training, space)
    )


def run_in_chunks(
    go: Callable[[Search, int], Search],
    search: Search,
    iterations: int,
    progress: Callable[[Progress], object] | None,
    keep: Keep | None = None,
) -> Found:
    """Compile a search, run it in chunks from where it stands, and time both.

    Args:
        go: Takes a search on to an iteration; where it is there already, only compiles.
        search: Where to begin; or R searches, leaves (R, ...).
        iterations: Where to end.
        progress: As `tune`'s.
        keep: As `run_search`'s.
    """
    keep = keep if keep is not None else lambda *_: None
    tell = progress if progress is not None else lambda _: None
    keep(collect(search), 0.0, 0.0)
    begun = time.monotonic()
    # No iterations yet: this compiles, unless a search of this structure has run in this process.
    search = jax.block_until_ready(go(search, 0))
    compiled = time.monotonic()
    here = collect(search)
    done = int(jnp.max(here.iteration))
    tell(Progress(done, iterations, float(jnp.min(here.best_cost)), 0.0))
    even = -(-iterations // CHUNKS)
    alone = jax.process_count() == 1  # else all must stop at the same iterations
    fits = 1 if alone else even  # one iteration first, to learn the pace
    while done < iterations:
        stop = min(iterations, done + min(even - done % even, fits))
        before = time.monotonic()
        search = jax.block_until_ready(go(search, stop))
        now = time.monotonic()
        here = collect(search)
        keep(here, now - compiled, compiled - begun)
        tell(Progress(stop, iterations, float(jnp.min(here.best_cost)), now - compiled))
        pace = max(now - before, 1e-9) / (stop - done)
        done = stop
        if alone:
            fits = max(1, min(even, int(LONGEST_CHUNK / pace)))
    return Found(here, compiled - begun, time.monotonic() - compiled)


def first_search(task: TuningProblem, key: Array | None = None) -> Search:
    """A task's search before its first iteration; by default with the key of its seed."""
    space = task.space
    key = keys(task.experiment.run.seed).search if key is None else key
    return start(task.optimiser, Box(space.lower, space.upper), key)


def run_search(
    task: TuningProblem,
    progress: Callable[[Progress], object] | None = None,
    *,
    search: Search | None = None,
    keep: Keep | None = None,
) -> Found:
    """Search a task's parameter space; nothing held out is looked at.

    Args:
        task: What to search.
        progress: As `tune`'s.
        search: A search of this task to go on with; by default a new one.
        keep: What looks at the search on its way, such as to save it.
    """
    search = first_search(task) if search is None else search
    if getattr(task.optimiser, "on_host", False):
        return run_in_chunks(_on_host(task), search, task.optimiser.iterations, progress, keep)
    objective = task.experiment.objective
    mesh = _mesh(task)
    started, training, space = spread((search, task.training, task.space), mesh)

    def go(search: Search, stop: int) -> Search:
        return _advance(task.optimiser, objective, mesh, search, training, space, stop)

    return run_in_chunks(go, started, task.optimiser.iterations, progress, keep)


def _mesh(task: TuningProblem) -> Mesh | None:
    experiment = task.experiment
    return mesh_for(experiment.search.agents * experiment.run.training_scenarios)


@partial(jax.jit, static_argnums=(0, 1))
def _costs(
    objective: config.ObjectiveConfig,
    mesh: Mesh | None,
    vectors: Array,
    training: ScenarioBatch,
    space: ParameterSpace,
) -> Array:
    axis = None if mesh is None else AXIS

    def on_each_device(vectors: Array, training: ScenarioBatch, space: ParameterSpace) -> Array:
        return population_costs(vectors, training, space, objective, axis)

    return on_each(mesh, on_each_device)(vectors, training, space)


def on_all_devices(task: TuningProblem) -> Callable[[Array], Array]:
    """The objective of a task by itself: parameter vectors (A, 22) to costs (A,)."""
    mesh, objective = _mesh(task), task.experiment.objective
    training, space = spread((task.training, task.space), mesh)

    def costs(vectors: Array) -> Array:
        return collect(_costs(objective, mesh, spread(vectors, mesh), training, space))

    return costs


def _on_host(task: TuningProblem) -> Callable[[Search, int], Search]:
    """What runs a search on whose optimiser can't be compiled; the simulations are."""
    experiment, space = task.experiment, task.space
    costs = on_all_devices(task)

    def go(search: Search, stop: int) -> Search:
        if stop == 0:  # compile
            anything = jnp.tile(space.lower[None], (experiment.search.agents, 1))
            jax.block_until_ready(costs(anything))
        box = Box(space.lower, space.upper)
        return advance_on_host(task.optimiser, costs, box, search, stop, numpy_objective=False)

    return go


def search_batch(
    tasks: Sequence[TuningProblem], progress: Callable[[Progress], object] | None
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
        reach = max(task.space.reach for task in tasks)  # more than one's own changes no bit of it
        training, space = jax.tree.map(
            lambda *leaves: jnp.stack(leaves),
            *((task.training, replace(task.space, reach=reach)) for task in tasks),
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

    mesh = _mesh(tasks[0])
    search, training, space = spread((search, training, space), mesh)

    def go(search: Search, stop: int) -> Search:
        return _advance_batch(optimiser, objective, mesh, search, training, space, stop)

    found = run_in_chunks(go, search, optimiser.iterations, progress)
    share = len(tasks)
    return [
        Found(
            jax.tree.map(lambda a, i=i: a[i], found.search),
            found.compile_seconds / share,
            found.search_seconds / share,
        )
        for i in range(share)
    ]
