"""Differential evolution: agents try steps by differences of other agents and keep better ones.

Source: R. Storn, K. Price, "Differential Evolution - A Simple and Efficient Heuristic for Global
Optimization over Continuous Spaces", J. Global Optimization 11 (1997) 341-359, schemes
"rand/1/bin" and "best/1/bin". Equation numbers are the article's. Each generation is made as a
whole from the one before it, as in the article. A coordinate of a trial that leaves the box is
redrawn; the article does not treat this case.
"""

from typing import Annotated, ClassVar, Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, random
from jax.typing import DTypeLike
from pydantic import Field

from posegsa.optimisers.ask_tell import FailureCost, Optimiser, uniform
from posegsa.settings.fields import Count, Share

Strategy = Literal["rand/1/bin", "best/1/bin"]


class DifferentialEvolutionState(NamedTuple):
    """State between two iterations; positions lie in the unit box."""

    position: Array  # x (agents, dimensions)
    cost: Array  # (agents,) of x; inf before the first costs
    trial: Array  # u (agents, dimensions), the positions of `ask`
    key: Array  # random key for the next draws


class DifferentialEvolution(Optimiser):
    """Differential evolution (Storn and Price 1997) in the unit box."""

    optimiser: Literal["de"] = "de"
    """Name of the optimiser."""
    agents: Annotated[Count, Field(ge=4)] = 100
    """Number of agents, the article's NP."""
    strategy: Strategy = "rand/1/bin"
    """Base of a mutant: "rand/1/bin" a random agent, "best/1/bin" the best one."""
    factor: Annotated[float, Field(strict=True, ge=0, le=2)] = 0.5
    """Weight F of the difference of two agents, no unit."""
    crossover: Share = 0.9
    """Probability CR that a coordinate comes from the mutant."""

    title: ClassVar[str] = "Differential evolution"
    failure_cost: ClassVar[FailureCost] = "largest"

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> DifferentialEvolutionState:
        """Draw the first generation uniformly over the unit box."""
        key, key_position = random.split(key)
        first = uniform(key_position, (self.agents, dimensions), dtype)
        unknown = jnp.full(self.agents, jnp.inf, dtype)
        return DifferentialEvolutionState(position=first, cost=unknown, trial=first, key=key)

    def begin_at(
        self, state: DifferentialEvolutionState, position: Array
    ) -> DifferentialEvolutionState:
        """Put the first agent at a position (dimensions,) in the unit box."""
        first = state.trial.at[0].set(position)
        return state._replace(position=first, trial=first)

    def ask(self, state: DifferentialEvolutionState) -> Array:
        """Return the trials (agents, dimensions) in the unit box."""
        return state.trial

    def tell(self, state: DifferentialEvolutionState, costs: Array) -> DifferentialEvolutionState:
        """Keep the trials that cost no more than their agents, and make the next trials."""
        kept = costs <= state.cost
        x = jnp.where(kept[:, None], state.trial, state.position)
        cost = jnp.where(kept, costs, state.cost)

        key, *keys = random.split(state.key, 5)
        others = distinct_others(keys[0], self.agents)
        base = x[others[0]] if self.strategy == "rand/1/bin" else x[jnp.argmin(cost)][None, :]
        mutant = base + self.factor * (x[others[1]] - x[others[2]])  # Eq. 2
        mutant = jnp.where((mutant < 0) | (mutant > 1), uniform(keys[1], x.shape, x.dtype), mutant)
        drawn = uniform(keys[2], x.shape, jnp.float32) < self.crossover
        sure = random.randint(keys[3], (self.agents, 1), 0, x.shape[1])  # at least one each
        crossed = drawn | (jnp.arange(x.shape[1])[None, :] == sure)
        trial = jnp.where(crossed, mutant, x)  # Eq. 4
        return DifferentialEvolutionState(position=x, cost=cost, trial=trial, key=key)


def distinct_others(key: Array, agents: int) -> Array:
    """Return three other agents r1, r2, r3 (3, agents) for each agent i, distinct and uniform.

    The k-th agent is drawn as a number below agents - k, an index among the agents that are not yet
    taken. It is raised by one for each taken agent, in ascending order, that is not above it.
    """
    taken = jnp.arange(agents, dtype=jnp.int32)[None, :]
    for k, each in enumerate(random.split(key, 3), start=1):
        drawn = random.randint(each, (agents,), 0, agents - k, jnp.int32)
        for before in jnp.sort(taken, axis=0):
            drawn = drawn + (drawn >= before).astype(jnp.int32)
        taken = jnp.concatenate([taken, drawn[None, :]])
    return taken[1:]
