"""Agents x scenarios -> costs, in one compiled call."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from posegsa.arguments import refuse
from posegsa.config import ObjectiveConfig
from posegsa.filters.base import Filter, Samples
from posegsa.filters.rollout import (
    ErrorTrack,
    simulate_cost,
    simulate_errors,
    simulate_recorded_cost,
)
from posegsa.model.cost import CostWeights, RecordedCost
from posegsa.model.estimate import FilterState
from posegsa.search.candidates import Candidate, SearchSpace

MEAN = ObjectiveConfig(name="mean")

PIECE = 128
"""Agents simulated at once on a CPU: some 60 numbers each, they fit a core's first-level cache."""
SMALL = 64
"""So few agents share a piece with other scenarios'."""
SHARED = 4
"""Pieces of different scenarios that there are then at least, to be divided among devices."""
FILLED = 4 / 3
"""How many more groups of scenarios there may be, so that all devices have as many pieces."""
LANES = 16
"""Numbers of 32 bits in the widest vectors of a CPU."""


TrackCost = Callable[[ErrorTrack, Array], Array]
"""A cost of a user's own: maps the errors of a simulation and the times (N,) [s] to one number, to
be minimised (pure, jittable)."""


CONFIGURED = "configured"
"""The name of the cost that an experiment configures."""


def cost_name(cost: TrackCost | None) -> str:
    """What a cost is called where it is stored."""
    if cost is None:
        return CONFIGURED
    return f"{getattr(cost, '__module__', '')}.{getattr(cost, '__qualname__', type(cost).__name__)}"


def check_same_cost(cost: TrackCost | None, stored: str) -> None:
    """Raise an ArgumentError unless a cost is that by which a run was tuned, by its name."""
    if cost_name(cost) != stored:
        refuse(f"cost = {cost_name(cost)}", f"{stored}, by which the run was tuned")


