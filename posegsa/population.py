"""Agents x scenarios -> costs, in one compiled call."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.config import Experiment, ObjectiveConfig
from posegsa.cost import CostWeights, cost_weights, over_scenarios
from posegsa.family import Family, family, realise
from posegsa.filter import FilterSettings, FilterState, filter_settings, initial_state
from posegsa.gain import FuzzyGain, GainSchedule, SignalSettings, signal_settings
from posegsa.parameters import ParameterSpace
from posegsa.rollout import Track, simulate_cost, track
from posegsa.scenario import Scenario

MEAN = ObjectiveConfig(name="mean")

PIECE = 128
"""Agents simulated at once on a CPU: some 60 numbers each, they fit a core's first-level cache."""
SMALL = 64
"""So few agents share a piece with other scenarios'."""
LANES = 16
"""Numbers of 32 bits in the widest vectors of a CPU."""


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


class Tasks(NamedTuple):
    """How S scenarios x A agents are cut into pieces that are simulated one after the other."""

    groups: int
    """Pieces along the scenarios."""
    scenarios: int
    """Scenarios in a piece."""
    chunks: int
    """Pieces along the agents."""
    agents: int
    """Agents in a piece."""


def tasks(scenarios: int, agents: int, *, shards: int = 1, piecewise: bool = True) -> Tasks:
    """Cut S scenarios x A agents into pieces, as many for each shard.

    On a CPU (`piecewise`) a piece's state stays in the core's own cache, so that an agent's price
    does not depend on how many there are: with 10 000 agents at once it doubles. An accelerator
    wants all it can get at once. Whatever the cut, each simulation is, bit for bit, the same.
    """
    together = min(scenarios, max(1, PIECE // agents)) if agents < SMALL else 1
    if not piecewise:
        together = scenarios
    groups = -(-scenarios // min(together, -(-scenarios // shards)))
    step = shards // math.gcd(groups, shards)  # chunks that let all shards have as many pieces
    chunks = -(-(-(-agents // PIECE) if piecewise else 1) // step) * step
    chunk = -(-agents // chunks)
    # What does not fill a vector runs number by number, which costs more than one more vector.
    if piecewise and chunk > LANES:
        chunk += -chunk % LANES
    return Tasks(groups, -(-scenarios // groups), chunks, chunk)


def agent_costs(schedules: GainSchedule, problem: Problem, axis: str | None = None) -> Array:
    """Cost (S, A) of A schedules on S scenarios (pure, jittable).

    All agents meet the same noise (common random numbers), so that their differences are their
    own. The agents are the innermost batch axis: one time step of all agents of a piece is a few
    fused kernels.

    Args:
        schedules: One kind of schedule whose leaves have a leading axis of agents.
        problem: Scenarios and settings.
        axis: Inside `jax.shard_map`, the mesh axis over which the work is divided. Schedules and
            problem are the same on all its devices, and so are the costs: only they travel.
    """
    count = problem.tracks.time.shape[0], jax.tree.leaves(schedules)[0].shape[0]
    shards = 1 if axis is None else lax.axis_size(axis)
    on_cpu = jax.default_backend() == "cpu"
    cut = tasks(*count, shards=shards, piecewise=on_cpu)

    def piece(part: Array) -> Array:
        group, chunk = part // cut.chunks, part % cut.chunks
        tracks, initial = _part((problem.tracks, problem.initial), group, cut.scenarios, count[0])
        some = _part(schedules, chunk, cut.agents, count[1])

        def on_scenario(track: Track, initial: FilterState) -> Array:
            def agent(schedule: GainSchedule) -> Array:
                return simulate_cost(
                    schedule, track, initial, problem.weights, problem.settings, problem.signal
                ).total

            return jax.vmap(agent)(some)

        return jax.vmap(on_scenario)(tracks, initial)

    mine = jnp.arange(cut.groups * cut.chunks // shards)
    if axis is not None:
        mine = mine + lax.axis_index(axis) * mine.size
    costs = lax.map(piece, mine) if on_cpu else jax.vmap(piece)(mine)
    if axis is not None:
        costs = lax.all_gather(costs, axis, tiled=True)
    costs = costs.reshape(cut.groups, cut.chunks, cut.scenarios, cut.agents)
    costs = costs.transpose(0, 2, 1, 3).reshape(cut.groups * cut.scenarios, -1)
    return costs[: count[0], : count[1]]


def _part(tree: Any, index: Array, size: int, count: int) -> Any:
    """Piece `index` of `size` along the first axis of `count`; the last piece repeats the last."""
    if size == count:
        return tree
    chosen = jnp.minimum(index * size + jnp.arange(size), count - 1)
    return jax.tree.map(lambda leaf: leaf[chosen], tree)


def population_costs(
    vectors: Array,
    problem: Problem,
    space: ParameterSpace,
    objective: ObjectiveConfig = MEAN,
    axis: str | None = None,
) -> Array:
    """Cost (A,) of A parameter vectors (A, 22), by default the mean over scenarios (jittable).

    An agent that diverges costs infinity or NaN, one that is out of order where that is not
    repaired infinity; the search sees to it that neither is ever best. `axis` is `agent_costs`'.
    """
    schedules = FuzzyGain(jax.vmap(space.controller)(vectors))
    costs = over_scenarios(agent_costs(schedules, problem, axis), objective)
    return jnp.where(jax.vmap(space.valid)(vectors), costs, jnp.inf)


costs_by_scenario = jax.jit(agent_costs, static_argnames="axis")
evaluate_population = jax.jit(population_costs, static_argnames=("objective", "axis"))
