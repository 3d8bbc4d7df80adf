"""Agents x scenarios -> costs, in one compiled call."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.config import Experiment
from posegsa.cost import CostWeights, cost_weights
from posegsa.filter import FilterSettings, FilterState, filter_settings, initial_state
from posegsa.gain import FuzzyGain, GainSchedule, SignalSettings, signal_settings
from posegsa.parameters import ParameterSpace
from posegsa.rollout import Track, simulate_cost, track
from posegsa.scenario import Scenario, integrate, measure


class Problem(NamedTuple):
    """All that the cost of a schedule depends on, for S scenarios."""

    tracks: Track
    """Leaves (S, N)."""
    initial: FilterState
    """Leaves (S,)."""
    weights: CostWeights
    settings: FilterSettings
    signal: SignalSettings

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the simulation."""
        return self.tracks.time.dtype


@jax.jit
def _simulated(scenario: Scenario, keys: Array) -> tuple[Track, FilterState]:
    truth = integrate(scenario)

    def one(key: Array) -> tuple[Track, FilterState]:
        initial = initial_state(
            scenario.rotation_estimate, scenario.position_estimate, scenario.bias_estimate
        )
        return track(measure(scenario, truth, key), truth.rotation, truth.position), initial

    return jax.vmap(one)(keys)


def problem(experiment: Experiment, scenario: Scenario, keys: Array) -> Problem:
    """The problem of an experiment's scenario with S noise keys (S,)."""
    dtype = jnp.dtype(experiment.run.dtype)
    tracks, initial = _simulated(scenario, keys)
    return Problem(
        tracks,
        initial,
        cost_weights(experiment.cost, scenario.samples, dtype),
        filter_settings(experiment.filter, dtype),
        signal_settings(experiment.gain, dtype),
    )


def agent_costs(schedules: GainSchedule, problem: Problem) -> Array:
    """Cost (S, A) of A schedules on S scenarios (pure, jittable).

    All agents meet the same noise (common random numbers), so that their differences are their
    own. The agents are the innermost batch axis: one time step of all agents on all scenarios is
    one fused kernel.

    Args:
        schedules: One kind of schedule whose leaves have a leading axis of agents.
        problem: Scenarios and settings.
    """

    def on_scenario(tracks: Track, initial: FilterState) -> Array:
        def agent(schedule: GainSchedule) -> Array:
            return simulate_cost(
                schedule, tracks, initial, problem.weights, problem.settings, problem.signal
            ).total

        return jax.vmap(agent)(schedules)

    return jax.vmap(on_scenario)(problem.tracks, problem.initial)


def population_costs(vectors: Array, problem: Problem, space: ParameterSpace) -> Array:
    """Cost (A,) of A parameter vectors (A, 22): the mean over the scenarios (pure, jittable).

    An agent that diverges costs infinity or NaN, one that is out of order where that is not
    repaired infinity; the search sees to it that neither is ever best.
    """
    schedules = FuzzyGain(jax.vmap(space.controller)(vectors))
    costs = jnp.mean(agent_costs(schedules, problem), axis=0)
    return jnp.where(jax.vmap(space.valid)(vectors), costs, jnp.inf)


costs_by_scenario = jax.jit(agent_costs)
evaluate_population = jax.jit(population_costs)
