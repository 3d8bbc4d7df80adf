"""The loop that runs every optimiser, its history, and its stopping conditions.

Optimisers only get the unit box and finite numbers. This module maps their positions into the
user's box, replaces costs and gradients that are not finite, and keeps the history of the search.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from posegsa.arguments import check_whole, refuse
from posegsa.optimisers.ask_tell import FailureCost, Objective, Optimiser
from posegsa.optimisers.gradient import Differentiable, reverse_mode
from posegsa.optimisers.search_box import Box, from_unit, to_unit
from posegsa.settings.arrays import Columns

AnyObjective = Objective | Differentiable | Callable[[np.ndarray], Any]
"""The function to minimise: a JAX function, differentiated by reverse mode if gradients are wanted;
one with its own gradients; or an ordinary Python function, which runs on the host."""


class History(NamedTuple):
    """The costs of each iteration; NaN (0 for the count) from `Search.iteration` on."""

    best: Annotated[Array, Columns("best", rows="iterations", allow="infinite")]
    """(iterations,) best cost so far; inf before the first finite cost."""
    mean: Annotated[Array, Columns("mean", rows="iterations", allow="any")]
    """(iterations,) mean of the iteration's finite costs; NaN if there were none."""
    worst: Annotated[Array, Columns("worst", rows="iterations", allow="any")]
    """(iterations,) largest of the iteration's finite costs; NaN if there were none."""
    non_finite: Annotated[Array, Columns("non_finite", rows="iterations", dtype=int)]
    """(iterations,) int32, number of the iteration's evaluations that were not finite."""


class Search(NamedTuple):
    """The whole state of a search: everything that `advance` needs, and all results."""

    state: Any  # the optimiser's state, or a tuple of the states of its phases
    best_position: Array  # (dimensions,) in the box's coordinates; its centre until a finite cost
    best_cost: Array  # () inf until a finite cost
    iteration: Array  # () int32, iterations done
    non_finite: Array  # () int32, evaluations so far whose cost or gradient was not finite
    history: History


class Until(NamedTuple):
    """Conditions to stop a search early."""

    target: ArrayLike = -np.inf  # a best cost that is good enough
    patience: ArrayLike = np.iinfo(np.int32).max  # iterations within which the best cost must fall
    tolerance: ArrayLike = 0.0  # by more than this share of its value


def start(optimiser: Optimiser, box: Box, key: Array) -> Search:
    """Return a search before its first evaluation.

    Its best position is the box's centre, with cost inf: safe to use, but not evaluated.

    Raises:
        ConfigError: The optimiser can't run here, as a library that it needs is missing.
    """
    for phase in optimiser.phases:
        phase.check_usable()
    return _started(optimiser, box, key)


@partial(jax.jit, static_argnums=0)
def _started(optimiser: Optimiser, box: Box, key: Array) -> Search:
    dimensions, dtype = box.lower.shape[0], box.lower.dtype
    iterations = optimiser.total_iterations
    states = [
        phase.init(jax.random.fold_in(key, i) if i else key, dimensions, dtype)
        for i, phase in enumerate(optimiser.phases)
    ]
    unknown = jnp.full(iterations, jnp.nan, dtype)
    return Search(
        state=_joined(states),
        best_position=from_unit(box, jnp.full(dimensions, 0.5, dtype)),
        best_cost=jnp.asarray(jnp.inf, dtype),
        iteration=jnp.asarray(0, jnp.int32),
        non_finite=jnp.asarray(0, jnp.int32),
        history=History(
            best=unknown,
            mean=unknown,
            worst=unknown,
            non_finite=jnp.zeros(iterations, jnp.int32),
        ),
    )


def _joined(states: list[Any]) -> Any:
    """The state of a search from those of its phases; with one phase, its state."""
    return states[0] if len(states) == 1 else tuple(states)


