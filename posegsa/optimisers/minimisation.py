"""`minimise`: one call that runs a search to its end."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from posegsa.arguments import (
    check_callable,
    check_number,
    check_type,
    check_whole,
    made_of_jax,
    refuse,
)
from posegsa.optimisers.ask_tell import Optimiser
from posegsa.optimisers.driver import CHUNKS, in_chunks, runner
from posegsa.optimisers.gradient import Differentiable
from posegsa.optimisers.loop import AnyObjective, Search, Until, start
from posegsa.optimisers.search_box import Box
from posegsa.optimisers.search_box import box as checked_box


def minimise(
    objective: AnyObjective,
    box: Box,
    optimiser: Optimiser,
    key: Array,
    *,
    chunk: int | None = None,
    callback: Callable[[Search], object] | None = None,
    target: float | None = None,
    patience: int | None = None,
    tolerance: float = 0.0,
    evaluations: int | None = None,
    seconds: float | None = None,
    python_objective: bool = False,
    search: Search | None = None,
) -> Search:
    """Minimise a batched function over a box.

    The loop is compiled once for each objective (compared by identity), optimiser and shape of the
    box. If the objective closes over large arrays, or is built again for each call, better use
    `start` and `advance` inside your own compiled function, with the arrays as its arguments.

    Args:
        objective: Maps positions (agents, dimensions) in the box's coordinates to costs (agents,);
            see `advance` for costs that are not finite, and for gradients.
        box: The box to search, made by `box`.
        optimiser: The optimiser, with its number of iterations and agents.
        key: Random key (`jax.random.key`); the same key gives the same search, for any chunks.
            Keys (R,) give R searches in one call, with a leading axis R on every array.
        chunk: Iterations between two calls of `callback`; by default all of them.
        callback: Called with the search after each chunk, for progress or to save it
            (`posegsa.save_search`).
        target: Stop once the best cost is at most this.
        patience: Stop once the best cost has not fallen for this many iterations by more than
            `tolerance`.
        tolerance: Share of its value by which the best cost has to fall; only with `patience`.
        evaluations: Stop before the iteration that would exceed this many evaluations; a cost with
            its gradient counts as several (`Optimiser.evaluations_per_agent`).
        seconds: Stop after the chunk in which this time has passed, including compilation. The
            chunk is then a fiftieth of the iterations by default.
        python_objective: The objective is an ordinary Python function. It gets a NumPy array, and
            is called once for each iteration between compiled steps. If gradients are wanted, it
            returns costs and gradients.
        search: A search to continue, from `posegsa.load_search` or a callback; by default a new
            one. It gives the same bits as if it had never stopped, and `key` is not used.

    Returns:
        The search, finished or stopped.

    Raises:
        ArgumentError: An argument has a wrong type or value, or the objective does not return one
            cost per agent.
    """
    if not isinstance(objective, Differentiable) and not callable(objective):
        allowed = "a function that maps positions (agents, dimensions) to costs (agents,)"
        refuse(f"minimise: objective: a {type(objective).__name__}", allowed)
    check_type("minimise: box", box, Box, allowed="a Box, as posegsa.box(lower, upper) makes it")
    allowed = "settings such as posegsa.GSA(agents=50)"
    check_type("minimise: optimiser", optimiser, Optimiser, allowed=allowed)
    is_key = hasattr(key, "dtype") and jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    if not is_key or key.ndim > 1:
        refuse(f"minimise: key: a {_kind(key)}", "jax.random.key(seed), or several of them (R,)")
    check_callable("minimise: callback", callback)
    if not any(isinstance(bound, Tracer) for bound in box):
        box = checked_box(*box)
    end = optimiser.total_iterations
    if evaluations is not None:
        check_whole("minimise: evaluations", evaluations, 1)
        end = int(np.searchsorted(optimiser.evaluations_spent(), evaluations, side="right"))
    if seconds is not None:
        check_number("minimise: seconds", seconds, 0)
    if chunk is None:
        chunk = max(1, end if seconds is None else -(-end // CHUNKS))
    check_whole("minimise: chunk", chunk, 1)
    until = _until(target, patience, tolerance)
    begin = partial(start, optimiser)
    if key.ndim > 0:
        if python_objective:
            refuse(f"minimise: keys of shape {key.shape} on the host", "one key")
        box = jax.tree.map(lambda bound: jnp.broadcast_to(bound, (len(key), *bound.shape)), box)
        begin = jax.vmap(begin)
    run = made_of_jax("objective", "the values of its positions")(
        runner(optimiser, objective, box, until=until, python_objective=python_objective)
    )

    started = time.monotonic()
    new = begin(box, key)
    if search is not None:
        _check_structure(search, new)
    now = first = new if search is None else search
    done = 0 if isinstance(first.iteration, Tracer) else int(jnp.min(first.iteration))
    for stop, now in in_chunks(run, first, done, end, lambda _: chunk):
        if callback is not None:
            callback(now)
        if isinstance(now.iteration, Tracer):
            continue  # under a transformation it is not yet known whether to stop
        if jnp.all(now.iteration < stop):
            break
        if seconds is not None and time.monotonic() - started >= seconds:
            break
    return now


def _until(target: float | None, patience: int | None, tolerance: float) -> Until | None:
    """The stopping conditions inside the compiled loop, or None."""
    check_number("minimise: tolerance", tolerance, 0)
    if target is not None and not isinstance(target, Tracer):
        check_number("minimise: target", target)
    if patience is not None:
        check_whole("minimise: patience", patience, 1)
    elif tolerance != 0:
        refuse(f"minimise: tolerance = {tolerance!r}", "with patience")
    stops = {"target": target, "patience": patience}
    given = {name: value for name, value in stops.items() if value is not None}
    return Until(tolerance=tolerance, **given) if given else None


def _check_structure(search: Search, like: Search) -> None:
    """Raise unless a search has the same optimiser and box as `like`."""
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
    """Dtype and shape of an array, or the type of any other leaf."""
    dtype = getattr(leaf, "dtype", None)
    return type(leaf).__name__ if dtype is None else f"{dtype} {leaf.shape}"
