"""What a schedule costs on noise that it was not tuned on, beside the best constant gain."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, random

from posegsa.config import Experiment
from posegsa.gain import ConstantGain, GainSchedule
from posegsa.population import costs_by_scenario, problem
from posegsa.rollout import simulate
from posegsa.scenario import Scenario, Truth, integrate
from posegsa.trajectory import Trajectory, trajectory

CONSTANT_GAINS = 201
"""Number of constant gains tried, evenly spaced over all that a controller can ask for."""


class Keys(NamedTuple):
    """The random keys of an experiment, named by use; all are drawn from its seed and unrelated."""

    search: Array
    training: Array
    held_out: Array


def keys(seed: int) -> Keys:
    """The keys of a seed."""
    return Keys(*random.split(random.key(seed), 3))


def scenario_keys(key: Array, count: int) -> Array:
    """`count` noise keys; the first ones do not depend on how many there are."""
    return jax.vmap(lambda i: random.fold_in(key, i))(jnp.arange(count))


class Score(NamedTuple):
    """Costs of a schedule on the scenarios it was chosen on and on those it was not."""

    training: np.ndarray
    """(S,) costs on the training scenarios; infinite where the filter diverged."""
    held_out: np.ndarray
    """(H,) costs on the held-out scenarios, likewise."""


class Judged(NamedTuple):
    """A tuned schedule beside the baseline."""

    tuned: Score
    constant_gain: float
    """The constant gain with the least mean cost on the training scenarios [1/s]."""
    constant: Score


def judge(schedule: GainSchedule, one: Scenario, experiment: Experiment) -> Judged:
    """Score a schedule and the best constant gain on training and held-out scenarios.

    Args:
        schedule: The tuned schedule.
        one: The scenario, of which the noise keys make many.
        experiment: What it was tuned on; its held-out scenarios have keys of their own.
    """
    run, use = experiment.run, keys(experiment.run.seed)
    every_key = jnp.concatenate(
        [
            scenario_keys(use.training, run.training_scenarios),
            scenario_keys(use.held_out, run.held_out_scenarios),
        ]
    )
    # All scenarios at once, so that each kind of schedule is compiled once.
    everywhere = problem(experiment, one, every_key)
    low, high = experiment.parameters.gain_range
    gains = jnp.linspace(1 + low, 1 + high, CONSTANT_GAINS, dtype=everywhere.dtype)
    constants = _finite_or_infinite(costs_by_scenario(ConstantGain(gains), everywhere))
    tuned = _finite_or_infinite(
        costs_by_scenario(jax.tree.map(lambda a: a[None], schedule), everywhere)
    )
    best = int(np.argmin(np.mean(constants[: run.training_scenarios], axis=0)))

    def score(costs: np.ndarray) -> Score:
        return Score(costs[: run.training_scenarios], costs[run.training_scenarios :])

    return Judged(score(tuned[:, 0]), float(gains[best]), score(constants[:, best]))


def _finite_or_infinite(costs: Array) -> np.ndarray:
    """Costs as float64, infinite where the filter diverged."""
    values = np.asarray(costs, np.float64)
    return np.where(np.isfinite(values), values, np.inf)


def run_scenario(
    schedule: GainSchedule, one: Scenario, experiment: Experiment, key: Array
) -> Trajectory:
    """Truth, estimates, errors and gain over time of one simulation.

    Args:
        schedule: The gain schedule.
        one: The scenario.
        experiment: Where the filter's and the signal's settings come from.
        key: Noise key.
    """
    truth: Truth = integrate(one)
    posed = problem(experiment, one, key[None])
    tracks, initial = jax.tree.map(lambda a: a[0], (posed.tracks, posed.initial))
    estimates = simulate(schedule, tracks, initial, posed.settings, posed.signal)
    return trajectory(truth, estimates)
