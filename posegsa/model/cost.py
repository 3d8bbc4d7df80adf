"""The cost of a simulation (Eq. 17 of the paper), and the cost on a recording."""

from typing import NamedTuple, Self

import jax.numpy as jnp
from jax import Array

from posegsa.model.se3 import safe_sqrt


class CostWeights(NamedTuple):
    """The cost as a weighted sum over samples, so that the simulation can accumulate it."""

    transient: Array
    """(N,) 0.3 inside the transient window, else 0 (0.3 as configured)."""
    steady: Array
    """(N,) 1 inside the steady-state window, else 0 (1 as configured)."""
    window: Array
    """(N,) True inside the steady-state window, even if its weight is 0."""
    position: Array
    """Weight of the position error relative to the attitude error [1/m], 0.2 in the paper."""

    def between(self, time: Array, begin: Array | None, end: Array | None) -> Self:
        """The weights for samples at `time` (N,) [s], 0 before `begin` and from `end` on [s].

        None changes nothing.
        """
        if begin is None and end is None:
            return self
        counts = jnp.asarray(True) if end is None else time < end
        counts = counts if begin is None else counts & (time >= begin)
        transient, steady = (jnp.where(counts, a, 0.0) for a in (self.transient, self.steady))
        return self._replace(transient=transient, steady=steady, window=self.window & counts)


class CostParts(NamedTuple):
    """The two weighted parts of the cost C = 0.3 e_tr + e_ss (Eq. 17)."""

    transient: Array
    steady: Array

    @property
    def total(self) -> Array:
        """The cost C."""
        return self.transient + self.steady


def sample_error(attitude: Array, position: Array, weights: CostWeights) -> Array:
    """||R_err||_I + 0.2 ||P_err||, the term that both parts sum."""
    return attitude + weights.position * position


class RecordedCost(NamedTuple):
    """The cost on a recording: root mean square errors over the judged samples.

    C = RMSE of the attitude [deg] + weight x RMSE of the position [m]. The attitude error is the
    chord 2 sin(angle / 2), 1 % below the angle at 28 deg. The position error is |P_est - P|.
    """

    weight: Array
    """(N,) share of each sample, 0 where it is not judged; they sum to 1."""
    position: tuple[Array, Array, Array]
    """True P, each (N,) [m]; arbitrary where it is not judged."""
    position_weight: Array
    """[deg/m], 0 where the position is not judged."""


class SquaredErrors(NamedTuple):
    """Mean squared errors, accumulated sample by sample."""

    attitude: Array
    """sin^2(angle / 2)."""
    position: Array
    """[m^2]."""

    def cost(self, position_weight: Array) -> Array:
        """The cost C [deg], infinite where the filter diverged."""
        attitude = jnp.degrees(2 * safe_sqrt(self.attitude))
        cost = attitude + position_weight * safe_sqrt(self.position)
        # `safe_sqrt` turns NaN into 0, which would be the best cost of all.
        known = jnp.isfinite(self.attitude) & jnp.isfinite(self.position)
        return jnp.where(known, cost, jnp.inf)
