"""The search: an experiment made ready, and its parameter space searched in one compiled loop."""

import contextlib
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

from posegsa import steps
from posegsa.errors import ConfigError, PosegsaWarning, SearchInterrupted
from posegsa.optimisers import (
    Search,
    in_chunks,
    runner,
    start,
)
from posegsa.optimisers.driver import CHUNKS, Runner
from posegsa.optimisers.loop import advance
from posegsa.search.build import TuningProblem
from posegsa.search.candidates import SearchSpace
from posegsa.search.devices import AXIS, collect, mesh_for, on_each, spread
from posegsa.search.keys import keys
from posegsa.search.large_populations import PiecewiseCosts, is_large, most_work, work
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.packing import Packed
from posegsa.search.parameters import ParameterSpace

LONGEST_CHUNK = 2.0
"""Time after which a search reports all the same, if an iteration does not take longer [s]."""


class Progress(NamedTuple):
    """Where a search stands."""

    iteration: int
    """Iterations done."""
    iterations: int
    """Iterations in all."""
    best_cost: float
    """Best cost so far, of a batch the lowest; infinite before any finite one."""
    seconds: float
    """Time since the search began or went on, compiling not counted."""
    share: float = 0.0
    """Share of the next iteration that is done, where it goes in pieces."""


def tell_search(progress: Progress) -> None:
    """Tell how far a search is that is a step of its own (`posegsa.steps`)."""
    done = progress.iteration + progress.share
    steps.tell(steps.Step("searching", done, progress.iterations, best_cost=progress.best_cost))


def tell_share(progress: Progress) -> None:
    """Tell how far a search is that is a part of something longer (`posegsa.steps`)."""
    steps.share((progress.iteration + progress.share) / progress.iterations)


Keep = Callable[[Search, float, float], object]
"""Told the search before it begins and after each chunk, with the time that this process has
searched and compiled [s]; what it raises stops the search."""


Told = Callable[[float], object]
"""Told what share of an iteration is done, where it goes in pieces."""


class Found(NamedTuple):
    """What a search found, and how long it took [s]."""

    search: Search
    compile_seconds: float
    search_seconds: float


def run_timed(
    make: Callable[[Told], Runner],
    search: Search,
    iterations: int,
    progress: Callable[[Progress], object] | None,
    keep: Keep | None = None,
    pause: Callable[[], object] | None = None,
    *,
    piecewise: bool = False,
) -> Found:
    """Compile a search, run it in chunks from where it stands, and time both.

    Args:
        make: Makes what takes the search on, or where it is there already only compiles.
        search: Where to begin; or R searches, leaves (R, ...).
        iterations: Where to end.
        progress: Called when it is compiled, and after each chunk of iterations.
        keep: Looks at the search on its way, such as to save it.
        pause: Called between the pieces of an iteration; what it raises stops the search there.
        piecewise: Its iterations have pieces, so that each is a chunk of its own.
    """

    def told(share: float) -> None:
        if pause is not None:
            pause()
        best, seconds = float(np.min(here.best_cost)), time.monotonic() - compiled
        tell(Progress(done, iterations, best_cost=best, seconds=seconds, share=share))

    run = make(told)
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
    fits = 1 if alone or piecewise else even  # one iteration first, to learn the pace

    def size(done: int) -> int:
        return min(even - done % even, fits)

    for stop, reached in in_chunks(run, search, done, iterations, size):
        here = collect(jax.block_until_ready(reached))
        now = time.monotonic()
        best = float(np.min(here.best_cost))
        reached = Progress(stop, iterations, best_cost=best, seconds=now - compiled)
        try:
            keep(here, now - compiled, compiled - begun)
        except SearchInterrupted:  # these iterations are done all the same
            with contextlib.suppress(Exception):  # how to go on matters more
                tell(reached)
            raise
        tell(reached)
        if alone and not piecewise:
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
    pause: Callable[[], object] | None = None,
) -> Found:
    """Search a problem's parameter space; nothing held out is looked at.

    Args:
        problem: What to search.
        progress: As `run_timed`'s.
        search: A search of this problem to go on with; by default a new one.
        keep: As `run_timed`'s.
        pause: As `run_timed`'s.
    """
    optimiser, search = problem.experiment.search, search or first_search(problem)
    for phase in optimiser.phases:
        if price := phase.price(len(problem.space.box.lower)):
            warnings.warn(price, PosegsaWarning, stacklevel=2)
    iterations, large = optimiser.total_iterations, is_large(problem)
    if large:
        make = partial(_in_pieces, problem)
    elif optimiser.on_host:
        costs, box = on_all_devices(problem), problem.space.box
        make = partial(_whole, runner(optimiser, costs, box, python_objective=True))
    else:
        search, run = _on_devices(problem, search)
        make = partial(_whole, run)
    return run_timed(make, search, iterations, progress, keep, pause, piecewise=large)


