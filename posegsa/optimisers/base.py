"""The search box, the ask/tell protocol and the one loop that runs every optimiser.

An optimiser sees the unit box and finite costs only. This module maps its positions into the
user's box, deals with costs that are not finite, and keeps the record of the search.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax, random
from jax.typing import ArrayLike, DTypeLike

from posegsa.optimisers.checks import (
    check_callable,
    check_count,
    check_key,
    made_of_jax,
    real_array,
    refuse,
)

Objective = Callable[[Array], Array]
"""Maps positions (agents, dimensions), in the box's coordinates, to costs (agents,)."""


class Box(NamedTuple):
    """A box to search in; `box` builds a checked one."""

    lower: Array  # (dimensions,)
    upper: Array  # (dimensions,); equal to lower where a coordinate is fixed


class History(NamedTuple):
    """What each iteration saw; NaN (0 for the count) from `Search.iteration` on."""

    best: Array  # (iterations,) best cost so far; inf before any finite one
    mean: Array  # (iterations,) mean of the iteration's finite costs; NaN if there were none
    worst: Array  # (iterations,) largest of the iteration's finite costs; NaN if there were none
    non_finite: Array  # (iterations,) int32, number of the iteration's costs that were not finite


class Search(NamedTuple):
    """The whole state of a search: all that `advance` needs to go on, and all it found."""

    state: Any  # the optimiser's own state
    best_position: Array  # (dimensions,) in the box's coordinates; its centre until a finite cost
    best_cost: Array  # () inf until a finite cost
    iteration: Array  # () int32, iterations done
    non_finite: Array  # () int32, costs so far that were not finite
    history: History


class Optimiser(Protocol):
    """Settings with three pure methods over an immutable state; positions lie in the unit box.

    An implementation is frozen and hashable, so that it can be static in a compiled function. The
    costs it is told are finite: `advance` sees to that.
    """

    @property
    def agents(self) -> int:
        """Number of positions asked for at once."""
        ...

    @property
    def iterations(self) -> int:
        """Number of iterations that a whole search takes."""
        ...

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> Any:
        """Return the state before the first `ask`; it carries the key."""
        ...

    def ask(self, state: Any) -> Array:
        """Return the positions (agents, dimensions) in [0, 1] whose costs are wanted next."""
        ...

    def tell(self, state: Any, costs: Array) -> Any:
        """Return the state after learning the costs (agents,) of the positions asked for."""
        ...


def box(lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike) -> Box:
    """Build a box and check it; outside jit only.

    Args:
        lower: Smallest value of each coordinate, (dimensions,).
        upper: Largest value of each coordinate, (dimensions,). A coordinate whose two bounds are
            equal is fixed at that value.

    Returns:
        The box, in the bounds' own floating type as far as JAX has it; the search runs in that.

    Raises:
        ArgumentError: If the bounds are not numbers of one equal length of at least 1, if one is
            not finite in their type, or if a lower bound lies above its upper one.
    """
    low, high = (real_array(f"box: {n}", a) for n, a in (("lower", lower), ("upper", upper)))
    dtype = jax.dtypes.canonicalize_dtype(np.result_type(low, high, np.float32))
    with np.errstate(over="ignore"):
        low, high = low.astype(dtype), high.astype(dtype)
    for name, bound in (("lower", low), ("upper", high)):
        if bound.ndim != 1 or bound.size == 0:
            refuse(f"box: {name} has shape {bound.shape}", "(dimensions,), dimensions >= 1")
        for i in np.flatnonzero(~np.isfinite(bound)):
            refuse(f"box: {name}[{i}] = {bound[i]}", f"a finite {dtype} number")
    if low.shape != high.shape:
        refuse(f"box: lower has shape {low.shape}, upper {high.shape}", "equal shapes")
    for i in np.flatnonzero(low > high):
        refuse(f"box: lower[{i}] = {low[i]}, upper[{i}] = {high[i]}", "lower <= upper")
    return Box(jnp.asarray(low), jnp.asarray(high))


_checked_box = box
"""`box` under a name that no argument hides."""


