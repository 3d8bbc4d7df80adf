"""The one loop that runs every optimiser, its record, and when it stops.

An optimiser sees the unit box and finite numbers only. This module maps its positions into the
user's box, deals with costs and gradients that are not finite (`tell`, nowhere else), and keeps the
record of the search.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from posegsa.optimisers.base import (
    Box,
    FailureCost,
    GradientOptimiser,
    Objective,
    Optimiser,
    from_unit,
)
from posegsa.optimisers.checks import check_count, refuse, refuse_unreal
from posegsa.optimisers.gradient import Differentiable, reverse_mode
from posegsa.optimisers.polish import Polish

AnyOptimiser = Optimiser | GradientOptimiser | Polish
"""What the loop can run."""
AnyObjective = Objective | Differentiable
"""What it can run it on; a plain function is differentiated by reverse mode where need be."""


class History(NamedTuple):
    """What each iteration saw; NaN (0 for the count) from `Search.iteration` on."""

    best: Array  # (iterations,) best cost so far; inf before any finite one
    mean: Array  # (iterations,) mean of the iteration's finite costs; NaN if there were none
    worst: Array  # (iterations,) largest of the iteration's finite costs; NaN if there were none
    non_finite: Array  # (iterations,) int32, number of its evaluations that were not finite


class Search(NamedTuple):
    """The whole state of a search: all that `advance` needs to go on, and all it found."""

    state: Any  # the optimiser's own state
    best_position: Array  # (dimensions,) in the box's coordinates; its centre until a finite cost
    best_cost: Array  # () inf until a finite cost
    iteration: Array  # () int32, iterations done
    non_finite: Array  # () int32, evaluations so far whose cost or gradient was not finite
    history: History


class Until(NamedTuple):
    """When a search has nothing more to do."""

    target: ArrayLike = -np.inf  # a best cost that is good enough
    patience: ArrayLike = np.iinfo(np.int32).max  # iterations in which the best cost has to fall
    tolerance: ArrayLike = 0.0  # by more than this share of itself


def start(optimiser: AnyOptimiser, box: Box, key: Array) -> Search:
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
    optimiser: AnyOptimiser,
    objective: AnyObjective,
    box: Box,
    search: Search,
    stop: ArrayLike,
    until: Until | None = None,
) -> Search:
    """Run a search on, from the iteration it has reached to `stop`.

    It is pure, and made for the caller's own jit: `objective` may close over traced arrays. `stop`
    may be traced too, so that one compilation serves chunks of every size, and a search gives the
    same bits in whatever chunks it is run. On several devices, run it inside `jax.shard_map` and
    let the objective split the agents and gather their costs: the search itself is then the same
    on every device, to the last bit.

    Args:
        optimiser: What searches; the one that `search` was started with.
        objective: Maps positions (agents, dimensions) in the box's coordinates to costs (agents,);
            for a gradient optimiser a `Differentiable`, or a function that reverse mode can
            differentiate. A cost that is not finite marks a position that could not be judged: it
            is counted, never becomes the best, and is told to the optimiser as a finite one that
            is no better than any real cost, as the optimiser says (`base.FailureCost`). A gradient
            that is not finite is counted too, and told as 0.
        box: Where to search.
        search: The search so far, from `start` or `advance`.
        stop: Number of iterations, counted from the start of the search, after which to stop; the
            search ends at `optimiser.iterations` in any case.
        until: When to stop before that; by default never.

    Returns:
        The search with `stop` iterations done, or fewer if it had nothing more to do.

    Raises:
        ArgumentError: If the objective does not return one cost per agent.
    """
    stop = jnp.minimum(stop, optimiser.iterations)
    if not isinstance(optimiser, Polish):
        return _loop(optimiser, objective, box, search, stop, until)
    turn, both = optimiser.first.iterations, search.state
    search = _loop(
        optimiser.first,
        objective,
        box,
        search._replace(state=both.first),
        jnp.minimum(stop, turn),
        until,
    )
    both = both._replace(first=search.state)
    both = lax.cond(
        (search.iteration == turn) & (jnp.asarray(stop) > turn),  # once, in whatever chunks
        lambda both: optimiser.hand_over(both, _to_unit(box, search.best_position)),
        lambda both: both,
        both,
    )
    search = search._replace(state=both.second)
    search = _loop(optimiser.second, objective, box, search, stop, until, begin=turn)
    return search._replace(state=both._replace(second=search.state))


def _to_unit(box: Box, position: Array) -> Array:
    """Map a position in the box back into the unit box; 0 where the box has no width."""
    width = box.upper - box.lower
    return (position - box.lower) / jnp.where(width > 0, width, 1)


def _loop(
    optimiser: Optimiser | GradientOptimiser,
    objective: AnyObjective,
    box: Box,
    search: Search,
    stop: ArrayLike,
    until: Until | None,
    begin: int = 0,
) -> Search:
    """Iterate while there is something to do, from iteration `begin` on."""

    def going(search: Search) -> Array:
        more = (search.iteration >= begin) & (search.iteration < stop)
        return more if until is None else more & ~is_satisfied(search, until)

    return lax.while_loop(
        going,
        lambda search: _tell(
            optimiser,
            box,
            search,
            *_evaluate(optimiser, objective, ask(optimiser, box, search)),
        ),
        search,
    )


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


def is_satisfied(search: Search, until: Until) -> Array:
    """Whether the best cost is good enough, or has stopped falling."""
    best, done = search.best_cost, search.iteration
    patience = jnp.asarray(until.patience, jnp.int32)
    tolerance = jnp.asarray(until.tolerance, best.dtype)
    before = search.history.best[jnp.maximum(done - 1 - patience, 0)]
    falls = best < before - tolerance * jnp.abs(jnp.where(jnp.isfinite(before), before, 0))
    return (best <= jnp.asarray(until.target, best.dtype)) | ((done > patience) & ~falls)


def _evaluate(
    optimiser: Optimiser | GradientOptimiser, objective: AnyObjective, positions: Array
) -> tuple[Array, Array | None]:
    """Costs (agents,) of positions, and gradients (agents, dimensions) if they are wanted."""
    if not _wants_gradients(optimiser):
        costs = objective.costs if isinstance(objective, Differentiable) else objective
        found = costs(positions)
        refuse_unreal("objective", found)
        return jnp.asarray(found), None
    whole = objective if isinstance(objective, Differentiable) else reverse_mode(objective)
    return whole.costs_and_gradients(positions)


def _wants_gradients(optimiser: object) -> bool:
    return hasattr(optimiser, "gradient_price")


def evaluations_spent(optimiser: AnyOptimiser) -> np.ndarray:
    """Return how many evaluations a search has made after each iteration, (iterations,).

    A cost with its gradient counts as many as the optimiser's `gradient_price`.
    """
    if isinstance(optimiser, Polish):
        first, second = map(evaluations_spent, (optimiser.first, optimiser.second))
        return np.concatenate([first, first[-1] + second])
    price = getattr(optimiser, "gradient_price", 1)
    return price * optimiser.agents * np.arange(1, optimiser.iterations + 1)


def ask(optimiser: Optimiser | GradientOptimiser, box: Box, search: Search) -> Array:
    """Return the positions (agents, dimensions), in the box, that are to be evaluated next.

    With `tell` this is the loop taken apart, for objectives that are no JAX functions.
    """
    return from_unit(box, optimiser.ask(search.state))


def tell(
    optimiser: Optimiser | GradientOptimiser,
    box: Box,
    search: Search,
    costs: ArrayLike,
    gradients: ArrayLike | None = None,
) -> Search:
    """Return the search after learning the costs (agents,) of the positions asked for.

    Args:
        optimiser: What searches.
        box: Where.
        search: The search whose positions were evaluated.
        costs: What they cost; see `advance` for costs that are not finite.
        gradients: Their gradients (agents, dimensions) in the box's coordinates, for a gradient
            optimiser only.

    Raises:
        ArgumentError: If there is not one cost, and where needed one gradient, per agent.
    """
    dtype = box.lower.dtype
    slopes = None if gradients is None else jnp.asarray(gradients).astype(dtype)
    return _tell(optimiser, box, search, jnp.asarray(costs), slopes)


def _tell(
    optimiser: Any, box: Box, search: Search, costs: Array, gradients: Array | None
) -> Search:
    """Record costs and gradients, made finite, and tell the optimiser of them."""
    dtype = box.lower.dtype
    costs = costs.astype(dtype)
    agents, dimensions = optimiser.agents, box.lower.shape[0]
    if costs.shape != (agents,):
        refuse(f"objective: costs of shape {costs.shape}", f"({agents},), one per agent")

    finite = jnp.isfinite(costs)
    some = finite.any()
    worst = jnp.max(costs, where=finite, initial=-jnp.inf)
    told: list[Array] = [jnp.where(finite, costs, _failure_cost(optimiser, search, costs))]
    judged = finite
    if _wants_gradients(optimiser):
        shape = None if gradients is None else gradients.shape
        if gradients is None or shape != (agents, dimensions):
            refuse(f"objective: gradients of shape {shape}", f"({agents}, {dimensions})")
        in_unit = gradients.astype(dtype) * (box.upper - box.lower)[None, :]
        judged = finite & jnp.isfinite(in_unit).all(axis=1)
        told.append(jnp.where(judged[:, None], in_unit, 0))
    failures = jnp.sum(~judged, dtype=jnp.int32)

    champion = jnp.argmin(jnp.where(finite, costs, jnp.inf))
    better = finite[champion] & (costs[champion] < search.best_cost)
    best_cost = jnp.where(better, costs[champion], search.best_cost)
    positions = ask(optimiser, box, search)
    best_position = jnp.where(better, positions[champion], search.best_position)

    seen = History(
        best=best_cost,
        mean=jnp.mean(costs, where=finite),
        worst=jnp.where(some, worst, jnp.nan),
        non_finite=failures,
    )
    return Search(
        state=optimiser.tell(search.state, *told),
        best_position=best_position,
        best_cost=best_cost,
        iteration=search.iteration + 1,
        non_finite=search.non_finite + failures,
        history=jax.tree.map(lambda h, s: h.at[search.iteration].set(s), search.history, seen),
    )


def _failure_cost(optimiser: Any, search: Search, costs: Array) -> Array:
    """The finite cost () told of positions whose cost is not, among these costs (agents,)."""
    limits = jnp.finfo(costs.dtype)
    largest, tiny = float(limits.max), float(limits.tiny)
    kind: FailureCost = getattr(optimiser, "failure_cost", "worst so far")
    if kind == "largest":
        return jnp.asarray(largest, costs.dtype)

    finite = jnp.isfinite(costs)
    worst = jnp.max(costs, where=finite, initial=-jnp.inf)
    if kind == "worst so far":
        known = search.history.worst
        before = jnp.max(known, where=jnp.isfinite(known), initial=-jnp.inf)
        worst = jnp.maximum(worst, before)
    some = jnp.isfinite(worst)
    worst = jnp.where(some, worst, 0)
    # Above it by what rounding can't take away, nor a division by 16 (`gsa.masses`).
    step = jnp.maximum(2 * float(limits.eps) * jnp.abs(worst), 64 * tiny)
    above = jnp.minimum(worst + step, largest)
    if kind == "worst now":
        # Where real costs differ, the worst of them weighs nothing already.
        best = jnp.min(costs, where=finite, initial=jnp.inf)
        above = jnp.where(best < worst, worst, above)
    # Before any finite cost: one that real costs stay below, and whose square can be added up.
    return jnp.where(some, above, largest**0.4)
