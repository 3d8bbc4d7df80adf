"""Run searches in chunks, with one compiled program for each kind of search."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

from posegsa.optimisers.ask_tell import Optimiser
from posegsa.optimisers.gradient import Differentiable
from posegsa.optimisers.loop import AnyObjective, Search, Until, advance
from posegsa.optimisers.search_box import Box

Runner = Callable[[Search, int], Search]
"""Runs a search to an iteration, counted from its start."""
OnDevices = Callable[[Callable[..., Any]], Callable[..., Any]]
"""Makes a function run on several devices, with the same arguments and results on each."""


CHUNKS = 50
"""Default number of parts in which a search is run; no result depends on it."""


def runner(
    optimiser: Optimiser,
    objective: AnyObjective | Callable[..., AnyObjective],
    box: Box,
    *data: Any,
    until: Until | None = None,
    python_objective: bool = False,
    on_devices: OnDevices | None = None,
) -> Runner:
    """A function that runs one search, or R of them: compiled, unless the objective is Python's.

    It is compiled once for each optimiser, objective and `on_devices`, which are compared by
    equality, and for each shape of the other arguments.

    Args:
        optimiser: The optimiser.
        objective: As in `advance`; with data, a function that makes the objective from the data.
        box: The box to search. For R searches it has leaves (R, ...), and so have the data.
        data: Arrays that the objective depends on; only if the search is compiled.
        until: As in `advance`.
        python_objective: As in `advance`.
        on_devices: The devices that run the search; by default one.
    """
    if not python_objective:
        return lambda search, stop: _advance(
            optimiser, objective, on_devices, data, box, search, stop, until
        )
    costs: Any = objective.costs if isinstance(objective, Differentiable) else objective

    def run(search: Search, stop: int) -> Search:
        if stop == 0:  # only to compile
            jax.block_until_ready(costs(jnp.tile(box.lower[None], (optimiser.agents, 1))))
        return advance(optimiser, costs, box, search, stop, until, python_objective=True)

    return run


@partial(jax.jit, static_argnums=(0, 1, 2))
def _advance(
    optimiser: Optimiser,
    objective: AnyObjective | Callable[..., AnyObjective],
    on_devices: OnDevices | None,
    data: tuple[Any, ...],
    box: Box,
    search: Search,
    stop: ArrayLike,
    until: Until | None,
) -> Search:
    """Run one search, or R of them, in one compiled loop over iterations and agents."""

    def one(problem: tuple[Any, Box, Search], stop: ArrayLike, until: Until | None) -> Search:
        data, box, search = problem
        given: Any = objective
        made = given(*data) if data else given
        return advance(optimiser, made, box, search, stop, until)

    def several(problems: tuple[Any, Box, Search], stop: ArrayLike, until: Until | None) -> Search:
        # One search fills a CPU's vector units, and XLA's fast path (`posegsa.enable_fast_path`)
        # fails on some searches with one more batch axis.
        if jax.default_backend() == "cpu":
            return lax.map(lambda problem: one(problem, stop, until), problems)
        return jax.vmap(one, in_axes=(0, None, None))(problems, stop, until)

    run = one if search.iteration.ndim == 0 else several
    return (on_devices(run) if on_devices else run)((data, box, search), stop, until)


def in_chunks(
    run: Runner, search: Search, begin: int, end: int, size: Callable[[int], int]
) -> Iterator[tuple[int, Search]]:
    """Run a search in chunks of iterations; yields the iterations due and the search after each.

    `size` maps the number of iterations done, at first `begin`, to the size of the next chunk.
    """
    done = begin
    while done < end:
        done = min(done + size(done), end)
        search = run(search, done)
        yield done, search
