"""The search: an experiment made ready, and its parameter space searched in one compiled loop."""

import time
import warnings
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh
from jax.typing import ArrayLike

from posegsa import config, steps
from posegsa.errors import ConfigError, PosegsaWarning
from posegsa.optimisers import (
    Differentiable,
    Search,
    forward_mode,
    in_chunks,
    runner,
    start,
)
from posegsa.optimisers.driver import CHUNKS, Runner
from posegsa.search.build import TuningProblem
from posegsa.search.candidates import SearchSpace
from posegsa.search.devices import AXIS, collect, mesh_for, on_each, spread
from posegsa.search.keys import keys
from posegsa.search.packing import Packed, packed
from posegsa.search.parameters import ParameterSpace
from posegsa.search.population import ScenarioBatch, TrackCost, population_costs

LONGEST_CHUNK = 2.0
"""Time after which a search reports all the same, if an iteration does not take longer [s]."""


class Progress(NamedTuple):
    """What a progress callback is told."""

    iteration: int
    """Iterations done."""
    iterations: int
    """Iterations in all."""
    best_cost: float
    """Best cost so far, of a batch the lowest; infinite before any finite one."""
    seconds: float
    """Time since the search began or went on, compiling not counted."""


def tell_share(progress: Progress) -> None:
    """Tell how far a search is that is a part of something longer (`posegsa.steps`)."""
    steps.share(progress.iteration / progress.iterations)


Keep = Callable[[Search, float, float], object]
"""Told the search before it begins and after each chunk, with the time that this process has
searched and compiled [s]; what it raises stops the search."""


class Found(NamedTuple):
    """What a search found, and how long it took [s]."""

    search: Search
    compile_seconds: float
    search_seconds: float


