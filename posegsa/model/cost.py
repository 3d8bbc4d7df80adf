"""Costs of a simulation: the paper's (Eq. 17), as sums over samples, and that on recordings."""

from typing import NamedTuple, Self

import jax.numpy as jnp
from jax import Array

from posegsa.model.se3 import safe_sqrt


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


class RecordedCost(NamedTuple):
    """The cost on a recording: root mean squares of attitude and position over what is judged.

    C = RMSE of the attitude [deg] + weight x RMSE of the position [m]. The attitude's error is
    taken as its chord, 2 sin(angle / 2), which is the angle but for 1 % at 28 deg; the position's
    is |P_est - P|.
    """

    weight: Array
    """(N,) share of each sample, 0 where it is not judged; they sum up to 1."""
    position: tuple[Array, Array, Array]
    """True P, each (N,) [m]; anything where it is not judged."""
    position_weight: Array
    """[deg/m], 0 where the position is not judged."""


class SquaredErrors(NamedTuple):
    """Mean squares, run up sample by sample."""

    attitude: Array
    """sin^2(angle / 2)."""
    position: Array
    """[m^2]."""

    def cost(self, position_weight: Array) -> Array:
        """C [deg]; infinite where the filter diverged: `safe_sqrt` makes 0 of NaN."""
        attitude = jnp.degrees(2 * safe_sqrt(self.attitude))
        cost = attitude + position_weight * safe_sqrt(self.position)
        known = jnp.isfinite(self.attitude) & jnp.isfinite(self.position)
        return jnp.where(known, cost, jnp.inf)
