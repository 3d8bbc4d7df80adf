"""`minimise`: one call that runs a search to its end, in compiled chunks or on the host."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from posegsa.optimisers.base import Box
from posegsa.optimisers.base import box as checked_box
from posegsa.optimisers.checks import check_callable, check_count, check_number, made_of_jax, refuse
from posegsa.optimisers.gradient import Differentiable
from posegsa.optimisers.loop import (
    AnyObjective,
    AnyOptimiser,
    Search,
    Until,
    advance,
    ask,
    evaluations_spent,
    is_satisfied,
    start,
    tell,
)
from posegsa.optimisers.polish import Polish

CHUNKS = 50
"""How often `minimise` looks at the clock where it has a limit and no chunk."""

_advance = jax.jit(advance, static_argnums=(0, 1))


@partial(jax.jit, static_argnums=(0, 1))
def _advance_many(
    optimiser: AnyOptimiser,
    objective: AnyObjective,
    box: Box,
    searches: Search,
    stop: int,
    until: Until | None,
) -> Search:
    """Run searches, leaves (R, ...), on: on CPUs one after the other, elsewhere side by side.

    On a CPU a search fills the vector units by itself. XLA's fast path there
    (`posegsa.enable_fast_path`) also fails on some searches with one more batch axis.
    """

    def one(search: Search) -> Search:
        return advance(optimiser, objective, box, search, stop, until)

    together = lax.map if jax.default_backend() == "cpu" else lambda f, a: jax.vmap(f)(a)
    return together(one, searches)


_ask = jax.jit(ask, static_argnums=0)
_tell = jax.jit(tell, static_argnums=0)
_is_satisfied = jax.jit(is_satisfied)


def minimise(
    objective: AnyObjective | Callable[[np.ndarray], Any],
    box: Box,
    optimiser: AnyOptimiser,
    key: Array,
    *,
    chunk: int | None = None,
    callback: Callable[[Search], object] | None = None,
    target: float | None = None,
    patience: int | None = None,
    tolerance: float = 0.0,
    evaluations: int | None = None,
    seconds: float | None = None,
    on_host: bool = False,
    search: Search | None = None,
) -> Search:
    """Minimise a batched function over a box.

    The loop is compiled once for each objective (told apart by identity), optimiser and shape of
    the box. An objective that closes over large arrays, or that is built anew for each call, is
    better served by `start` and `advance` inside a compiled function that takes them as arguments.

    Args:
        objective: Maps positions (agents, dimensions) in the box's coordinates to costs (agents,);
            see `advance` for costs that are not finite, and for gradients.
        box: Where to search; `box` makes one.
        optimiser: What searches, for how long and with how many agents.
        key: Random key (`jax.random.key`); the same key gives the same search, in whatever chunks.
            Keys (R,) give R searches in one call, every array with a leading axis of R.
        chunk: Iterations between two calls of `callback`; by default all of them.
        callback: Called with the search after each chunk, for progress or to save it
            (`posegsa.save_search`).
        target: Stop once the best cost is at most this.
        patience: Stop once the best cost has not fallen for this many iterations,
        tolerance: or has fallen by no more than this share of itself; only with `patience`.
        evaluations: Stop before the iteration that would go past this many evaluations; a cost
            with its gradient counts as the optimiser's `gradient_price`.
        seconds: Stop after the chunk in which this much time has passed, compiling included; where
            `chunk` is not given, a fiftieth of the iterations.
        on_host: The objective is an ordinary Python function: it is given a NumPy array, and
            called once for each iteration between compiled steps. For a gradient optimiser it
            returns costs and gradients.
        search: A search to go on with, such as `posegsa.load_search` or a callback gives; by
            default a new one.
            It goes on as if it had never stopped, to the last bit, and `key` is not used.

    Returns:
        The search, finished or stopped.

    Raises:
        ArgumentError: If an argument is not what is said here, or the objective does not return one
            cost per agent.
    """
    _check_arguments(objective, box, optimiser, key)
    if not any(isinstance(bound, Tracer) for bound in box):
        box = checked_box(*box)
    if callback is not None:
        check_callable("minimise: callback", callback)
    end = optimiser.iterations
    if evaluations is not None:
        check_count("minimise: evaluations", evaluations)
        end = int(np.searchsorted(evaluations_spent(optimiser), evaluations, side="right"))
    if seconds is not None:
        check_number("minimise: seconds", seconds)
    if chunk is None:
        chunk = max(1, end if seconds is None else -(-end // CHUNKS))
    check_count("minimise: chunk", chunk)
    until = _until(target, patience, tolerance)
    single = key.ndim == 0
    begin: Callable[..., Search] = partial(start, optimiser, box)
    if on_host or getattr(optimiser, "on_host", False):
        if not single:
            refuse(f"minimise: keys of shape {key.shape} on the host", "one key")
        plain: Any = objective.costs if isinstance(objective, Differentiable) else objective
        on_positions = plain if on_host else jax.jit(plain)
        go = partial(advance_on_host, optimiser, on_positions, box, numpy_objective=on_host)
    else:
        go = partial(_advance, optimiser, objective, box)
    if not single:
        begin, go = jax.vmap(begin), partial(_advance_many, optimiser, objective, box)

    begun = time.monotonic()
    now = begin(key)
    if search is not None:
        _check_structure(search, now)
        now = search
    first = 0 if isinstance(now.iteration, Tracer) else int(jnp.min(now.iteration))
    for done in range(first, end, chunk):
        stop = min(done + chunk, end)
        with made_of_jax():
            now = go(now, stop, until)
        if callback is not None:
            callback(now)
        if isinstance(now.iteration, Tracer):
            continue  # inside a transformation nobody knows yet whether there is more to do
        if until is not None and bool(jnp.all(now.iteration < stop)):
            break
        if seconds is not None and time.monotonic() - begun >= seconds:
            break
    return now


def advance_on_host(
    optimiser: AnyOptimiser,
    objective: Callable[..., Any],
    box: Box,
    search: Search,
    stop: int,
    until: Until | None = None,
    *,
    numpy_objective: bool = True,
) -> Search:
    """Run a search on, step by step, for what can't be compiled: `advance` on the host.

    Args:
        optimiser: What searches; not a `Polish`, whose two parts can be run in turn.
        objective: Maps positions (agents, dimensions) to costs (agents,), for a gradient optimiser
            to costs and gradients.
        box: Where to search.
        search: The search so far.
        stop: Number of iterations, counted from the start, after which to stop.
        until: When to stop before that; by default never.
        numpy_objective: Whether the objective is given NumPy arrays, or JAX's.

    Raises:
        ArgumentError: If the optimiser is a `Polish`, or the objective does not return one cost per
            agent.
    """
    if isinstance(optimiser, Polish):
        refuse("minimise: a Polish on the host", "its two optimisers, one after the other")
    eager = getattr(optimiser, "on_host", False)
    asked, told = (ask, tell) if eager else (_ask, _tell)
    while int(search.iteration) < min(stop, optimiser.iterations):
        if until is not None and bool(_is_satisfied(search, until)):
            break
        positions = asked(optimiser, box, search)
        found = objective(np.asarray(positions) if numpy_objective else positions)
        costs, *gradients = found if isinstance(found, tuple) else (found,)
        try:
            as_arrays = [np.asarray(a, box.lower.dtype) for a in (costs, *gradients)]
        except (TypeError, ValueError) as error:
            refuse(f"objective: {error}", f"costs ({optimiser.agents},), one per agent")
        search = told(optimiser, box, search, *as_arrays)
    return search


def _until(target: float | None, patience: int | None, tolerance: float) -> Until | None:
    """What stops a search inside the compiled loop; None where nothing does."""
    if target is not None and not isinstance(target, Tracer):
        check_number("minimise: target", target, least=-np.inf)
    if patience is not None:
        check_count("minimise: patience", patience)
    check_number("minimise: tolerance", tolerance)
    if patience is None and tolerance != 0:
        refuse(f"minimise: tolerance = {tolerance!r}", "with patience")
    if target is None and patience is None:
        return None
    until = Until()
    if target is not None:
        until = until._replace(target=target)
    return until if patience is None else until._replace(patience=patience, tolerance=tolerance)


def _check_structure(search: Search, like: Search) -> None:
    """Raise unless a search is one of the optimiser and box that `like` was started with."""
    if jax.tree.structure(search) != jax.tree.structure(like):
        refuse(f"search: a {type(search).__name__}", "a Search of this optimiser")
    leaves, wanted = (jax.tree_util.tree_leaves_with_path(s) for s in (search, like))
    for (place, leaf), (_, want) in zip(leaves, wanted, strict=True):
        if _kind(leaf) != _kind(want):
            refuse(
                f"search{jax.tree_util.keystr(place)} is {_kind(leaf)}",
                f"{_kind(want)}, as this optimiser and box have it",
            )


def _kind(leaf: Any) -> str:
    """An array's dtype and shape; the type of what is none, such as the strategy of pycma."""
    dtype = getattr(leaf, "dtype", None)
    return type(leaf).__name__ if dtype is None else f"{dtype} {leaf.shape}"


def _check_arguments(objective: Any, box: Any, optimiser: Any, key: Any) -> None:
    """Refuse arguments that are of another kind than `minimise` takes."""
    if not callable(objective) and not isinstance(objective, tuple):
        refuse(
            f"minimise: objective is a {type(objective).__name__}",
            "a function that maps positions (agents, dimensions) to costs (agents,)",
        )
    if not isinstance(box, Box):
        kind = type(box).__name__
        refuse(f"minimise: box is a {kind}", "a Box, as posegsa.box(lower, upper) makes it")
    if isinstance(optimiser, type) or not hasattr(optimiser, "init"):
        kind = type(optimiser).__name__
        refuse(f"minimise: optimiser is a {kind}", "settings such as posegsa.GSA(agents=50)")
    dtype = getattr(key, "dtype", None)
    if dtype is None or not jnp.issubdtype(dtype, jax.dtypes.prng_key) or key.ndim > 1:
        given = f"{type(key).__name__}" if dtype is None else f"{dtype} of shape {key.shape}"
        refuse(f"minimise: key is {given}", "jax.random.key(seed), or several of them (R,)")
