"""Costs of all agents on all scenarios, in one compiled call."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from posegsa.arguments import refuse
from posegsa.config import ObjectiveConfig
from posegsa.filters.base import Filter, Samples, elementwise
from posegsa.filters.rollout import (
    ErrorTrack,
    simulate_cost,
    simulate_errors,
    simulate_recorded_cost,
)
from posegsa.model.cost import CostWeights, RecordedCost
from posegsa.model.estimate import FilterState
from posegsa.model.gpu_loop import THREADS, on_gpu
from posegsa.search.candidates import Candidate, SearchSpace

MEAN = ObjectiveConfig(name="mean")

AGENTS_PER_PIECE = 128
"""Agents simulated at once on a CPU: about 60 numbers each, so that they fit a core's L1 cache."""
FEW_AGENTS = 64
"""Below this number of agents, a piece holds several scenarios."""
MIN_GROUPS = 4
"""Minimum number of pieces along the scenarios in that case, to be divided among devices."""
MAX_PADDING = 4 / 3
"""Largest factor by which padding may increase the groups, so that all devices get equally many."""
LANES = 16
"""Numbers of 32 bits in the widest vector registers of a CPU."""


TrackCost = Callable[[ErrorTrack, Array], Array]
"""A user's own cost: maps the errors of a simulation and the times (N,) [s] to the number to be
minimised (pure, jittable)."""


CONFIGURED = "configured"
"""The name of the cost that an experiment configures."""


def cost_name(cost: TrackCost | None) -> str:
    """The name of a cost, as it is stored."""
    if cost is None:
        return CONFIGURED
    return f"{getattr(cost, '__module__', '')}.{getattr(cost, '__qualname__', type(cost).__name__)}"


def check_same_cost(cost: TrackCost | None, stored: str) -> None:
    """Raise an ArgumentError unless a cost has the name of the cost that a run was tuned with."""
    if cost_name(cost) != stored:
        refuse(f"cost = {cost_name(cost)}", f"{stored}, with which the run was tuned")


