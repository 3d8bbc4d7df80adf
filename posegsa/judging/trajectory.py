"""One simulation over time, in degrees and metres."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.filters.rollout import Estimates
from posegsa.judging.metrics import estimates_on
from posegsa.model.se3 import (
    attitude_distance,
    clip_distance,
    compose,
    euler_angles,
    log,
    quaternion,
    rotation_angle,
    rotation_matrix,
    stack,
    unstack,
)
from posegsa.model.signal import TruePose, known_pose
from posegsa.search.candidates import Candidate
from posegsa.search.population import ScenarioBatch
from posegsa.settings.arrays import Columns
from posegsa.settings.plain import decimal

_column = partial(Columns, allow="any")
"""Columns that may hold any number, as the filter may have diverged."""


@dataclass(frozen=True)
class Trajectory:
    """Truth, estimates, errors and gain over N samples; one row per sample in a table."""

    time: Annotated[np.ndarray, Columns("time_s")]
    """(N,) [s]."""
    euler: Annotated[np.ndarray, _column("roll_deg", "pitch_deg", "yaw_deg")]
    """(N, 3) true roll, pitch, yaw [deg]."""
    euler_est: Annotated[np.ndarray, _column("roll_est_deg", "pitch_est_deg", "yaw_est_deg")]
    """(N, 3) estimated roll, pitch, yaw [deg]."""
    position: Annotated[np.ndarray, _column("x_m", "y_m", "z_m")]
    """(N, 3) true position, inertial frame [m]."""
    position_est: Annotated[np.ndarray, _column("x_est_m", "y_est_m", "z_est_m")]
    """(N, 3) estimated position, inertial frame [m]."""
    bias_est: Annotated[
        np.ndarray,
        _column(
            *("bias_est_wx_rad_s", "bias_est_wy_rad_s", "bias_est_wz_rad_s"),
            *("bias_est_vx_m_s", "bias_est_vy_m_s", "bias_est_vz_m_s"),
        ),
    ]
    """(N, 6) estimated velocity bias, body frame [rad/s, m/s]."""
    attitude_error: Annotated[np.ndarray, _column("attitude_error_deg")]
    """(N,) angle of R_est R^T [deg]."""
    attitude_distance: Annotated[np.ndarray, _column("attitude_distance")]
    """(N,) ||R_est R^T||_I, in [0, 1]."""
    position_error: Annotated[np.ndarray, _column("position_error_m")]
    """(N,) ||P_est - R_err P|| [m], the position error of the cost."""
    distance: Annotated[np.ndarray, _column("distance_m")]
    """(N,) |P_est - P| [m], the distance of the estimate from the body."""
    gain: Annotated[np.ndarray, _column("gain_1_s")]
    """(N,) K that the schedule requested [1/s]."""
    gain_used: Annotated[np.ndarray, _column("gain_used_1_s")]
    """(N,) K after the gain limit, mean over the sub-steps [1/s]."""
    error: Annotated[np.ndarray, _column("scaled_error")]
    """(N,) the schedule's input scaled error, in [0, 1]."""
    rate: Annotated[np.ndarray, _column("scaled_rate")]
    """(N,) the schedule's input scaled rate, in [0, 1]."""
    vector_bias_est: Annotated[
        np.ndarray, _column("bias_est_v#_x", "bias_est_v#_y", "bias_est_v#_z", each=True)
    ]
    """(N, 3 n) estimated biases of n vectors, body frame, in their unit; n may be 0."""
    attitude_parts: Annotated[
        np.ndarray, _column("attitude_error_x_deg", "attitude_error_y_deg", "attitude_error_z_deg")
    ]
    """(N, 3) attitude error theta by axis of the body, R = R_est exp(theta^) [deg]."""
    attitude_sigma: Annotated[
        np.ndarray, _column("attitude_sigma_x_deg", "attitude_sigma_y_deg", "attitude_sigma_z_deg")
    ]
    """(N, 3) its standard deviations by the filter's covariance [deg]; NaN without one."""
    position_sigma: Annotated[
        np.ndarray, _column("position_sigma_x_m", "position_sigma_y_m", "position_sigma_z_m")
    ]
    """(N, 3) standard deviations of the estimated position, inertial frame [m]; NaN without one."""
    vector_bias_error: Annotated[np.ndarray, _column("bias_error_v#", each=True)]
    """(N, n) distances of these biases from the true ones, in the vectors' unit."""

    @property
    def lost(self) -> float | None:
        """Time from which the estimated pose is not finite [s]; None if it always is."""
        off = ~(np.isfinite(self.attitude_error) & np.isfinite(self.distance))
        return float(self.time[np.argmax(off)]) if off.any() else None


