"""Run a search: search a problem's parameter space in one compiled loop."""

import contextlib
import time
import warnings
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa import steps
from posegsa.errors import ConfigError, PosegsaWarning, SearchInterrupted
from posegsa.filters.attitude import AttitudeFilter
from posegsa.filters.kalman import KalmanFilter
from posegsa.optimisers import (
    Search,
    in_chunks,
    runner,
    start,
)
from posegsa.optimisers.driver import CHUNKS, Runner
from posegsa.runtime import has_fast_path
from posegsa.search.candidates import SearchSpace
from posegsa.search.devices import AXIS, collect, mesh_for, on_each, spread
from posegsa.search.keys import keys
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.parameters import ParameterSpace
from posegsa.search.problem import TuningProblem

LONGEST_CHUNK = 2.0
"""Maximum time between two reports of a search, unless one iteration takes longer [s]."""


class Progress(NamedTuple):
    """The progress of a search."""

    iteration: int
    """Iterations done."""
    iterations: int
    """Iterations in all."""
    best_cost: float
    """Best cost so far, over the whole batch; infinite before the first finite cost."""
    seconds: float
    """Time since the search started or resumed, without compilation."""


def tell_search(progress: Progress) -> None:
    """Report the progress of a search that is a step of its own (`posegsa.steps`)."""
    done, parts = progress.iteration, progress.iterations
    steps.tell(steps.Step("searching", done, parts, best_cost=progress.best_cost))


def tell_share(progress: Progress) -> None:
    """Report the progress of a search that is part of a longer step (`posegsa.steps`)."""
    steps.share(progress.iteration / progress.iterations, progress.best_cost)


