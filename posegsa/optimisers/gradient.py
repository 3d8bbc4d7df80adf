"""Objectives with gradients: by forward mode, reverse mode, or the caller's own function."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.optimisers.ask_tell import Objective

ObjectiveWithGradient = Callable[[Array], tuple[Array, Array]]
"""Maps positions (agents, dimensions) to costs (agents,) and gradients (agents, dimensions)."""


class Differentiable(NamedTuple):
    """An objective without and with its gradients, both in the box's coordinates."""

    costs: Objective
    costs_and_gradients: ObjectiveWithGradient


def reverse_mode(objective: Objective) -> Differentiable:
    """Differentiate a batched objective by reverse mode: one pass for any number of dimensions.

    It stores the intermediate results of every step, and can't differentiate a `while_loop`.
    """

    def costs_and_gradients(positions: Array) -> tuple[Array, Array]:
        costs, pull_back = jax.vjp(objective, positions)
        return costs, pull_back(jnp.ones_like(costs))[0]

    return Differentiable(objective, costs_and_gradients)


def forward_mode(objective: Objective) -> Differentiable:
    """Differentiate a batched objective by forward mode: one pass for each dimension, all at once.

    It stores no intermediate results, which suits few dimensions and long simulations: for the cost
    of a filter over 1500 steps with 22 parameters it is about 100 times faster than reverse mode.
    """

    def cost(position: Array) -> Array:
        return objective(position[None])[0]

    # One position after the other: the dimensions of one fill the vector units, and its numbers fit
    # into the cache.
    gradients = partial(lax.map, partial(value_and_slopes, cost))
    return Differentiable(objective, gradients)


def value_and_slopes(function: Callable[[Array], Array], position: Array) -> tuple[Array, Array]:
    """Value () and gradient (dimensions,) of a function at a position, by forward mode."""
    basis = jnp.eye(position.shape[0], dtype=position.dtype)
    values, slopes = jax.vmap(lambda d: jax.jvp(function, (position,), (d,)))(basis)
    return values[0], slopes
