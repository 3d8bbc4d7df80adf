"""Particle swarm: each agent is drawn to its own best position and to the best of all agents.

Sources: J. Kennedy, R. Eberhart, "Particle Swarm Optimization", IEEE ICNN 1995; M. Clerc,
J. Kennedy, "The particle swarm: explosion, stability, and convergence in a multidimensional complex
space", IEEE Trans. Evolutionary Computation 6 (2002) 58-73, whose constriction (their type 1'')
is written here as an inertia, after R. Eberhart, Y. Shi, "Comparing inertia weights and
constriction factors in particle swarm optimization", IEEE CEC 2000:

    v <- w v + c1 r1 (p - x) + c2 r2 (g - x),   x <- x + v

with new r1, r2 in [0, 1) for each agent and dimension, p the agent's own best position and g the
best of all. A coordinate that leaves the box stops at its bound, with velocity 0.
"""

from typing import Annotated, ClassVar, Literal, NamedTuple

import jax.numpy as jnp
from jax import Array, random
from jax.typing import DTypeLike
from pydantic import Field

from posegsa.optimisers.ask_tell import FailureCost, Optimiser, uniform
from posegsa.settings.fields import Count, NonNegative

INERTIA, PULL = 0.7298, 1.4961
"""chi and chi phi1 for the usual phi1 = phi2 = 2.05 (Clerc and Kennedy 2002, Eq. 4.15 with
kappa = 1), to the four decimals that are usually printed."""


class ParticleSwarmState(NamedTuple):
    """State of the swarm between two iterations; positions are in the unit box."""

    position: Array  # x (agents, dimensions)
    velocity: Array  # v (agents, dimensions) in widths of the box per iteration
    best_position: Array  # p (agents, dimensions)
    best_cost: Array  # (agents,) cost of p; inf before the first costs
    key: Array  # random key for the next draws


class ParticleSwarm(Optimiser):
    """Particle swarm (Clerc and Kennedy 2002); particles move in the unit box."""

    optimiser: Literal["pso"] = "pso"
    """Name of the optimiser."""
    agents: Annotated[Count, Field(ge=2)] = 100
    """Number of particles."""
    inertia: NonNegative = INERTIA
    """Share w of the velocity that a particle keeps, no unit."""
    cognitive: NonNegative = PULL
    """Pull c1 of a particle's own best position, no unit."""
    social: NonNegative = PULL
    """Pull c2 of the best position of all, no unit."""

    title: ClassVar[str] = "Particle swarm"
    failure_cost: ClassVar[FailureCost] = "largest"

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> ParticleSwarmState:
        """Draw the particles uniformly over the unit box, with velocity 0."""
        key, key_position = random.split(key)
        position = uniform(key_position, (self.agents, dimensions), dtype)
        unknown = jnp.full(self.agents, jnp.inf, dtype)
        return ParticleSwarmState(position, jnp.zeros_like(position), position, unknown, key)

    def tell(self, state: ParticleSwarmState, costs: Array) -> ParticleSwarmState:
        """Update the best positions with the costs (agents,), and move the particles."""
        x = state.position
        better = costs < state.best_cost
        p = jnp.where(better[:, None], x, state.best_position)
        best_cost = jnp.where(better, costs, state.best_cost)
        g = p[jnp.argmin(best_cost)][None, :]

        key, key_own, key_all = random.split(state.key, 3)
        r1, r2 = (uniform(k, x.shape, x.dtype) for k in (key_own, key_all))
        v = self.inertia * state.velocity
        v = v + self.cognitive * r1 * (p - x) + self.social * r2 * (g - x)
        x = x + v
        inside = (x >= 0) & (x <= 1)
        return ParticleSwarmState(jnp.clip(x, 0, 1), jnp.where(inside, v, 0), p, best_cost, key)
