"""What a tuned schedule has to beat, and the oracle that shows how far schedules can go."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from posegsa.config import ObjectiveConfig
from posegsa.cost import over_scenarios
from posegsa.gain import GainSchedule, ScheduleInputs
from posegsa.optimisers import Box, Optimiser, advance, start
from posegsa.population import Problem, agent_costs

KNOTS = 24
"""Knots of the oracle's gain over time."""
ORACLE_STARTS = (10.0, 30.0, 100.0)
"""Constant gains [1/s] that the oracle's descents start from."""
ORACLE_RATES = (0.1, 0.03, 0.01)
"""Adam's steps on the logarithm of a gain: coarse, then finer from the best of each start."""
ORACLE_PATIENCE = 20
"""Steps without an improvement of ORACLE_IMPROVEMENT after which a start is done at one rate."""
ORACLE_IMPROVEMENT = 1e-4
"""Relative improvement of the cost that counts."""
ORACLE_STEPS = 400
"""Most steps at one rate; a descent that needs more says so."""
ORACLE_RANGE = (0.5, 200.0)
"""Gains that the oracle may ask for [1/s]; wider than a controller's range."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SmoothGain:
    """K(e) = low + (high - low) e^2 / (e^2 + half^2), a smooth schedule with three parameters."""

    low: Array
    """K where the error is small [1/s]."""
    high: Array
    """K where it is large [1/s]."""
    half: Array
    """Scaled error half-way between them."""

    def initial_gain(self) -> Array:
        """K where the error is large."""
        return self.high

    def prepare(self) -> "SmoothGain":
        """Nothing to compute."""
        return self

    def __call__(self, inputs: ScheduleInputs) -> Array:
        """K of the scaled error."""
        e2 = inputs.error * inputs.error
        return self.low + (self.high - self.low) * e2 / (e2 + self.half * self.half)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KnotGain:
    """K(t): an open-loop gain sequence, piecewise exponential between knots."""

    time: Array
    """(n,) times of the knots [s], ascending."""
    log_gain: Array
    """(n,) log of K there."""

    def initial_gain(self) -> Array:
        """K at the first knot [1/s]."""
        return jnp.exp(self.log_gain[0])

    def prepare(self) -> "KnotGain":
        """Nothing to compute."""
        return self

    def __call__(self, inputs: ScheduleInputs) -> Array:
        """K at the time of the sample."""
        log_gain = jnp.interp(inputs.time, self.time, self.log_gain)
        return jnp.broadcast_to(jnp.exp(log_gain), jnp.shape(inputs.error))


def smooth_gain(vector: Array) -> SmoothGain:
    """The schedule of a search vector (3,): low and high gain [1/s], log of the half-way error."""
    return SmoothGain(vector[0], vector[1], jnp.exp(vector[2]))


def smooth_box(gain_range: tuple[float, float], dtype: jnp.dtype) -> Box:
    """Where the smooth schedule is searched: the same gains, half-way errors from 0.003 to 1."""
    low, high = (1 + end for end in gain_range)
    lower, upper = (low, low, math.log(0.003)), (high, high, 0.0)
    return Box(jnp.asarray(lower, dtype), jnp.asarray(upper, dtype))


@partial(jax.jit, static_argnums=(0, 1, 2))
def search_schedule(
    optimiser: Optimiser,
    schedule: Callable[[Array], GainSchedule],
    objective: ObjectiveConfig,
    box: Box,
    training: Problem,
    key: Array,
) -> Array:
    """The best vector (d,) of a family of schedules on the training scenarios.

    Args:
        optimiser: What searches, and with how many evaluations.
        schedule: Maps a vector (d,) to a schedule.
        objective: What of the costs on several scenarios is minimised.
        box: Where to search.
        training: The training scenarios.
        key: Random key of the search.
    """

    def costs(vectors: Array) -> Array:
        return over_scenarios(agent_costs(jax.vmap(schedule)(vectors), training), objective)

    found = advance(optimiser, costs, box, start(optimiser, box, key), optimiser.iterations)
    return found.best_position


@jax.jit
def _descend(
    log_gain: Array, state: optax.OptState, rate: Array, time: Array, problem: Problem
) -> tuple[Array, Array, optax.OptState]:
    """Mean cost (s,) of each start's knots (s, n), and the knots after one step of Adam."""

    def cost(knots: Array) -> Array:
        schedule = jax.tree.map(lambda a: a[None], KnotGain(time, knots))
        return jnp.mean(agent_costs(schedule, problem))

    def cost_and_gradient(knots: Array) -> tuple[Array, Array]:
        # Forward mode: few inputs, 1500 steps, and nothing to store.
        basis = jnp.eye(knots.shape[0], dtype=knots.dtype)
        values, slopes = jax.vmap(lambda d: jax.jvp(cost, (knots,), (d,)))(basis)
        return values[0], slopes

    values, gradient = jax.vmap(cost_and_gradient)(log_gain)
    gradient = jnp.where(jnp.isfinite(gradient), gradient, 0.0)
    direction, state = optax.scale_by_adam().update(gradient, state)
    low, high = (math.log(end) for end in ORACLE_RANGE)
    return values, jnp.clip(log_gain - rate * jnp.asarray(direction), low, high), state