def advance(
    optimiser: Optimiser,
    objective: AnyObjective,
    box: Box,
    search: Search,
    stop: ArrayLike,
    until: Until | None = None,
    *,
    python_objective: bool = False,
) -> Search:
    """Run a search from the iteration that it has reached to iteration `stop`.

    The function is pure and made for the caller's own jit: `objective` may close over traced
    arrays. `stop` may be traced too, so that one compilation serves chunks of every size. A search
    gives the same bits for any chunks. On several devices, run it inside `jax.shard_map` and let
    the objective split the agents and gather their costs: the search is then the same on every
    device, to the last bit.

    Args:
        optimiser: The optimiser that `search` was started with.
        objective: Maps positions (agents, dimensions) in the box's coordinates to costs (agents,);
            if gradients are wanted, a `Differentiable` or a function that reverse mode can
            differentiate. A position whose cost is not finite is counted and never becomes the
            best; the optimiser gets a finite cost for it that is no better than any real cost
            (`Optimiser.failure_cost`). A gradient that is not finite is counted too; the optimiser
            gets 0.
        box: The box to search.
        search: The search so far.
        stop: Number of iterations, counted from the start of the search, after which to stop; at
            most those of the optimiser are run.
        until: Conditions to stop earlier; by default none.
        python_objective: The objective is an ordinary Python function of a NumPy array, called once
            for each iteration. If gradients are wanted, it returns costs and gradients.

    Returns:
        The search with `stop` iterations done, or fewer if it stopped early.

    Raises:
        ArgumentError: The objective does not return one cost per agent.
    """
    repeat = _while if python_objective else lax.while_loop
    phases, begin = optimiser.phases, 0
    states = [search.state] if len(phases) == 1 else list(search.state)
    for i, phase in enumerate(phases):
        if i > 0:
            begins = (search.iteration == begin) & (jnp.asarray(stop) > begin)  # in one chunk
            states[i] = _entered(phase, begins, states[i], box, search.best_position)
        end = begin + phase.iterations
        search = repeat(
            partial(_goes_on, begin, jnp.minimum(stop, end), until),
            partial(_step, phase, objective, box, python_objective),
            search._replace(state=states[i]),
        )
        states[i], begin = search.state, end
    return search._replace(state=_joined(states))


@partial(jax.jit, static_argnums=0, inline=True)  # one program if the loop runs in Python
def _entered(phase: Optimiser, begins: Array, state: Any, box: Box, position: Array) -> Any:
    """The state of a phase, moved to a position in the box if the phase starts now."""
    return lax.cond(begins, phase.begin_at, lambda state, _: state, state, to_unit(box, position))


def _while(going: Callable[[Search], Array], step: Callable[[Search], Search], search: Search):
    """`lax.while_loop`, in Python."""
    while going(search):
        search = step(search)
    return search


@partial(jax.jit, static_argnums=0, inline=True)  # one program if the loop runs in Python
def _goes_on(begin: int, end: Array, until: Until | None, search: Search) -> Array:
    """Whether a phase from iteration `begin` to `end` has more iterations to run."""
    best, done = search.best_cost, search.iteration
    more = (done >= begin) & (done < end)
    if until is None:
        return more
    patience = jnp.asarray(until.patience, jnp.int32)
    tolerance = jnp.asarray(until.tolerance, best.dtype)
    before = search.history.best[jnp.maximum(done - 1 - patience, 0)]
    falls = best < before - tolerance * jnp.abs(jnp.where(jnp.isfinite(before), before, 0))
    reached = best <= jnp.asarray(until.target, best.dtype)
    return more & ~reached & (falls | (done <= patience))


def _step(
    phase: Optimiser, objective: Any, box: Box, python_objective: bool, search: Search
) -> Search:
    """One iteration; if the loop runs in Python, ask and tell are compiled on their own."""
    positions = (_compiled_ask if python_objective else ask)(phase, box, search)
    if python_objective:
        found = objective(np.asarray(positions))
    else:
        given = objective if isinstance(objective, Differentiable) else reverse_mode(objective)
        found = (given.costs_and_gradients if phase.wants_gradients else given.costs)(positions)
    costs, *gradients = found if isinstance(found, tuple) else (found,)
    seen = _numbers(phase, box, costs, *gradients)
    return (_compiled_tell if python_objective else tell)(phase, box, search, *seen)


def _numbers(optimiser: Optimiser, box: Box, costs: Any, gradients: Any = None) -> list[Array]:
    """Costs (agents,), and gradients (agents, dimensions) if wanted, in the box's dtype."""

    def checked(name: str, values: Any, *shape: int) -> Array:
        try:
            array = jnp.asarray(values)
        except (TypeError, ValueError):
            refuse(f"objective: {name} are a {type(values).__name__}", f"numbers {shape}")
        if array.shape != shape or jnp.iscomplexobj(array):
            given = f"{array.dtype} of shape {array.shape}"
            refuse(f"objective: {name} are {given}", f"real numbers {shape}")
        return array.astype(box.lower.dtype)

    found = [checked("costs", costs, optimiser.agents)]
    if optimiser.wants_gradients:
        found.append(checked("gradients", gradients, optimiser.agents, len(box.lower)))
    return found


