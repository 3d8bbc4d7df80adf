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
from posegsa.gain import ConstantGain, FuzzyGain, GainSchedule, ScheduleInputs
from posegsa.optimisers import Box, Optimiser, advance, start
from posegsa.parameters import ParameterSpace
from posegsa.population import Problem, agent_costs

KNOTS = 24
"""Knots of the oracle's gain over time."""
ORACLE_STARTS = (10.0, 30.0, 100.0)
"""Constant gains [1/s] that the oracle's descents start from."""
ORACLE_RATE = 0.1
"""Adam's step on the logarithm of a knot's gain."""
ORACLE_PATIENCE = 60
"""Steps without an improvement of 1e-4 after which a descent ends."""
ORACLE_STEPS = 600
"""Steps after which a descent ends in any case."""
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


def constant_gain(vector: Array) -> ConstantGain:
    """The schedule of a search vector (1,), K [1/s]."""
    return ConstantGain(vector[0])


def smooth_gain(vector: Array) -> SmoothGain:
    """The schedule of a search vector (3,): low and high gain [1/s], log of the half-way error."""
    return SmoothGain(vector[0], vector[1], jnp.exp(vector[2]))


def fuzzy_gain(vector: Array, space: ParameterSpace) -> FuzzyGain:
    """The schedule of a search vector k (22,)."""
    return FuzzyGain(space.controller(vector))


def constant_box(gain_range: tuple[float, float], dtype: jnp.dtype) -> Box:
    """Where the constant gain is searched: all that a controller can ask for [1/s]."""
    return Box(*(jnp.asarray([1 + end], dtype) for end in gain_range))


def smooth_box(gain_range: tuple[float, float], dtype: jnp.dtype) -> Box:
    """Where the smooth schedule is searched: the same gains, half-way errors from 0.003 to 1."""
    low, high = (1 + end for end in gain_range)
    lower, upper = (low, low, math.log(0.003)), (high, high, 0.0)
    return Box(jnp.asarray(lower, dtype), jnp.asarray(upper, dtype))


@partial(jax.jit, static_argnums=(0, 1, 2))
def search_schedule(
    optimiser: Optimiser,
    schedule: Callable[..., GainSchedule],
    objective: ObjectiveConfig,
    box: Box,
    training: Problem,
    key: Array,
    *context: Any,
) -> Array:
    """The best vector (d,) of a family of schedules on the training scenarios.

    Args:
        optimiser: What searches, and with how many evaluations.
        schedule: Maps a vector (d,), and the context, to a schedule.
        objective: What of the costs on several scenarios is minimised.
        box: Where to search.
        training: The training scenarios.
        key: Random key of the search.
        context: What `schedule` needs beside the vector.
    """

    def costs(vectors: Array) -> Array:
        schedules = jax.vmap(lambda vector: schedule(vector, *context))(vectors)
        return over_scenarios(agent_costs(schedules, training), objective)

    found = advance(optimiser, costs, box, start(optimiser, box, key), optimiser.iterations)
    return found.best_position


@jax.jit
def _descend(log_gain: Array, state: optax.OptState, time: Array, problem: Problem):
    """Mean cost of each start's knots (s, n), and the knots after one step of Adam."""

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
    updates, state = optax.adam(ORACLE_RATE).update(gradient, state)
    low, high = (math.log(end) for end in ORACLE_RANGE)
    stepped = jnp.asarray(optax.apply_updates(log_gain, updates))
    return values, jnp.clip(stepped, low, high), state


def oracle(problem: Problem) -> tuple[KnotGain, float]:
    """The best open-loop gain sequence found for a problem, and its mean cost there.

    Gradient descent (Adam, forward-mode derivatives) on the logarithm of KNOTS gains, from several
    starts, each until it no longer improves. It is a strong reference for what a schedule can do on
    the family as a whole, no proven bound: a schedule that looks at the error may beat it.

    Args:
        problem: Scenarios to fit; not the held-out ones.
    """
    end = float(problem.tracks.time[0, -1])
    # Denser where the error falls: the first knots are 3 samples apart.
    knots = np.concatenate([[0.0], np.geomspace(min(0.03, 0.1 * end), end, KNOTS - 1)])
    time = jnp.asarray(knots, problem.dtype)
    log_gain = (
        jnp.log(jnp.asarray(ORACLE_STARTS, problem.dtype))[:, None] * jnp.ones_like(time)[None]
    )
    state = optax.adam(ORACLE_RATE).init(log_gain)
    best_cost, best, last_improved = math.inf, log_gain[0], 0
    for step in range(ORACLE_STEPS):
        before = log_gain
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
            values, log_gain, state = _descend(log_gain, state, time, problem)
        costs = np.nan_to_num(np.asarray(values, np.float64), nan=np.inf)
        i = int(np.argmin(costs))
        if costs[i] < best_cost:
            if costs[i] < best_cost * (1 - 1e-4):
                last_improved = step
            best_cost, best = float(costs[i]), before[i]
        if step - last_improved >= ORACLE_PATIENCE:
            break
    return KnotGain(time, best), best_cost