def trajectory(
    rotation: ArrayLike, position: ArrayLike, estimates: Estimates, vector_bias: ArrayLike
) -> Trajectory:
    """Errors and angles of estimates against the truth.

    Args:
        rotation: (N, 3, 3) true R, body to inertial.
        position: (N, 3) true P [m], inertial frame.
        estimates: A filter's estimates at the same N samples.
        vector_bias: (n, 3) true biases of the vectors, body frame.
    """
    values = _values(rotation, position, estimates, vector_bias)
    return Trajectory(
        **{name: decimal(np.asarray(value)).astype(np.float64) for name, value in values.items()}
    )


def trajectory_on(candidate: Candidate, batch: ScenarioBatch, index: int) -> Trajectory:
    """The trajectory of a candidate on one scenario of a batch."""
    truth, vector_bias = jax.tree.map(
        lambda a: np.asarray(a)[index], (batch.samples.truth, batch.vector_bias)
    )
    R, P = _pose(known_pose(truth))
    return trajectory(R, P, estimates_on(candidate, batch, index), vector_bias)


@jax.jit
def _pose(truth: TruePose) -> tuple[Array, Array]:
    """True R (N, 3, 3) and P (N, 3) [m], inertial frame."""
    R = rotation_matrix(stack(truth.attitude))
    # The simulation stores P as R^T P, in the body frame.
    return R, jnp.einsum("nij,nj->ni", R, stack(truth.origin), precision="highest")


@jax.jit
def _values(
    rotation: ArrayLike, position: ArrayLike, estimates: Estimates, vector_bias: ArrayLike
) -> dict[str, Array]:
    R, P = (jnp.asarray(a, estimates.time.dtype) for a in (rotation, position))
    w_est, x_est, y_est, z_est = unstack(quaternion(estimates.rotation))
    w, x, y, z = unstack(quaternion(R))
    distance = attitude_distance((w_est, x_est, y_est, z_est), (w, x, y, z))
    R_err = jnp.einsum("nij,nkj->nik", estimates.rotation, R, precision="highest")
    P_err = estimates.position - jnp.einsum("nij,nj->ni", R_err, P, precision="highest")
    zero = jnp.zeros_like(w)
    theta, _ = log(compose((w_est, -x_est, -y_est, -z_est), (w, x, y, z)), (zero, zero, zero))
    sigmas = _sigmas(estimates)
    estimated = estimates.vector_bias
    N, n, _ = estimated.shape
    true = jnp.broadcast_to(jnp.asarray(vector_bias, estimated.dtype)[None, :n], estimated.shape)
    return {
        "vector_bias_est": estimated.reshape(N, 3 * n),
        "vector_bias_error": jnp.linalg.norm(estimated - true, axis=-1),
        "time": estimates.time,
        "euler": jnp.degrees(euler_angles(R)),
        "euler_est": jnp.degrees(euler_angles(estimates.rotation)),
        "position": P,
        "position_est": estimates.position,
        "bias_est": estimates.bias,
        "attitude_error": jnp.degrees(rotation_angle(distance)),
        "attitude_distance": clip_distance(distance),
        "position_error": jnp.linalg.norm(P_err, axis=-1),
        "distance": jnp.linalg.norm(estimates.position - P, axis=-1),
        "attitude_parts": jnp.degrees(stack(theta)),
        "attitude_sigma": jnp.degrees(sigmas[0]),
        "position_sigma": sigmas[1],
        "gain": estimates.gain,
        "gain_used": estimates.gain_used,
        "error": estimates.error,
        "rate": estimates.rate,
    }


def _sigmas(estimates: Estimates) -> tuple[Array, Array]:
    """Standard deviations (N, 3) of attitude and position; NaN for a filter without a covariance.

    The attitude's are in the body frame [rad], the position's in the inertial frame [m].
    """
    if estimates.covariance is None:
        unknown = jnp.full_like(estimates.position, jnp.nan)
        return unknown, unknown
    theta = jnp.diagonal(estimates.covariance[:, :3, :3], axis1=1, axis2=2)
    R, rho = estimates.rotation, estimates.covariance[:, 3:, 3:]
    return jnp.sqrt(theta), jnp.sqrt(jnp.einsum("nij,njk,nik->ni", R, rho, R, precision="highest"))