def oracle_knots(end: float) -> np.ndarray:
    """Times (KNOTS,) of the oracle's knots [s]: dense in the transient, even after it."""
    dense, turn = KNOTS // 3, min(1.0, 0.5 * end)
    early = np.geomspace(0.03 * turn, turn, dense)
    return np.concatenate([[0.0], early, np.linspace(turn, end, KNOTS - dense)[1:]])


def oracle(problem: Problem) -> tuple[KnotGain, dict[str, Any]]:
    """The best open-loop gain sequence found for a problem, and how it was found.

    Gradient descent (Adam, forward-mode derivatives) on the logarithm of KNOTS gains from several
    starts, at ever finer rates, each until no start improves any more. It is a strong reference for
    what a schedule can do on the family as a whole, no proven bound: a schedule that looks at the
    error may beat it.

    Args:
        problem: Scenarios to fit; not the held-out ones.

    Returns:
        The sequence, and its mean cost on the problem, the steps taken and whether every descent
        ended because it no longer improved.
    """
    dtype = problem.dtype
    time = jnp.asarray(oracle_knots(float(problem.tracks.time[0, -1])), dtype)
    starts = jnp.log(jnp.asarray(ORACLE_STARTS, dtype))
    best = starts[:, None] * jnp.ones((1, KNOTS), dtype)
    best_cost = np.full(len(ORACLE_STARTS), np.inf)
    steps, converged = 0, True
    for rate in ORACLE_RATES:
        knots, state = best, optax.scale_by_adam().init(best)
        counted, idle = best_cost.copy(), np.zeros(len(ORACLE_STARTS), int)
        for _ in range(ORACLE_STEPS):
            with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
                values, after, state = _descend(
                    knots, state, jnp.asarray(rate, dtype), time, problem
                )
            costs = np.nan_to_num(np.asarray(values, np.float64), nan=np.inf)
            better = costs < best_cost
            best = jnp.where(jnp.asarray(better)[:, None], knots, best)
            best_cost = np.where(better, costs, best_cost)
            enough = best_cost < counted * (1 - ORACLE_IMPROVEMENT)
            counted, idle = np.where(enough, best_cost, counted), np.where(enough, 0, idle + 1)
            knots, steps = after, steps + 1
            if (idle >= ORACLE_PATIENCE).all():
                break
        else:
            converged = False
    i = int(np.argmin(best_cost))
    found = {"cost_fitted": float(best_cost[i]), "steps": steps, "converged": converged}
    return KnotGain(time, best[i]), found
