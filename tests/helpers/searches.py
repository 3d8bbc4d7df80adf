"""Objectives, and an optimiser with known positions."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.optimisers import Optimiser, Search, advance, box, start

FIXED_BOX = box([0], [4])


def sphere(x: Array) -> Array:
    """Sum of squares of each row."""
    return jnp.sum(x**2, axis=1)


AGENTS, ITERATIONS = 6, 40
"""All files use the same size for searches of `steered`, so that each is compiled once."""


def steered(x: Array) -> Array:
    """An objective in three dimensions: the box fixes the last, whose value selects the cost.

    - Above 1e6: no cost is finite.
    - Between -1 and 0: the distance of the second from 0.1, and of the last from -1/3.
    - Otherwise: the sum of squares of the first two, and the last.
    """
    last = x[:, 2]
    cost = jnp.sum(x[:, :2] ** 2, axis=1) + last
    cost = jnp.where(last > 1e6, jnp.nan, cost)
    off = jnp.abs(x[:, 1] - jnp.asarray(0.1, x.dtype)) + jnp.abs(last + jnp.asarray(1 / 3, x.dtype))
    return jnp.where((last > -1) & (last < 0), off, cost)


class FixedState(NamedTuple):
    """The positions of `Fixed` and the costs from `tell`."""

    position: Array
    told: Array


class Fixed(Optimiser):
    """Asks for the same positions 0, 1/4, ..., 1 on a line, and remembers the costs from `tell`."""

    agents: int = 5
    iterations: int = 3

    def init(self, key: Array, dimensions: int, dtype: Any) -> FixedState:
        """Lay out the positions."""
        del key, dimensions
        line = jnp.linspace(0, 1, self.agents, dtype=dtype)
        return FixedState(line[:, None], jnp.zeros(self.agents, dtype))

    def ask(self, state: FixedState) -> Array:
        """Return the positions."""
        return state.position

    def tell(self, state: FixedState, costs: Array) -> FixedState:
        """Remember the costs."""
        return state._replace(told=costs)


@jax.jit
def fixed_advance(search: Search, costs: Array) -> Search:
    """Give these costs to `Fixed` for one iteration."""
    return advance(Fixed(), lambda x: costs, FIXED_BOX, search, search.iteration + 1)


def fixed_search(costs: list[float], before: Search | None = None) -> Search:
    """Give these costs to `Fixed` for one iteration, after `before` or as the first."""
    search = start(Fixed(), FIXED_BOX, jax.random.key(0)) if before is None else before
    return fixed_advance(search, jnp.asarray(costs, jnp.float32))