class ScenarioBatch(NamedTuple):
    """All that the cost of a filter depends on, for S scenarios."""

    samples: Samples
    """Leaves (S, N)."""
    initial: FilterState
    """Leaves (S,)."""
    bias: Array
    """(S, 6) true velocity bias at the end [rad/s, m/s]; only for judging its estimate."""
    vector_bias: Array
    """(S, n, 3) true biases of the vectors, likewise."""
    end: Array | None
    """(S,) time from which on nothing counts [s]; None where all of every scenario does."""
    weights: CostWeights
    filter: Filter
    """What all candidates share of the filter."""
    recorded: RecordedCost | None = None
    """Leaves (S, ...): the cost where the scenarios are recordings; None where they are not."""

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the simulation."""
        return self.samples.time.dtype

    def select(self, index: np.ndarray | slice) -> "ScenarioBatch":
        """Some of the scenarios."""
        names = ("samples", "initial", "bias", "vector_bias", "end", "recorded")
        chosen = {name: getattr(self, name) for name in names}
        return self._replace(**jax.tree.map(lambda a: a[index], chosen))


class Partition(NamedTuple):
    """How S scenarios x A agents are cut into pieces that are simulated one after the other."""

    groups: int
    """Pieces along the scenarios."""
    scenarios: int
    """Scenarios in a piece."""
    chunks: int
    """Pieces along the agents."""
    agents: int
    """Agents in a piece."""


def partition(scenarios: int, agents: int, *, shards: int = 1, piecewise: bool = True) -> Partition:
    """Cut S scenarios x A agents into pieces, as many for each shard.

    On a CPU (`piecewise`) a piece's state stays in the core's own cache, so that an agent's price
    does not depend on how many there are: with 10 000 agents at once it doubles. An accelerator
    wants all it can get at once. A simulation may be rounded otherwise in a piece of another shape,
    so that the shape depends on the shards only where there would be too few pieces for them.
    """
    together = 1
    if not piecewise:
        together = _divided(scenarios, shards)
    elif agents < SMALL:
        together = max(1, min(PIECE // agents, scenarios // SHARED))
    groups = _divided(scenarios, together)
    if piecewise and _divided(scenarios, groups) == 2:
        # XLA's loops over two scenarios are not vectorised: three times as slow as one by one.
        groups = scenarios
    each, chunks = _divided(scenarios, groups), _divided(agents, PIECE) if piecewise else 1
    filled = _filled(groups, shards // math.gcd(chunks, shards))
    if filled <= FILLED * groups:
        groups = filled  # the last ones repeat a scenario
    else:
        chunks = _filled(chunks, shards // math.gcd(groups, shards))
    chunk = _divided(agents, chunks)
    # What does not fill a vector runs number by number, which costs more than one more vector.
    if piecewise and chunk > LANES:
        chunk = LANES * _divided(chunk, LANES)
    return Partition(groups=groups, scenarios=each, chunks=chunks, agents=chunk)


def _filled(count: int, step: int) -> int:
    """The least multiple of a step that is not less."""
    return step * _divided(count, step)


def _divided(count: int, size: int) -> int:
    """How many parts of a size hold so many, the last one filled up."""
    return math.ceil(count / size)


def agent_costs(
    agents: Candidate,
    batch: ScenarioBatch,
    axis: str | None = None,
    cost: TrackCost | None = None,
) -> Array:
    """Cost (S, A) of A agents on S scenarios (pure, jittable).

    All agents meet the same noise (common random numbers), so that their differences are their
    own. The agents are the innermost batch axis: one time step of all agents of a piece is a few
    fused kernels.

    Args:
        agents: Candidates of one kind, leaves (A, ...).
        batch: Scenarios and settings.
        axis: Inside `jax.shard_map`, the mesh axis over which the work is divided. Agents and
            scenarios are the same on all its devices, and so are the costs: only they travel.
        cost: A cost of the user's own instead of the configured one.
    """
    count = batch.samples.time.shape[0], jax.tree.leaves(agents)[0].shape[0]
    shards = 1 if axis is None else lax.axis_size(axis)
    on_cpu = jax.default_backend() == "cpu"
    cut = partition(*count, shards=shards, piecewise=on_cpu)

    def piece(part: Array) -> Array:
        group, chunk = part // cut.chunks, part % cut.chunks
        given = batch.samples, batch.initial, batch.end, batch.recorded
        each = _part(given, group, cut.scenarios, count[0])
        some = _part(agents, chunk, cut.agents, count[1])

        def on_scenario(
            samples: Samples,
            initial: FilterState,
            end: Array | None,
            recorded: RecordedCost | None,
        ) -> Array:
            weights = batch.weights.until(samples.time, end)

            def agent(one: Candidate) -> Array:
                # Made here, so that only what a candidate has of its own is batched over agents.
                filter = one.applied(batch.filter)
                if cost is not None:
                    return cost(simulate_errors(filter, samples, initial), samples.time)
                if recorded is not None:
                    return simulate_recorded_cost(filter, samples, initial, recorded)
                return simulate_cost(filter, samples, initial, weights).total

            return jax.vmap(agent)(some)

        return jax.vmap(on_scenario)(*each)

    mine = jnp.arange(cut.groups * cut.chunks // shards)
    if axis is not None:
        mine = mine + lax.axis_index(axis).astype(mine.dtype) * mine.size
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
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[chosen], tree)


def over_scenarios(costs: Array, objective: ObjectiveConfig) -> Array:
    """One cost for each agent from its costs on S scenarios.

    Args:
        costs: (S, ...) costs; a NaN or infinity on any scenario makes the result not finite.
        objective: "mean", "median", "worst"; "cvar": the mean of the ceil((1 - level) S) worst
            (Rockafellar and Uryasev 2000, on equally likely scenarios); "mean_std": the mean plus
            factor times the standard deviation.

    Returns:
        Costs (...).
    """
    mean = jnp.mean(costs, axis=0)
    match objective.name:
        case "mean":
            return mean
        case "median":
            # A median would forgive scenarios that diverge: the objective may not.
            return jnp.where(jnp.isfinite(mean), jnp.median(costs, axis=0), mean)
        case "worst":
            return jnp.max(costs, axis=0)
        case "cvar":
            worst = max(1, math.ceil((1 - objective.level) * costs.shape[0] - 1e-9))
            return jnp.mean(jnp.sort(costs, axis=0)[-worst:], axis=0)
        case "mean_std":
            return mean + objective.factor * jnp.std(costs, axis=0)


def population_costs(
    vectors: Array,
    batch: ScenarioBatch,
    space: SearchSpace,
    objective: ObjectiveConfig = MEAN,
    axis: str | None = None,
    cost: TrackCost | None = None,
    beside: ScenarioBatch | None = None,
) -> Array:
    """Cost (A,) of A search vectors (A, d), by default the mean over scenarios (jittable).

    With further scenarios `beside` these, they have the share of the objective, and these the rest.
    An agent that diverges costs infinity or NaN, one that is out of order where that is not
    repaired infinity; the search sees to it that neither is ever best. `axis` and `cost` are
    `agent_costs`'.
    """
    agents = jax.vmap(space.candidate)(vectors)
    costs = agent_costs(agents, batch, axis, cost)
    further = None if beside is None else agent_costs(agents, beside, axis, cost)
    return costs_of_agents(vectors, costs, further, space, objective)


def costs_of_agents(
    vectors: Array,
    costs: Array,
    further: Array | None,
    space: SearchSpace,
    objective: ObjectiveConfig,
) -> Array:
    """Cost (A,) of A search vectors (A, d) from their costs (S, A) on S scenarios (jittable).

    `further` are their costs on scenarios beside these, if there are any.
    """
    together = over_scenarios(costs, objective)
    if further is not None:
        share = objective.simulated_share
        together = (1 - share) * together + share * over_scenarios(further, objective)
    return jnp.where(jax.vmap(space.valid)(vectors), together, jnp.inf)


costs_by_scenario = jax.jit(agent_costs, static_argnums=(2, 3))
evaluate_population = jax.jit(population_costs, static_argnames=("objective", "axis", "cost"))