AfterChunk = Callable[[Search, float, float], object]
"""Called before the search starts and after each chunk, with the search and the time that this
process has searched and compiled [s]. An exception stops the search."""


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
    after_chunk: AfterChunk | None = None,
) -> Found:
    """Compile a search, run it in chunks to its end, and time both.

    Args:
        run: Runs a search to an iteration; if the search is already there, it only compiles.
        search: The initial search; or R searches, leaves (R, ...).
        iterations: Iteration at which to stop.
        progress: Called after compilation, and after each chunk of iterations.
        after_chunk: Called with the search after each chunk, to save it.
    """
    tell, seen = progress or (lambda _: None), after_chunk or (lambda *_: None)
    seen(collect(search), 0.0, 0.0)
    started = time.monotonic()
    # No iterations yet: this compiles, unless this process has run a search of this structure.
    search = jax.block_until_ready(run(search, 0))
    compiled = before = time.monotonic()
    here = collect(search)
    done = int(np.max(here.iteration))
    tell(Progress(done, iterations, best_cost=float(np.min(here.best_cost)), seconds=0.0))
    even = -(-iterations // CHUNKS)
    alone = jax.process_count() == 1  # joined processes must stop at the same iterations
    fits = 1 if alone else even  # one iteration first, to learn the pace

    def size(done: int) -> int:
        return min(even - done % even, fits)

    for stop, reached in in_chunks(run, search, done, iterations, size):
        here = collect(jax.block_until_ready(reached))
        now = time.monotonic()
        best = float(np.min(here.best_cost))
        reached = Progress(stop, iterations, best_cost=best, seconds=now - compiled)
        try:
            seen(here, now - compiled, compiled - started)
        except SearchInterrupted:  # these iterations are done
            with contextlib.suppress(Exception):  # the interrupt matters more than its report
                tell(reached)
            raise
        tell(reached)
        if alone:
            pace = max(now - before, 1e-9) / (stop - done)
            fits = max(1, min(even, int(LONGEST_CHUNK / pace)))
        done, before = stop, time.monotonic()
    return Found(here, compiled - started, time.monotonic() - compiled)


def first_search(problem: TuningProblem, key: Array | None = None) -> Search:
    """A problem's search before its first iteration; by default with the key of its seed."""
    key = keys(problem.experiment.run.seed).search if key is None else key
    return start(problem.experiment.search, problem.space.box, key)


def run_search(
    problem: TuningProblem,
    progress: Callable[[Progress], object] | None = None,
    *,
    search: Search | None = None,
    after_chunk: AfterChunk | None = None,
) -> Found:
    """Search a problem's parameter space, on training data only.

    Args:
        problem: What to search.
        progress: As in `run_timed`.
        search: A search of this problem to resume; by default a new one.
        after_chunk: As in `run_timed`.
    """
    optimiser, search = problem.experiment.search, search or first_search(problem)
    for phase in optimiser.phases:
        if price := phase.price(len(problem.space.box.lower)):
            warnings.warn(price, PosegsaWarning, stacklevel=2)
    _warn_of_long_iterations([problem])
    _warn_of_slow_filter(problem)
    search, run = _on_devices(problem, search)
    return run_timed(run, search, optimiser.total_iterations, progress, after_chunk)


SAMPLES_PER_SECOND = 4e7
"""Samples of an observer that two busy cores of 2.5 GHz simulate in a second."""
LONG_ITERATION = 5.0
"""A longer iteration is announced by a warning [s]: signals are answered after it."""


def samples_per_iteration(problem: TuningProblem) -> int:
    """Samples that an iteration simulates at most: agents x scenarios x samples."""
    batches = [problem.training, *([] if problem.beside is None else [problem.beside])]
    samples = sum(batch.samples.time.size for batch in batches)
    dimensions = len(problem.space.box.lower)
    return max(
        # A gradient, by forward mode, takes one simulation for each dimension.
        phase.agents * samples * (dimensions if phase.wants_gradients else 1)
        for phase in problem.experiment.search.phases
    )


def _warn_of_long_iterations(problems: Sequence[TuningProblem]) -> None:
    """Say how long an iteration of all takes if that is long, because it can't be interrupted."""
    samples = sum(map(samples_per_iteration, problems))
    seconds = samples / SAMPLES_PER_SECOND
    if jax.default_backend() == "cpu" and seconds > LONG_ITERATION:
        warnings.warn(
            f"an iteration simulates {samples:.2g} samples (agents x scenarios x samples), some "
            f"{seconds:.0f} s on two cores of 2.5 GHz; signals are answered between iterations",
            PosegsaWarning,
            stacklevel=3,
        )


def _warn_of_slow_filter(problem: TuningProblem) -> None:
    """Say that a filter with a large state is slow without XLA's options for speed.

    Measured: 9 to 13 us a Kalman filter and sample instead of 0.2; the observer takes three times
    as long, which is a matter of seconds.
    """
    large = isinstance(problem.training.filter, KalmanFilter | AttitudeFilter)
    slow = large and not has_fast_path()
    if jax.default_backend() == "cpu" and slow:
        warnings.warn(
            "a population of Kalman filters is some 40 times slower without XLA's options for "
            "speed: call posegsa.enable_fast_path() before anything else uses JAX",
            PosegsaWarning,
            stacklevel=3,
        )


def search_batch(
    problems: Sequence[TuningProblem], progress: Callable[[Progress], object] | None
) -> list[Found]:
    """Search all problems in one compiled call."""
    first = problems[0].experiment
    for name in ("search", "objective"):
        if any(getattr(problem.experiment, name) != getattr(first, name) for problem in problems):
            raise ConfigError(f"{name}: differs within the batch; allowed: the same in all of it")
    optimiser = first.search
    _warn_of_long_iterations(problems)
    # The searches share a program, and so the largest reach: pairs of terms that another search
    # would leave out do not overlap in it, and add 0.
    reach = max(getattr(problem.space.schedules, "reach", 0) for problem in problems)
    try:
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
    searches, run = _on_devices(problems[0]._replace(training=training, space=space), searches)
    found = run_timed(run, searches, optimiser.total_iterations, progress)
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
    """The structure that all searches of a batch must share, as they share a program."""
    searched = problem.training, _with_reach(problem.space, 0)
    leaves, tree = jax.tree.flatten(searched)
    shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
    return tree, shapes, problem.experiment.search, problem.experiment.objective


def _with_reach(space: SearchSpace, reach: int) -> SearchSpace:
    if not isinstance(space.schedules, ParameterSpace):
        return space
    return replace(space, schedules=replace(space.schedules, reach=reach))


def _on_devices(problem: TuningProblem, search: Search) -> tuple[Search, Runner]:
    """A search on its devices, and the compiled function that runs it.

    For R searches the problem's arrays have leaves (R, ...).
    """
    experiment = problem.experiment
    mesh = mesh_for(experiment.search.agents * experiment.run.training_scenarios)
    axis = None if mesh is None else AXIS
    objective = SearchObjective(experiment.objective, axis, problem.cost)
    given = search, problem.space.box, packed_batch(problem.training), problem.space
    search, box, *data = spread((*given, packed_batch(problem.beside)), mesh)
    return search, runner(experiment.search, objective, box, *data, on_devices=on_each(mesh))