def from_unit(box: Box, unit: Array) -> Array:
    """Map positions in the unit box into `box`, never past its bounds.

    Args:
        box: The target box of d coordinates.
        unit: Positions (..., d) in [0, 1].

    Returns:
        Positions (..., d); 0 and 1 give the bounds exactly, and a box of zero width its value.
    """
    lower = jnp.broadcast_to(box.lower, unit.shape)
    upper = jnp.broadcast_to(box.upper, unit.shape)
    return jnp.clip(lower * (1 - unit) + upper * unit, lower, upper)


def start(optimiser: Optimiser, box: Box, key: Array) -> Search:
    """Return a search that has not evaluated anything yet.

    Args:
        optimiser: What searches.
        box: Where.
        key: Random key of the whole search.

    Returns:
        The search at iteration 0. Its best position is the box's centre, with cost inf: a
        position that is safe to use, but that nobody has evaluated.
    """
    dimensions, dtype = box.lower.shape[0], box.lower.dtype
    unknown = jnp.full(optimiser.iterations, jnp.nan, dtype)
    return Search(
        state=optimiser.init(key, dimensions, dtype),
        best_position=from_unit(box, jnp.full(dimensions, 0.5, dtype)),
        best_cost=jnp.asarray(jnp.inf, dtype),
        iteration=jnp.asarray(0, jnp.int32),
        non_finite=jnp.asarray(0, jnp.int32),
        history=History(
            best=unknown,
            mean=unknown,
            worst=unknown,
            non_finite=jnp.zeros(optimiser.iterations, jnp.int32),
        ),
    )


def advance(
    optimiser: Optimiser, objective: Objective, box: Box, search: Search, stop: ArrayLike
) -> Search:
    """Run a search on, from the iteration it has reached to `stop`.

    It is pure, and made for the caller's own jit: `objective` may close over traced arrays. `stop`
    may be traced too, so that one compilation serves chunks of every size, and a search gives the
    same bits in whatever chunks it is run. On several devices, run it inside `jax.shard_map` and
    let the objective split the agents and gather their costs: the search itself is then the same
    on every device, to the last bit.

    Args:
        optimiser: What searches; the one that `search` was started with.
        objective: Maps positions (agents, dimensions) in the box's coordinates to costs (agents,).
            A cost that is not finite marks a position that could not be judged: it is counted,
            told to the optimiser as the iteration's worst finite cost (all costs as 0 where none
            is finite), and never becomes the best.
        box: Where to search.
        search: The search so far, from `start` or `advance`.
        stop: Number of iterations, counted from the start of the search, after which to stop; the
            search ends at `optimiser.iterations` in any case.

    Returns:
        The search with `stop` iterations done.

    Raises:
        ArgumentError: If the objective does not return one cost per agent.
    """
    stop = jnp.minimum(stop, optimiser.iterations)
    return lax.while_loop(
        lambda search: search.iteration < stop,
        lambda search: _iterate(optimiser, objective, box, search),
        search,
    )


def _iterate(optimiser: Optimiser, objective: Objective, box: Box, search: Search) -> Search:
    """Ask, evaluate, record and tell, once."""
    dtype = box.lower.dtype
    positions = from_unit(box, optimiser.ask(search.state))
    returned = objective(positions)
    if not hasattr(returned, "dtype") or not jnp.issubdtype(returned.dtype, jnp.number):
        refuse(f"objective: returns a {type(returned).__name__}", "an array of numbers")
    if jnp.issubdtype(returned.dtype, jnp.complexfloating):
        refuse(f"objective: returns {returned.dtype}", "real numbers")
    costs = jnp.asarray(returned).astype(dtype)
    if costs.shape != (optimiser.agents,):
        refuse(f"objective: costs of shape {costs.shape}", f"({optimiser.agents},), one per agent")

    finite = jnp.isfinite(costs)
    failures = jnp.sum(~finite, dtype=jnp.int32)
    some = finite.any()
    worst = jnp.max(costs, where=finite, initial=-jnp.inf)
    told = jnp.where(finite, costs, jnp.where(some, worst, 0))

    champion = jnp.argmin(jnp.where(finite, costs, jnp.inf))
    better = finite[champion] & (costs[champion] < search.best_cost)
    best_cost = jnp.where(better, costs[champion], search.best_cost)
    best_position = jnp.where(better, positions[champion], search.best_position)

    seen = History(
        best=best_cost,
        mean=jnp.mean(costs, where=finite),
        worst=jnp.where(some, worst, jnp.nan),
        non_finite=failures,
    )
    return Search(
        state=optimiser.tell(search.state, told),
        best_position=best_position,
        best_cost=best_cost,
        iteration=search.iteration + 1,
        non_finite=search.non_finite + failures,
        history=jax.tree.map(lambda h, s: h.at[search.iteration].set(s), search.history, seen),
    )


