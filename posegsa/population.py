"""Agents x scenarios -> costs, in one compiled call."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.config import Experiment, ObjectiveConfig
from posegsa.cost import CostWeights, cost_weights, over_scenarios
from posegsa.family import Family, family, realise
from posegsa.filter import FilterSettings, FilterState, filter_settings, initial_state
from posegsa.gain import FuzzyGain, GainSchedule, SignalSettings, signal_settings
from posegsa.parameters import ParameterSpace
from posegsa.rollout import Track, simulate_cost, track
from posegsa.scenario import Scenario

MEAN = ObjectiveConfig(name="mean")


class Problem(NamedTuple):
    """All that the cost of a schedule depends on, for S scenarios."""

    tracks: Track
    """Leaves (S, N)."""
    initial: FilterState
    """Leaves (S,)."""
    bias: Array
    """(S, 6) true velocity bias [rad/s, m/s]; only for judging the bias estimate."""
    weights: CostWeights
    settings: FilterSettings
    signal: SignalSettings

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the simulation."""
        return self.tracks.time.dtype


@jax.jit
def _simulated(scenario: Scenario, family: Family, keys: Array) -> tuple[Track, FilterState, Array]:
    def one(key: Array) -> tuple[Track, FilterState, Array]:
        drawn, truth, measurements = realise(scenario, family, key)
        initial = initial_state(
            drawn.rotation_estimate, drawn.position_estimate, drawn.bias_estimate
        )
        return track(measurements, truth.rotation, truth.position), initial, drawn.bias

    return jax.vmap(one)(keys)


def problem(experiment: Experiment, scenario: Scenario, keys: Array) -> Problem:
    """The problem of S scenarios of an experiment's family, one for each key of keys (S,)."""
    dtype = jnp.dtype(experiment.run.dtype)
    tracks, initial, bias = _simulated(scenario, family(experiment.family, dtype), keys)
    return Problem(
        tracks,
        initial,
        bias,
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


def population_costs(
    vectors: Array,
    problem: Problem,
    space: ParameterSpace,
    objective: ObjectiveConfig = MEAN,
) -> Array:
    """Cost (A,) of A parameter vectors (A, 22), by default the mean over scenarios (jittable).

    An agent that diverges costs infinity or NaN, one that is out of order where that is not
    repaired infinity; the search sees to it that neither is ever best.
    """
    schedules = FuzzyGain(jax.vmap(space.controller)(vectors))
    costs = over_scenarios(agent_costs(schedules, problem), objective)
    return jnp.where(jax.vmap(space.valid)(vectors), costs, jnp.inf)


costs_by_scenario = jax.jit(agent_costs)
evaluate_population = jax.jit(population_costs, static_argnames="objective")