def _whole(run: Runner, told: Told) -> Runner:
    """What takes a search on in whole iterations, so that there is nothing to tell of parts."""
    del told
    return run


def _in_pieces(problem: TuningProblem, told: Told) -> Runner:
    """What takes the search of a large population on."""
    optimiser, box = problem.experiment.search, problem.space.box
    costs = PiecewiseCosts(problem, *_objective(problem), told)

    def run(search: Search, stop: int) -> Search:
        if stop == 0:
            costs.compile()
        return advance(optimiser, costs.objective, box, search, stop, between=costs.between)

    return run


def search_batch(
    problems: Sequence[TuningProblem], progress: Callable[[Progress], object] | None
) -> list[Found]:
    """Search all problems in one compiled call, or one by one where that would be too much work."""
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
    share = len(problems)
    large = share * work(problems[0]) > most_work() or is_large(problems[0])
    if large:
        alike = [one._replace(space=_with_reach(one.space, reach)) for one in problems]
        make = partial(_one_by_one, alike)
    else:
        together = problems[0]._replace(training=training, space=space)
        searches, run = _on_devices(together, searches)
        make = partial(_whole, run)
    iterations = optimiser.total_iterations
    found = run_timed(make, searches, iterations, progress, piecewise=large)
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


def _one_by_one(problems: Sequence[TuningProblem], told: Told) -> Runner:
    """What takes R searches on, leaves (R, ...), one after the other."""
    runs = []
    for i, problem in enumerate(problems):
        if is_large(problem):
            run, mesh = (
                _in_pieces(problem, lambda share, i=i: told((i + share) / len(problems))),
                None,
            )
        else:
            _, run = _on_devices(problem, first_search(problem))
            _, mesh = _objective(problem)
        runs.append((run, mesh))

    def run_all(searches: Search, stop: int) -> Search:
        found = []
        for i, (run, mesh) in enumerate(runs):
            search = jax.tree.map(lambda a, i=i: a[i], searches)
            found.append(collect(run(spread(search, mesh), stop)))
            if stop > 0:
                told((i + 1) / len(runs))
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *found)

    return run_all


def _on_devices(problem: TuningProblem, search: Search) -> tuple[Search, Runner]:
    """A search where it runs, and what takes it on in one compiled call.

    Of R searches the problem's arrays have leaves (R, ...).
    """
    optimiser, objective, mesh = problem.experiment.search, *_objective(problem)
    given = search, problem.space.box, packed_batch(problem.training), problem.space
    search, box, *data = spread((*given, packed_batch(problem.beside)), mesh)
    return search, runner(optimiser, objective, box, *data, on_devices=on_each(mesh))


def _objective(problem: TuningProblem) -> tuple[SearchObjective, Mesh | None]:
    """The objective of a problem, and the devices over which its simulations are divided."""
    experiment = problem.experiment
    mesh = mesh_for(experiment.search.agents * experiment.run.training_scenarios)
    axis = None if mesh is None else AXIS
    return SearchObjective(experiment.objective, axis, problem.cost), mesh


def on_all_devices(problem: TuningProblem) -> Callable[[ArrayLike], Array]:
    """The objective of a problem by itself: parameter vectors (A, 22) to costs (A,)."""
    objective, mesh = _objective(problem)
    data = spread(
        (packed_batch(problem.training), problem.space, packed_batch(problem.beside)), mesh
    )
    costs = _costs(objective, mesh)

    def call(vectors: ArrayLike) -> Array:
        # From the host to several devices in half the time that one of them needs to the others.
        given = vectors if mesh is None else np.asarray(vectors)
        return collect(costs(spread(given, mesh), *data))

    return call


@cache
def _costs(objective: SearchObjective, mesh: Mesh | None) -> Callable[..., Array]:
    def costs(vectors: Array, training: Packed, space: SearchSpace, beside: Packed | None) -> Array:
        return objective(training, space, beside).costs(vectors)

    return jax.jit(on_each(mesh)(costs))
