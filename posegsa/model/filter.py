"""One step of the nonlinear pose observer on SE(3).

symbol | meaning                              | here                    | shape  | unit, frame
------ | ------------------------------------ | ----------------------- | ------ | ----------------
R, P   | attitude and position, T = (R, P)    | `signal.TruePose`       | 3x3, 3 | B to I; m, I
T_est  | their estimate (a hat in the paper)  | `FilterState`           | 4, 3   | quaternion; m, I
b_est  | estimate of the velocity's bias      | `FilterState`           | 3, 3   | rad/s, m/s, B
Y_m    | measured [Omega_m; V_m]              | `Sample`                | 3, 3   | rad/s, m/s, B
v_i    | a vector, measured in B, known in I  | `Sample.profile`        | 3      | 1, B and I
y_i    | a landmark as seen from the body     | `landmarks[i].body`     | 3      | m, B
p_i    | its known position                   | `landmarks[i].inertial` | 3      | m, I
s_i    | weight of a vector (R), landmark (L) | `weight`                | -      | 1 (R), 1/m^2 (L)
x_i    | T_est y_i                            | `seen_from_estimate`    | 3      | m, I
U      | innovation [u_1; u_2]                | `Innovation`            | 3, 3   | 1, 1/m; I
W      | correction of the body velocity      | `Correction`            | 3, 3   | as U; B
K      | gain                                 | `gain`                  | -      | 1/s
gamma  | gains of the bias law, for both      | `FilterSettings`        | 2      | 1/s^2
L      | curvature: K dt L < 2 is stable      | `Innovation.curvature`  | -      | 1
c      | gain limit, K <= c / (dt L)          | `gain_limit`            | -      | 1
n      | sub-steps in a sample                | `substeps`              | -      | 1

The observer (Eq. 9 of the paper, after Hua et al. 2011, "Observer design on the special Euclidean
group SE(3)", IEEE Conference on Decision and Control):
    U = 1/2 sum_i s_i^L (T_est y_i) ^ p_i + 1/2 sum_i s_i^R (R_est v_i^B) ^ v_i^I
    dT_est/dt = T_est [Y_m - b_est + K W]^
    law "gradient":  W = Ad(T_est^-1) U,  db_est/dt = -gamma Ad(T_est)^T U
    law "printed":   W = Ad(T_est)^T U,   db_est/dt = -gamma Ad(T_est^-1) U
The paper prints the second. With the first, the spatial velocity error is K U - Ad(T_est) b_err and
the cost's derivative -K |U|^2: it is the law for which the observer's Lyapunov argument holds.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from posegsa.arguments import check_type, fitting
from posegsa.errors import MeasurementError
from posegsa.model.elementwise import choose, minimum
from posegsa.model.measurements import Measurements, Sample, finite_array, numeric_array, prepare
from posegsa.model.se3 import (
    Matrix3,
    Quaternion,
    Vec3,
    add,
    cross,
    dot,
    move,
    quaternion,
    rotate,
    rotation_matrix,
    rows,
    safe_sqrt,
    scale,
    stack,
    subtract,
    unrotate,
    unstack,
)

Law = Literal["gradient", "printed"]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["gamma_angular", "gamma_linear", "gain_limit"],
    meta_fields=["law", "substeps"],
)
@dataclass(frozen=True)
class FilterSettings:
    """How a step is made. `law` and `substeps` are structure; the numbers are traced."""

    law: Law
    substeps: int
    """n, inner steps per sample."""
    gamma_angular: Array
    """gamma of the angular velocity's bias [1/s^2]."""
    gamma_linear: Array
    """gamma of the linear velocity's bias [1/s^2]."""
    gain_limit: Array
    """c; infinite for no limit."""


class FilterState(NamedTuple):
    """The estimate, by components of any common batch shape."""

    attitude: Quaternion
    """R_est."""
    place: Vec3
    """P_est [m], inertial frame."""
    bias_angular: Vec3
    """b_est of the angular velocity [rad/s], body frame."""
    bias_linear: Vec3
    """b_est of the linear velocity [m/s], body frame."""

    @property
    def rotation(self) -> Array:
        """R_est (..., 3, 3), body to inertial."""
        return rotation_matrix(stack(self.attitude))

    @property
    def position(self) -> Array:
        """P_est (..., 3) [m], inertial frame."""
        return stack(self.place)

    @property
    def bias(self) -> Array:
        """b_est (..., 6) [rad/s, m/s], body frame, angular first."""
        return stack(self.bias_angular + self.bias_linear)


