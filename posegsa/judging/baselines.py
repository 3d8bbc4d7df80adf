"""What a tuned schedule has to beat, and the oracle that shows how far schedules can go."""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from posegsa.config import ObjectiveConfig, override
from posegsa.judging.evaluation import CONSTANT, ORACLE, RANDOM, SMOOTH, Description
from posegsa.judging.result import TuneResult
from posegsa.model.scenario import Scenario
from posegsa.model.schedules import ConstantGain, FuzzyGain, GainSchedule, KnotGain, SmoothGain
from posegsa.optimisers import Box, Optimiser, runner, start
from posegsa.optimisers.gradient import value_and_slopes
from posegsa.search.build import scenario_batch, tuning_problem
from posegsa.search.keys import keys, oracle_keys, training_keys
from posegsa.search.population import ScenarioBatch, agent_costs, costs_by_scenario, over_scenarios
from posegsa.search.run import run_search

CONSTANT_GAINS = 201
"""Constant gains that `tune` tries, evenly spaced over all that a controller can ask for."""
ORACLE_SCENARIOS = 32
"""Scenarios that the oracle is fitted to; none of them is a training or a held-out one."""
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


Described = tuple[GainSchedule, Description]
"""A schedule, and what it is as it is stored."""


def best_constant(
    training: ScenarioBatch, gain_range: tuple[float, float], objective: ObjectiveConfig
) -> ConstantGain:
    """The constant gain of lowest cost, of CONSTANT_GAINS that a controller can ask for.

    With one number to find, and a cost that is flat about its minimum, more of them change nothing.
    """
    low, high = gain_range
    gains = jnp.linspace(1 + low, 1 + high, CONSTANT_GAINS, dtype=training.dtype)
    costs = np.asarray(over_scenarios(costs_by_scenario(ConstantGain(gains), training), objective))
    return ConstantGain(gains[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))])


def smooth_gain(vector: Array) -> SmoothGain:
    """The schedule of a search vector (3,): low and high gain [1/s], log of the half-way error."""
    return SmoothGain(vector[0], vector[1], jnp.exp(vector[2]))


class _SmoothObjective(NamedTuple):
    """What the search for a smooth schedule minimises, for programs that are compiled for it."""

    objective: ObjectiveConfig

    def __call__(self, training: ScenarioBatch) -> Callable[[Array], Array]:
        """As a function of vectors (A, 3), on training scenarios."""
        return lambda vectors: over_scenarios(
            agent_costs(jax.vmap(smooth_gain)(vectors), training), self.objective
        )


def search_smooth(
    optimiser: Optimiser,
    objective: ObjectiveConfig,
    gain_range: tuple[float, float],
    training: ScenarioBatch,
    key: Array,
) -> SmoothGain:
    """The best smooth schedule that a search finds on training scenarios.

    Its gains are those of a controller of this range (output k_op [1/s], the gain less 1); it is
    half-way at a scaled error from 0.003 to 1.
    """
    low, high = (1 + end for end in gain_range)
    bounds = (low, low, math.log(0.003)), (high, high, 0.0)
    box = Box(*(jnp.asarray(ends, training.dtype) for ends in bounds))
    run = runner(optimiser, _SmoothObjective(objective), box, training)
    return smooth_gain(run(start(optimiser, box, key), optimiser.total_iterations).best_position)


@jax.jit
def _descend(
    log_gain: Array, state: optax.OptState, rate: Array, time: Array, batch: ScenarioBatch
) -> tuple[Array, Array, optax.OptState]:
    """Mean cost (s,) of each start's knots (s, n), and the knots after one step of Adam."""

    def cost(knots: Array) -> Array:
        schedule = jax.tree.map(lambda a: a[None], KnotGain(time, knots))
        return jnp.mean(agent_costs(schedule, batch))

    values, gradient = jax.vmap(partial(value_and_slopes, cost))(log_gain)
    gradient = jnp.where(jnp.isfinite(gradient), gradient, 0.0)
    direction, state = optax.scale_by_adam().update(gradient, state)
    low, high = (math.log(end) for end in ORACLE_RANGE)
    return values, jnp.clip(log_gain - rate * jnp.asarray(direction), low, high), state


def oracle_knots(end: float) -> np.ndarray:
    """Times (KNOTS,) of the oracle's knots [s]: dense in the transient, even after it."""
    dense, turn = KNOTS // 3, min(1.0, 0.5 * end)
    early = np.geomspace(0.03 * turn, turn, dense)
    return np.concatenate([[0.0], early, np.linspace(turn, end, KNOTS - dense)[1:]])


def oracle(batch: ScenarioBatch) -> Described:
    """The best open-loop gain sequence found for a batch of scenarios, and how it was found.

    Gradient descent (Adam, forward-mode derivatives) on the logarithm of KNOTS gains from several
    starts, at ever finer rates, each until no start improves any more. It is a strong reference for
    what a schedule can do on the family as a whole, no proven bound: a schedule that looks at the
    error may beat it.
    """
    dtype = batch.dtype
    time = jnp.asarray(oracle_knots(float(batch.samples.time[0, -1])), dtype)
    starts = jnp.log(jnp.asarray(ORACLE_STARTS, dtype))
    best = starts[:, None] * jnp.ones((1, KNOTS), dtype)
    best_cost = np.full(len(ORACLE_STARTS), np.inf)
    steps, converged = 0, True
    for rate in ORACLE_RATES:
        knots, state = best, optax.scale_by_adam().init(best)
        counted, idle = best_cost.copy(), np.zeros(len(ORACLE_STARTS), int)
        for _ in range(ORACLE_STEPS):
            with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
                values, after, state = _descend(knots, state, jnp.asarray(rate, dtype), time, batch)
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
    return KnotGain(time, best[i]), {
        "kind": "open loop",
        "time": np.asarray(time, np.float64).tolist(),
        "gain": np.exp(np.asarray(best[i], np.float64)).tolist(),
        "cost_fitted": float(best_cost[i]),
        "steps": steps,
        "converged": converged,
    }


def baselines(result: TuneResult, one: Scenario) -> dict[str, Callable[[], Described]]:
    """How to find each baseline of a run, by name."""
    experiment, run = result.experiment, result.experiment.run
    training = scenario_batch(experiment, one, training_keys(run.seed, run.training_scenarios))

    def constant() -> Described:
        # The grid's best: with one number to find, a full search ends at the same cost.
        gain = jnp.asarray(result.constant_gain, training.dtype)
        return ConstantGain(gain), {"kind": "constant", "gain": result.constant_gain}

    def random() -> Described:
        # By name, because the library of the run's own optimiser may not be installed here.
        problem = tuning_problem(override(experiment, ["search.optimiser=random_search"]))
        controller = problem.space.controller(run_search(problem).search.best_position)
        k = np.asarray(problem.space.vector(controller)).tolist()
        return FuzzyGain(controller), {"kind": "fuzzy", "k": k}

    def smooth() -> Described:
        optimiser = override(experiment, ["search.optimiser=gsa"]).search
        gains, key = experiment.parameters.gain_range, keys(run.seed).baselines
        schedule = search_smooth(optimiser, experiment.objective, gains, training, key)
        low, high, half = map(float, (schedule.low, schedule.high, schedule.half))
        return schedule, {"kind": "smooth", "low": low, "high": high, "half": half}

    def best_sequence() -> Described:
        return oracle(scenario_batch(experiment, one, oracle_keys(run.seed, ORACLE_SCENARIOS)))

    return {ORACLE: best_sequence, CONSTANT: constant, RANDOM: random, SMOOTH: smooth}