def lengthened(search: Search, iterations: int) -> Search:
    """A search with a history that has room for more iterations, `iterations` in all.

    An optimiser with that many iterations can continue it.
    """
    more = iterations - search.history.best.shape[0]
    check_whole("lengthened: further iterations", more, 0)

    def padded(values: Array) -> Array:
        unknown = jnp.nan if jnp.issubdtype(values.dtype, jnp.floating) else 0
        return jnp.concatenate([values, jnp.full(more, unknown, values.dtype)])

    return search._replace(history=jax.tree.map(padded, search.history))


def ask(optimiser: Optimiser, box: Box, search: Search) -> Array:
    """Return the positions (agents, dimensions), in the box, to evaluate next.

    With `tell` you can write the loop yourself, for objectives that are not JAX functions. With an
    optimiser of several phases, do this for each of its `phases`.
    """
    if len(optimiser.phases) > 1:
        refuse(f"optimiser: {optimiser.optimiser}, of several phases", "one of its `phases`")
    return from_unit(box, optimiser.ask(search.state))


def tell(
    optimiser: Optimiser,
    box: Box,
    search: Search,
    costs: ArrayLike,
    gradients: ArrayLike | None = None,
) -> Search:
    """Return the search updated with the costs (agents,) of the positions of `ask`.

    Args:
        optimiser: The optimiser.
        box: The box to search.
        search: The search whose positions were evaluated.
        costs: The costs of the positions; see `advance` for costs that are not finite.
        gradients: Their gradients (agents, dimensions) in the box's coordinates, if the optimiser
            wants them.

    Raises:
        ArgumentError: There is not one cost, and one gradient if wanted, per agent.
    """
    costs, *slopes = _numbers(optimiser, box, costs, gradients)
    finite = jnp.isfinite(costs)
    worst = jnp.max(costs, where=finite, initial=-jnp.inf)
    told = [jnp.where(finite, costs, _failure_cost(optimiser.failure_cost, search, costs))]
    judged = finite
    for gradient in slopes:
        in_unit = gradient * (box.upper - box.lower)[None, :]
        judged = finite & jnp.isfinite(in_unit).all(axis=1)
        told.append(jnp.where(judged[:, None], in_unit, 0))
    failures = jnp.sum(~judged, dtype=jnp.int32)

    champion = jnp.argmin(jnp.where(finite, costs, jnp.inf))
    better = finite[champion] & (costs[champion] < search.best_cost)
    best_cost = jnp.where(better, costs[champion], search.best_cost)
    champion_position = ask(optimiser, box, search)[champion]

    seen = History(
        best=best_cost,
        mean=jnp.mean(costs, where=finite),
        worst=jnp.where(finite.any(), worst, jnp.nan),
        non_finite=failures,
    )
    return Search(
        state=optimiser.tell(search.state, *told),
        best_position=jnp.where(better, champion_position, search.best_position),
        best_cost=best_cost,
        iteration=search.iteration + 1,
        non_finite=search.non_finite + failures,
        history=jax.tree.map(lambda h, s: h.at[search.iteration].set(s), search.history, seen),
    )


_compiled_ask = jax.jit(ask, static_argnums=(0,))
_compiled_tell = jax.jit(tell, static_argnums=(0,))


def _failure_cost(kind: FailureCost, search: Search, costs: Array) -> Array:
    """The finite cost () that replaces those of costs (agents,) that are not finite."""
    limits = jnp.finfo(costs.dtype)
    largest, tiny = float(limits.max), float(limits.tiny)
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
    # A step large enough to survive rounding and the division by 16 in `gsa.masses`.
    step = jnp.maximum(2 * float(limits.eps) * jnp.abs(worst), 64 * tiny)
    above = jnp.minimum(worst + step, largest)
    if kind == "worst now":
        # If the real costs differ, the worst of them has mass 0 already.
        best = jnp.min(costs, where=finite, initial=jnp.inf)
        above = jnp.where(best < worst, worst, above)
    # Before any finite cost: above all real costs, but small enough that sums of its square are
    # finite.
    return jnp.where(some, above, largest**0.4)