class Innovation(NamedTuple):
    """U = [u_1; u_2] and the curvature bound L of the cost whose gradient it is."""

    angular: Vec3
    linear: Vec3
    curvature: Array


class Correction(NamedTuple):
    """W and the bias' rate, both in the body frame."""

    angular: Vec3
    linear: Vec3
    bias_angular: Vec3
    bias_linear: Vec3


def initial_state(
    rotation: ArrayLike, position: ArrayLike, bias: ArrayLike | None = None
) -> FilterState:
    """Filter state from arrays.

    Args:
        rotation: (..., 3, 3) R_est, body to inertial; a rotation (see `se3.project_rotation`).
        position: (..., 3) P_est [m], inertial frame.
        bias: (..., 6) b_est [rad/s, m/s], angular first; zeros by default.

    Raises:
        MeasurementError: wrong shape or no numbers; names the argument.
    """
    batch = np.shape(position)[:-1]
    numeric_array("rotation", rotation, (*batch, 3, 3))
    numeric_array("position", position, (*batch, 3))
    if bias is None:
        bias = np.zeros((*batch, 6), int)  # so that it leaves the floating type to the others
    numeric_array("bias", bias, (*batch, 6))
    dtype = _floating(rotation, position, bias)
    R, P, b = (jnp.asarray(a).astype(dtype) for a in (rotation, position, bias))
    w, x, y, z = unstack(quaternion(R))
    px, py, pz = unstack(P)
    b0, b1, b2, b3, b4, b5 = unstack(b)
    return FilterState(
        attitude=(w, x, y, z),
        place=(px, py, pz),
        bias_angular=(b0, b1, b2),
        bias_linear=(b3, b4, b5),
    )


def _floating(*values: ArrayLike) -> DTypeLike:
    """The widest floating type among arrays, and at least JAX's default."""
    dtypes = [jnp.asarray(a).dtype for a in values]
    return jnp.result_type(float, *(d for d in dtypes if jnp.issubdtype(d, jnp.floating)))


def checked_state(
    rotation: ArrayLike, position: ArrayLike, bias: ArrayLike | None, dtype: DTypeLike
) -> FilterState:
    """One filter state from a user's arrays, checked (on the host, not inside jit).

    Args:
        rotation: (3, 3) R_est, body to inertial; orthonormal to 1e-3.
        position: (3,) P_est [m], inertial frame.
        bias: (6,) b_est [rad/s, m/s], angular first; None for zeros.
        dtype: floating type of the state.

    Raises:
        MeasurementError: wrong shape, not finite, or not a rotation; names the argument.
    """
    R = finite_array("rotation", rotation, (3, 3))
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise MeasurementError(
            f"rotation: must be a rotation (se3.project_rotation makes one), got {R.tolist()}"
        )
    P = finite_array("position", position, (3,))
    b = np.zeros(6) if bias is None else finite_array("bias", bias, (6,))
    return initial_state(*(jnp.asarray(a, dtype) for a in (R, P, b)))


def seen_from_estimate(state: FilterState, R: Matrix3, sample: Sample) -> tuple[Vec3, ...]:
    """x_i = T_est y_i, where the estimate puts each landmark [m, inertial frame]."""
    return tuple(add(rotate(R, landmark.body), state.place) for landmark in sample.landmarks)


def innovation(state: FilterState, sample: Sample) -> Innovation:
    """U (Eq. 9) and L.

    The vectors' part of u_1 is the antisymmetric part of R_est B, since (R v^B) x v^I is that of
    (R v^B)(v^I)^T. U is minus the gradient of
        f = 1/4 sum s_i^L |x_i - p_i|^2 + 1/4 sum s_i^R |R_est v_i^B - v_i^I|^2,
    and L bounds its Hessian:
        L = 1/2 sum s_i^R |v_i^B||v_i^I|
          + 1/4 sum s_i^L [1 + |x_i||p_i| + sqrt((1 + |x_i|^2)(1 + |p_i|^2))].
    """
    R = rows(state.attitude)
    columns = tuple(zip(*sample.profile, strict=True))
    # (R B)_ij is row i of R times column j of B; only the six off the diagonal are needed.
    u1: Vec3 = (
        dot(R[1], columns[2]) - dot(R[2], columns[1]),
        dot(R[2], columns[0]) - dot(R[0], columns[2]),
        dot(R[0], columns[1]) - dot(R[1], columns[0]),
    )
    zero = jnp.zeros_like(state.place[0])
    u2: Vec3 = (zero, zero, zero)
    curvature = sample.vector_curvature
    for x, landmark in zip(seen_from_estimate(state, R, sample), sample.landmarks, strict=True):
        p = landmark.inertial
        u1 = add(u1, scale(landmark.weight, cross(x, p)))
        u2 = add(u2, scale(landmark.weight, subtract(p, x)))
        x2, p2 = dot(x, x), dot(p, p)
        product = safe_sqrt(x2 * p2) + jnp.sqrt((1 + x2) * (1 + p2))
        curvature = curvature + 0.25 * landmark.weight * (1 + product)
    return Innovation(scale(0.5, u1), scale(0.5, u2), curvature)


