"""The paper's cost (Eq. 17): transient plus steady-state error, as sums over samples."""

from typing import NamedTuple, Self

import jax.numpy as jnp
from jax import Array


class CostWeights(NamedTuple):
    """The cost as a weighted sum over samples, so that it can be run up inside the simulation."""

    transient: Array
    """(N,) 0.3 inside the transient window, else 0 (0.3 as configured)."""
    steady: Array
    """(N,) 1 inside the steady-state window, else 0 (1 as configured)."""
    window: Array
    """(N,) whether a sample lies inside the steady-state window, also where that has no weight."""
    position: Array
    """Weight of the position error beside the attitude error [1/m], 0.2 in the paper."""

    def until(self, time: Array, end: Array | None) -> Self:
        """The weights at times (N,) [s], where nothing counts from `end` [s] on; None is never."""
        if end is None:
            return self
        counts = time < end
        transient, steady = (jnp.where(counts, a, 0.0) for a in (self.transient, self.steady))
        return self._replace(transient=transient, steady=steady, window=self.window & counts)


class CostParts(NamedTuple):
    """The two weighted parts of the cost C = 0.3 e_tr + e_ss (Eq. 17)."""

    transient: Array
    steady: Array

    @property
    def total(self) -> Array:
        """C."""
        return self.transient + self.steady


def sample_error(attitude: Array, position: Array, weights: CostWeights) -> Array:
    """||R_err||_I + 0.2 ||P_err||, the summand of both parts."""
    return attitude + weights.position * position


def trajectory_cost(attitude: Array, position: Array, weights: CostWeights) -> CostParts:
    """Cost of errors over time.

    Args:
        attitude: (..., N) ||R_err||_I in [0, 1].
        position: (..., N) ||P_err|| [m].
        weights: for N samples.
    """
    error = sample_error(attitude, position, weights)

    def total(weight: Array) -> Array:
        return jnp.einsum("...n,n->...", error, weight, precision="highest")

    return CostParts(total(weights.transient), total(weights.steady))