def check_cost(cost: TrackCost | None, samples: int, vectors: int, dtype: jnp.dtype) -> None:
    """Raise an ArgumentError unless a user's cost maps a simulation to one number.

    Args:
        cost: The function; None is the configured one.
        samples: N of a simulation.
        vectors: How many biases of vectors it estimates.
        dtype: Floating type of the simulation.
    """
    if cost is None:
        return

    def leaf(*shape: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(shape, dtype)

    over_time: Any = leaf(samples)
    biases: Any = leaf(6), leaf(vectors, 3)
    track = ErrorTrack(*(over_time,) * 4, *biases)
    allowed = "a JAX function of an ErrorTrack and of the times (N,) [s] that returns one number"
    try:
        found = jax.eval_shape(cost, track, over_time)
    except Exception as error:  # whatever the user's function raises
        refuse(f"cost {cost_name(cost)}: {type(error).__name__}: {error}", allowed)
    shape, kind = getattr(found, "shape", None), getattr(found, "dtype", None)
    if shape != () or kind is None or not jnp.issubdtype(kind, jnp.number):
        returned = type(found).__name__ if shape is None else f"{kind} of the shape {shape}"
        refuse(f"cost {cost_name(cost)}: returns {returned}", allowed)


class ScenarioBatch(NamedTuple):
    """Everything that the cost of a filter depends on, for S scenarios."""

    samples: Samples
    """Leaves (S, N)."""
    initial: FilterState
    """Leaves (S,)."""
    bias: Array
    """(S, 6) true velocity bias at the end [rad/s, m/s]; only to judge its estimate."""
    vector_bias: Array
    """(S, n, 3) true biases of the vectors; only to judge their estimates."""
    begin: Array | None
    """(S,) time at which the estimate starts [s], before which nothing counts; None where that is
    the first sample."""
    end: Array | None
    """(S,) time at which the cost ends [s]; None if whole scenarios count."""
    weights: CostWeights
    filter: Filter
    """The part of the filter that all candidates share."""
    recorded: RecordedCost | None = None
    """Leaves (S, ...): the cost on recordings; None for simulated scenarios."""

    @property
    def dtype(self) -> jnp.dtype:
        """Floating type of the simulation."""
        return self.samples.time.dtype

    def select(self, index: np.ndarray | slice) -> "ScenarioBatch":
        """Some of the scenarios."""
        names = ("samples", "initial", "bias", "vector_bias", "begin", "end", "recorded")
        chosen = {name: getattr(self, name) for name in names}
        return self._replace(**jax.tree.map(lambda a: a[index], chosen))


class Partition(NamedTuple):
    """The division of S scenarios x A agents into pieces that are simulated one by one."""

    groups: int
    """Pieces along the scenarios."""
    scenarios: int
    """Scenarios in a piece."""
    chunks: int
    """Pieces along the agents."""
    agents: int
    """Agents in a piece."""


def partition(scenarios: int, agents: int, *, shards: int = 1, piecewise: bool = True) -> Partition:
    """Divide S scenarios x A agents into pieces, the same number for each shard.

    On a CPU (`piecewise`) the state of a piece stays in the core's cache, so the time per agent
    does not depend on the number of agents; with 10 000 agents at once it doubles. An accelerator
    simulates everything at once. The rounding of a simulation may depend on the shape of its piece,
    so the shape depends on the shards only if there would be too few pieces for them.
    """
    together = 1
    if not piecewise:
        together = _ceil_div(scenarios, shards)
    elif agents < FEW_AGENTS:
        together = max(1, min(AGENTS_PER_PIECE // agents, scenarios // MIN_GROUPS))
    groups = _ceil_div(scenarios, together)
    if piecewise and _ceil_div(scenarios, groups) == 2:
        # XLA doesn't vectorise loops over two scenarios: three times as slow as one by one.
        groups = scenarios
    each, chunks = (
        _ceil_div(scenarios, groups),
        _ceil_div(agents, AGENTS_PER_PIECE) if piecewise else 1,
    )
    padded = _round_up(groups, shards // math.gcd(chunks, shards))
    if padded <= MAX_PADDING * groups:
        groups = padded  # the last groups repeat a scenario
    else:
        chunks = _round_up(chunks, shards // math.gcd(groups, shards))
    chunk = _ceil_div(agents, chunks)
    # The remainder of a vector register runs one by one, slower than another full register.
    if piecewise and chunk > LANES:
        chunk = LANES * _ceil_div(chunk, LANES)
    return Partition(groups=groups, scenarios=each, chunks=chunks, agents=chunk)


def blocks(scenarios: int, agents: int, *, shards: int = 1) -> Partition:
    """The same for a GPU, whose kernel runs THREADS agents on one scenario in each block.

    Shards get their share of the chunks, of all scenarios.
    """
    chunks = _round_up(_ceil_div(agents, THREADS), shards)
    return Partition(groups=scenarios, scenarios=1, chunks=chunks, agents=THREADS)


def _round_up(count: int, step: int) -> int:
    """`count`, rounded up to a multiple of `step`."""
    return step * _ceil_div(count, step)


def _ceil_div(count: int, size: int) -> int:
    """`count / size`, rounded up."""
    return math.ceil(count / size)


def agent_costs(
    agents: Candidate,
    batch: ScenarioBatch,
    axis: str | None = None,
    cost: TrackCost | None = None,
) -> Array:
    """Cost (S, A) of A agents on S scenarios (pure, jittable).

    All agents get the same noise (common random numbers), so the noise does not blur differences
    between them. The agents are the innermost batch axis, on CPUs with the scenarios of a piece as
    one axis: one time step of all agents of a piece is a few fused kernels.

    Args:
        agents: Candidates of one kind, leaves (A, ...).
        batch: Scenarios and settings.
        axis: Inside `jax.shard_map`, the mesh axis over which the simulations are divided. Agents,
            scenarios and returned costs are the same on all devices; only costs are exchanged.
        cost: A user's own cost instead of the configured cost.
    """
    count = batch.samples.time.shape[0], jax.tree.leaves(agents)[0].shape[0]
    shards = 1 if axis is None else lax.axis_size(axis)
    on_cpu = jax.default_backend() == "cpu"
    in_blocks = on_gpu() and cost is None and elementwise(batch.filter)
    if in_blocks:
        cut = blocks(*count, shards=shards)
    else:
        cut = partition(*count, shards=shards, piecewise=on_cpu)

    def in_lanes(filters: Filter, each: Any) -> Array:
        """The costs of a piece whose filters are those of all agents on each of its scenarios."""
        samples, initial, begin, end, recorded = each
        starts = jax.tree.map(lambda a: jnp.repeat(a, cut.agents, axis=0), initial)
        if recorded is not None:
            weight = jnp.repeat(recorded.position_weight, cut.agents)
            recorded = recorded._replace(position_weight=weight)
            costs = simulate_recorded_cost(filters, samples, starts, recorded)
        else:
            weighted = jax.vmap(lambda *one: batch.weights.between(*one)[:2])
            transient, steady = weighted(samples.time, begin, end)
            weights = batch.weights._replace(transient=transient, steady=steady)
            costs = simulate_cost(filters, samples, starts, weights).total
        return costs.reshape(cut.scenarios, cut.agents)

    def piece(group: Array, chunk: Array) -> Array:
        given = batch.samples, batch.initial, batch.begin, batch.end, batch.recorded
        each = _part(given, group, cut.scenarios, count[0])
        some = _part(agents, chunk, cut.agents, count[1])
        if on_cpu and cut.scenarios > 1 and cost is None and elementwise(batch.filter):
            filters = _over(some, cut.agents, cut.scenarios).applied(batch.filter)
            if elementwise(filters):  # not with a schedule of the user's
                return in_lanes(filters, each)

        def on_scenario(
            samples: Samples,
            initial: FilterState,
            begin: Array | None,
            end: Array | None,
            recorded: RecordedCost | None,
        ) -> Array:
            weights = batch.weights.between(samples.time, begin, end)

            def simulated(filter: Filter, initial: FilterState) -> Array:
                if cost is not None:
                    track = simulate_errors(filter, samples, initial)
                    return cost(track.waiting(samples.time, begin), samples.time)
                if recorded is not None:
                    return simulate_recorded_cost(filter, samples, initial, recorded)
                return simulate_cost(filter, samples, initial, weights).total

            # Applied here, so that only the candidates' numbers differ between agents.
            if elementwise(batch.filter) and cost is None:
                filters = some.applied(batch.filter)
                if elementwise(filters):  # not with a schedule of the user's
                    starts = jax.tree.map(lambda a: jnp.broadcast_to(a, cut.agents), initial)
                    return simulated(filters, starts)
            return jax.vmap(lambda one: simulated(one.applied(batch.filter), initial))(some)

        if cut.scenarios == 1:
            # The same without `vmap`, which would trace all operations of the filter once more.
            return on_scenario(*jax.tree.map(lambda leaf: leaf[0], each))[None]
        return jax.vmap(on_scenario)(*each)

    mine = jnp.arange((cut.chunks if in_blocks else cut.groups * cut.chunks) // shards)
    if axis is not None:
        mine = mine + lax.axis_index(axis).astype(mine.dtype) * mine.size
    if in_blocks:
        # Over chunks within groups, so that chunks share a scenario's samples.
        of_group = jax.vmap(piece, in_axes=(None, 0))
        costs = jax.vmap(of_group, in_axes=(0, None))(jnp.arange(cut.groups), mine)
    else:
        each = lax.map if on_cpu else lambda run, parts: jax.vmap(run)(parts)
        costs = each(lambda part: piece(part // cut.chunks, part % cut.chunks), mine)
    if axis is not None:
        costs = lax.all_gather(costs, axis, axis=1 if in_blocks else 0, tiled=True)
    costs = costs.reshape(cut.groups, cut.chunks, cut.scenarios, cut.agents)
    costs = costs.transpose(0, 2, 1, 3).reshape(cut.groups * cut.scenarios, -1)
    return costs[: count[0], : count[1]]


def _over(agents: Candidate, count: int, scenarios: int) -> Candidate:
    """Candidates (A, ...) once for each scenario, one after another: (scenarios A, ...).

    `count` is A. What all agents share stays as it is.
    """

    def over(a: Array) -> Array:
        if not jnp.ndim(a) or a.shape[0] != count:
            return a
        return jnp.tile(a, (scenarios, *(1,) * (a.ndim - 1)))

    return jax.tree.map(over, agents)


def _part(tree: Any, index: Array, size: int, count: int) -> Any:
    """Piece `index` of `size` along the first axis of `count`, padded with its last element."""
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
            `factor` times the standard deviation.

    Returns:
        Costs (...).
    """
    mean = jnp.mean(costs, axis=0)
    match objective.name:
        case "mean":
            return mean
        case "median":
            # The median alone would ignore scenarios that diverge.
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

    `beside` are further scenarios, weighted with the objective's `simulated_share`. An agent that
    diverges costs infinity or NaN. An agent that is out of order costs infinity if the order is not
    repaired. Neither can become the best agent. `axis` and `cost` are as in `agent_costs`.
    """
    agents = jax.vmap(space.candidate)(vectors)
    together = over_scenarios(agent_costs(agents, batch, axis, cost), objective)
    if beside is not None:
        share = objective.simulated_share
        further = over_scenarios(agent_costs(agents, beside, axis, cost), objective)
        together = (1 - share) * together + share * further
    return jnp.where(jax.vmap(space.valid)(vectors), together, jnp.inf)


costs_by_scenario = jax.jit(agent_costs, static_argnums=(2, 3))
evaluate_population = jax.jit(population_costs, static_argnames=("objective", "axis", "cost"))