def correction(state: FilterState, U: Innovation, settings: FilterSettings) -> Correction:
    """W and db_est/dt of the law (Eq. 9, and the module's head)."""
    R, P = rows(state.attitude), state.place
    # Ad(T^-1) U = [R^T u_1; R^T (u_2 - P x u_1)],  Ad(T)^T U = [R^T (u_1 - P x u_2); R^T u_2].
    inverse = unrotate(R, U.angular), unrotate(R, subtract(U.linear, cross(P, U.angular)))
    transpose = unrotate(R, subtract(U.angular, cross(P, U.linear))), unrotate(R, U.linear)
    W, bias = (inverse, transpose) if settings.law == "gradient" else (transpose, inverse)
    return Correction(
        *W, scale(-settings.gamma_angular, bias[0]), scale(-settings.gamma_linear, bias[1])
    )


def observe(
    state: FilterState, sample: Sample, gain: Array, settings: FilterSettings
) -> tuple[FilterState, Array]:
    """One sample, by components: n sub-steps with the measurement held (pure, no arrays packed).

    Each sub-step makes the correction and the bias law last dt/n; the measured velocity moves the
    estimate over the whole dt in the last one only, because an estimate moved against a held
    measurement is biased (1.1 cm with n = 2 on the paper's scenario).

    Args:
        state: estimate at the sample.
        sample: what was measured there.
        gain: K [1/s], of the batch shape.
        settings: law, sub-steps, gamma, gain limit.

    Returns:
        The estimate at the next sample, and the mean gain used in the sub-steps after the limit.
    """
    n = settings.substeps
    h = sample.time_step / n
    used_total = jnp.zeros_like(gain)
    for j in range(n):
        U = innovation(state, sample)
        W = correction(state, U, settings)
        # K h L <= c < 2: a gradient step that does not overshoot. Without measurements L is 0,
        # without a limit that is infinite: then neither a value nor a derivative comes from them.
        length = h * U.curvature
        limited = (length > 0) & jnp.isfinite(settings.gain_limit)
        limit = choose(limited, settings.gain_limit, 1.0) / choose(limited, length, 1.0)
        used = choose(limited, minimum(gain, limit), gain)
        used_total = used_total + used
        omega, v = scale(used * h, W.angular), scale(used * h, W.linear)
        if j == n - 1:
            dt = sample.time_step
            omega = add(omega, scale(dt, subtract(sample.angular_velocity, state.bias_angular)))
            v = add(v, scale(dt, subtract(sample.velocity, state.bias_linear)))
        attitude, place = move(state.attitude, state.place, omega, v)
        state = FilterState(
            attitude,
            place,
            add(state.bias_angular, scale(h, W.bias_angular)),
            add(state.bias_linear, scale(h, W.bias_linear)),
        )
    return state, used_total / n


def step(
    state: FilterState, measurement: Measurements, gain: ArrayLike, settings: FilterSettings
) -> FilterState:
    """One sample, for use on-line: the estimate at the next sample from one measurement.

    Args:
        state: current estimate (`initial_state`).
        measurement: one sample, without a time axis (`measurements.at(k)`).
        gain: K [1/s], scalar, e.g. from `FuzzyController`.
        settings: from `posegsa.filter_settings(section)`, or made by hand.

    Raises:
        ArgumentError: an argument is of another type, or they do not fit together.
    """
    check_type("state", state, FilterState)
    check_type("measurement", measurement, Measurements)
    check_type("settings", settings, FilterSettings)
    with fitting("step"):
        return _step(state, measurement, gain, settings)


@jax.jit
def _step(
    state: FilterState, measurement: Measurements, gain: ArrayLike, settings: FilterSettings
) -> FilterState:
    K = jnp.asarray(gain, state.place[0].dtype)
    return observe(state, prepare(measurement), K, settings)[0]
