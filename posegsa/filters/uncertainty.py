"""The uncertainty of the pose that a filter states, and whether it is right.

The pose error is xi = [theta; rho] (rad, m) in the body frame, T = T_est exp(xi^). A filter that
knows its covariance has a function `pose_covariance` in addition to `estimate` (`filters.base`).
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import jax.numpy as jnp
from jax import Array

from posegsa.model.estimate import FilterState
from posegsa.model.se3 import compose, log, rotate, rows, subtract, unrotate
from posegsa.model.signal import TruePose

PoseCovariance: TypeAlias = tuple[tuple[Array, ...], ...]
"""Upper triangle of the covariance (6, 6) of xi: row i holds its entries (i, i), (i, i + 1), ..."""


def pose_covariance(ready: Any, state: Any) -> PoseCovariance | None:
    """The covariance of the pose in a state; None if the filter has none."""
    own = getattr(ready, "pose_covariance", None)
    return None if own is None else own(state)


def attitude_deviations(state: Any) -> tuple[Array, Array] | None:
    """Standard deviations of heading and inclination [rad] that a filter's state has as attributes.

    They are `heading_deviation` and `inclination_deviation`; None if it lacks one.
    """
    each = (getattr(state, f"{name}_deviation", None) for name in ("heading", "inclination"))
    heading, inclination = each
    return None if heading is None or inclination is None else (heading, inclination)


def nees(estimate: FilterState, covariance: PoseCovariance, truth: TruePose) -> Array:
    """Normalised estimation error squared of the pose, xi^T Sigma^-1 xi, of the batch shape.

    For a consistent filter it is chi-squared with 6 degrees of freedom, 6 on average. (Y.
    Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    2001, section 5.4.) The covariance must be positive definite.
    """
    w, x, y, z = estimate.attitude
    between = subtract(rotate(rows(truth.attitude), truth.origin), estimate.place)
    turned = compose((w, -x, -y, -z), truth.attitude)
    theta, rho = log(turned, unrotate(rows(estimate.attitude), between))
    return _over(covariance, theta + rho)


def _over(covariance: PoseCovariance, xi: Sequence[Array]) -> Array:
    """xi^T Sigma^-1 xi, by elimination (Sigma = L D L^T)."""
    left, off = [list(row) for row in covariance], list(xi)
    total = jnp.zeros_like(off[0])
    for k, (pivot, *beside) in enumerate(left):
        total = total + off[k] * off[k] / pivot
        for i, entry in enumerate(beside, start=k + 1):
            factor = entry / pivot
            off[i] = off[i] - factor * off[k]
            for j in range(i, len(left)):
                left[i][j - i] = left[i][j - i] - factor * left[k][j - k]
    return total