def run_timed(
    run: Runner,
    search: Search,
    iterations: int,
    progress: Callable[[Progress], object] | None,
    keep: Keep | None = None,
) -> Found:
    """Compile a search, run it in chunks from where it stands, and time both.

    Args:
        run: Takes the search on; where it is there already, only compiles.
        search: Where to begin; or R searches, leaves (R, ...).
        iterations: Where to end.
        progress: As `tune`'s.
        keep: Looks at the search on its way, such as to save it.
    """
    keep, tell = keep or (lambda *_: None), progress or (lambda _: None)
    keep(collect(search), 0.0, 0.0)
    begun = time.monotonic()
    # No iterations yet: this compiles, unless a search of this structure has run in this process.
    search = jax.block_until_ready(run(search, 0))
    compiled = before = time.monotonic()
    here = collect(search)
    done = int(np.max(here.iteration))
    tell(Progress(done, iterations, best_cost=float(np.min(here.best_cost)), seconds=0.0))
    even = -(-iterations // CHUNKS)
    alone = jax.process_count() == 1  # else all must stop at the same iterations
    fits = 1 if alone else even  # one iteration first, to learn the pace

    def size(done: int) -> int:
        return min(even - done % even, fits)

    for stop, reached in in_chunks(run, search, done, iterations, size):
        here = collect(jax.block_until_ready(reached))
        now = time.monotonic()
        keep(here, now - compiled, compiled - begun)
        best = float(np.min(here.best_cost))
        tell(Progress(stop, iterations, best_cost=best, seconds=now - compiled))
        if alone:
            pace = max(now - before, 1e-9) / (stop - done)
            fits = max(1, min(even, int(LONGEST_CHUNK / pace)))
        done, before = stop, time.monotonic()
    return Found(here, compiled - begun, time.monotonic() - compiled)


def first_search(problem: TuningProblem, key: Array | None = None) -> Search:
    """A problem's search before its first iteration; by default with the key of its seed."""
    key = keys(problem.experiment.run.seed).search if key is None else key
    return start(problem.experiment.search, problem.space.box, key)


def run_search(
    problem: TuningProblem,
    progress: Callable[[Progress], object] | None = None,
    *,
    search: Search | None = None,
    keep: Keep | None = None,
) -> Found:
    """Search a problem's parameter space; nothing held out is looked at.

    Args:
        problem: What to search.
        progress: As `tune`'s.
        search: A search of this problem to go on with; by default a new one.
        keep: As `run_timed`'s.
    """
    optimiser, search = problem.experiment.search, search or first_search(problem)
    for phase in optimiser.phases:
        if price := phase.price(len(problem.space.box.lower)):
            warnings.warn(price, PosegsaWarning, stacklevel=2)
    if not optimiser.on_host:
        return _run_on_devices(problem, search, progress, keep)
    run = runner(optimiser, on_all_devices(problem), problem.space.box, python_objective=True)
    return run_timed(run, search, optimiser.total_iterations, progress, keep)


def search_batch(
    problems: Sequence[TuningProblem], progress: Callable[[Progress], object] | None
) -> list[Found]:
    """Search all problems in one compiled call."""
    first = problems[0].experiment
    for name in ("search", "objective"):
        if any(getattr(problem.experiment, name) != getattr(first, name) for problem in problems):
            raise ConfigError(f"{name}: differs within the batch; allowed: the same in all of it")
    optimiser = first.search
    if optimiser.on_host:
        raise ConfigError(
            f"search.optimiser = {optimiser.optimiser!r} can't be compiled, and so not run in a "
            "batch"
        )
    try:
        reach = max(
            problem.space.schedules.reach for problem in problems
        )  # more changes no bit of any
        training, space = jax.tree.map(
            lambda *leaves: jnp.stack(leaves),
            *((problem.training, _with_reach(problem.space, reach)) for problem in problems),
        )
    except (ValueError, TypeError) as error:
        raise ConfigError(
            "the experiments of a batch differ in structure; allowed: differences in traced values "
            f"only, such as noise, gamma, weights, boxes and initial errors ({error})"
        ) from None
    search_keys = jnp.stack([keys(problem.experiment.run.seed).search for problem in problems])
    searches = jax.vmap(partial(start, optimiser))(space.box, search_keys)
    together = problems[0]._replace(training=training, space=space)
    found = _run_on_devices(together, searches, progress)
    share = len(problems)
    return [
        Found(
            jax.tree.map(lambda a, i=i: a[i], found.search),
            found.compile_seconds / share,
            found.search_seconds / share,
        )
        for i in range(share)
    ]


def structure(problem: TuningProblem) -> Hashable:
    """What the searches of a batch must have in common: their program, all but their numbers."""
    searched = problem.training, _with_reach(problem.space, 0)
    leaves, tree = jax.tree.flatten(searched)
    shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
    return tree, shapes, problem.experiment.search, problem.experiment.objective


def _with_reach(space: SearchSpace[ParameterSpace], reach: int) -> SearchSpace[ParameterSpace]:
    return replace(space, schedules=replace(space.schedules, reach=reach))


def _run_on_devices(
    problem: TuningProblem,
    search: Search,
    progress: Callable[[Progress], object] | None,
    keep: Keep | None = None,
) -> Found:
    """Run one compiled search, or R of them: then the problem's arrays have leaves (R, ...)."""
    optimiser, objective, mesh = problem.experiment.search, *_objective(problem)
    given = search, problem.space.box, _packed(problem.training), problem.space
    search, box, *data = spread((*given, _packed(problem.beside)), mesh)
    run = runner(optimiser, objective, box, *data, on_devices=on_each(mesh))
    return run_timed(run, search, optimiser.total_iterations, progress, keep)


class _Objective(NamedTuple):
    """What is minimised, for programs that are compiled for it."""

    objective: config.ObjectiveConfig
    axis: str | None
    """Axis of the mesh over which the simulations are divided, if they are."""
    cost: TrackCost | None
    """A user's own cost of a simulation, instead of the configured one."""

    def __call__(
        self, training: Packed, space: SearchSpace, beside: Packed | None
    ) -> Differentiable:
        """As a function of vectors (A, d), on training scenarios, which are `ScenarioBatch`es."""
        simulated = None if beside is None else beside.unpacked()
        return forward_mode(
            lambda vectors: population_costs(
                vectors,
                training.unpacked(),
                space,
                self.objective,
                self.axis,
                self.cost,
                simulated,
            )
        )


def _packed(batch: ScenarioBatch | None) -> Packed | None:
    return None if batch is None else packed(batch, batch.samples.time)


def _objective(problem: TuningProblem) -> tuple[_Objective, Mesh | None]:
    """The objective of a problem, and the devices over which its simulations are divided."""
    experiment = problem.experiment
    mesh = mesh_for(experiment.search.agents * experiment.run.training_scenarios)
    axis = None if mesh is None else AXIS
    return _Objective(experiment.objective, axis, problem.cost), mesh


def on_all_devices(problem: TuningProblem) -> Callable[[ArrayLike], Array]:
    """The objective of a problem by itself: parameter vectors (A, 22) to costs (A,)."""
    objective, mesh = _objective(problem)
    data = spread((_packed(problem.training), problem.space, _packed(problem.beside)), mesh)
    costs = _costs(objective, mesh)

    def call(vectors: ArrayLike) -> Array:
        # From the host to several devices in half the time that one of them needs to the others.
        given = vectors if mesh is None else np.asarray(vectors)
        return collect(costs(spread(given, mesh), *data))

    return call


@cache
def _costs(objective: _Objective, mesh: Mesh | None) -> Callable[..., Array]:
    def costs(vectors: Array, training: Packed, space: SearchSpace, beside: Packed | None) -> Array:
        return objective(training, space, beside).costs(vectors)

    return jax.jit(on_each(mesh)(costs))