_advance = jax.jit(advance, static_argnums=(0, 1))


def minimise(
    objective: Objective,
    box: Box,
    optimiser: Optimiser,
    key: Array,
    *,
    chunk: int | None = None,
    callback: Callable[[Search], object] | None = None,
    search: Search | None = None,
) -> Search:
    """Minimise a batched function over a box.

    The loop is compiled once for each objective (told apart by identity), optimiser and shape of
    the box. An objective that closes over large arrays, or that is built anew for each call, is
    better served by `start` and `advance` inside a compiled function that takes them as arguments.

    Args:
        objective: Maps positions (agents, dimensions) in the box's coordinates to costs (agents,);
            see `advance` for costs that are not finite.
        box: Where to search.
        optimiser: What searches, for how long and with how many agents.
        key: Random key; the same key gives the same search, in whatever chunks.
        chunk: Iterations between two calls of `callback`; by default all of them.
        callback: Called with the search after each chunk, for progress or to save it
            (`posegsa.save_search`).
        search: A search to go on with, such as `posegsa.load_search` gives; by default a new one.
            It goes on as if it had never stopped, to the last bit, and `key` is not used.

    Returns:
        The finished search.

    Raises:
        ArgumentError: If an argument is not what it has to be, or the objective does not return one
            cost per agent.
    """
    check_callable("objective", objective)
    if not isinstance(box, Box):
        refuse(f"box: a {type(box).__name__}", "a Box (posegsa.box makes one)")
    box = _checked_box(*box)
    for name in ("init", "ask", "tell", "agents", "iterations"):
        if not hasattr(optimiser, name) or isinstance(optimiser, type):
            refuse(f"optimiser: a {type(optimiser).__name__}", "GSA(), RandomSearch() or the like")
    check_key(key)
    if callback is not None:
        check_callable("callback", callback)
    end = optimiser.iterations
    chunk = end if chunk is None else chunk
    check_count("minimise: chunk", chunk)
    now = start(optimiser, box, key)
    if search is not None:
        _check_structure(search, now)
        now = search
    for done in range(int(now.iteration), end, chunk):
        with made_of_jax():
            now = _advance(optimiser, objective, box, now, min(done + chunk, end))
        if callback is not None:
            callback(now)
    return now


def lengthened(search: Search, iterations: int) -> Search:
    """A search with room in its history for more iterations than it was started for.

    Args:
        search: From `start`, `advance` or `minimise`.
        iterations: Iterations in all, as the optimiser that goes on with it has them.
    """
    more = iterations - search.history.best.shape[0]
    check_count("lengthened: further iterations", more, least=0)

    def padded(values: Array) -> Array:
        unknown = jnp.nan if jnp.issubdtype(values.dtype, jnp.floating) else 0
        return jnp.concatenate([values, jnp.full(more, unknown, values.dtype)])

    return search._replace(history=jax.tree.map(padded, search.history))


def _check_structure(search: Search, like: Search) -> None:
    """Raise unless a search is one of the optimiser and box that `like` was started with."""
    if jax.tree.structure(search) != jax.tree.structure(like):
        refuse(f"search: a {type(search).__name__}", "a Search of this optimiser")
    leaves, wanted = (jax.tree_util.tree_leaves_with_path(s) for s in (search, like))
    for (place, leaf), (_, want) in zip(leaves, wanted, strict=True):
        if (leaf.shape, leaf.dtype) != (want.shape, want.dtype):
            refuse(
                f"search{jax.tree_util.keystr(place)} is {leaf.dtype} {leaf.shape}",
                f"{want.dtype} {want.shape}, as this optimiser and box have it",
            )


def uniform(key: Array, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Draw from [0, 1) in float32 and cast, so that a key means the same in every dtype."""
    return random.uniform(key, shape, jnp.float32).astype(dtype)
