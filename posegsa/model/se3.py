"""Rotations and rigid motions of SE(3), and the conventions of the whole package.

Conventions (stated here once):
    * Frames: I inertial, B body. A rotation R maps body to inertial coordinates and P is the body's
      position in I; together they are the pose T = (R, P).
    * Tangent vectors are rotation first, xi = [omega; v] in rad and m, and act from the right (body
      side): T <- T exp([xi]^).
    * A rotation is carried as a unit quaternion (w, x, y, z), Hamilton product, the rotation of the
      matrix R above. It is 4 numbers instead of 9, costs fewer operations to compose, and its only
      rounding error, a norm that is not 1, is removed at every composition.

The module has two forms of the same mathematics. The *component* form takes and returns tuples of
arrays, one array per coordinate, of any common batch shape: XLA fuses a loop body in this form into
one vectorised kernel; with 3x3 matrices and stacks it is ten times slower. The *array* form, for
users and for work outside the hot loop, takes and returns arrays whose last axes are coordinates.
"""

import math
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.model.elementwise import choose

Vec3: TypeAlias = tuple[Array, Array, Array]
"""Three coordinates, each an array of the same batch shape."""
Quaternion: TypeAlias = tuple[Array, Array, Array, Array]
"""Unit quaternion (w, x, y, z), each an array of the same batch shape."""
Matrix3: TypeAlias = tuple[Vec3, Vec3, Vec3]
"""Three rows of a 3x3 matrix."""

SERIES_BELOW = 1.0
"""Squared angle [rad^2] below which (t - sin t)/t^3 is computed by its Taylor series. At 1 rad
cancellation in the closed form (1 - sin(t)/t)/t^2 amplifies rounding only by a factor of 6."""
TURN = 6.28125, 2 * math.pi - 6.28125
"""2 pi in two parts; multiples of the first are exact up to 2^17 turns in float32."""


# --- component form: vectors ---


def add(a: Vec3, b: Vec3) -> Vec3:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vec3, b: Vec3) -> Vec3:
    """Difference a - b of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(s: Array | float, a: Vec3) -> Vec3:
    """Product of a scalar and a vector."""
    return s * a[0], s * a[1], s * a[2]


def dot(a: Vec3, b: Vec3) -> Array:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def safe_sqrt(square: Array) -> Array:
    """Square root whose derivative at 0 is 0 instead of infinite (the norm's subgradient)."""
    positive = square > 0
    return choose(positive, jnp.sqrt(choose(positive, square, 1.0)), 0.0)


def norm(a: Vec3) -> Array:
    """Euclidean length, differentiable at 0."""
    return safe_sqrt(dot(a, a))


def unit(a: Vec3) -> Vec3:
    """The vector a / |a|; 0, with finite derivatives, if a is 0, as that of a missing vector is."""
    square = dot(a, a)
    return scale(choose(square > 0, jax.lax.rsqrt(choose(square > 0, square, 1.0)), 0.0), a)


# --- component form: rotations and motions ---


def rows(q: Quaternion) -> Matrix3:
    """Rows of the rotation matrix R of a unit quaternion."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def rotate(R: Matrix3, a: Vec3) -> Vec3:
    """R a: body to inertial."""
    return dot(R[0], a), dot(R[1], a), dot(R[2], a)


def unrotate(R: Matrix3, a: Vec3) -> Vec3:
    """R^T a: inertial to body."""
    return add(add(scale(a[0], R[0]), scale(a[1], R[1])), scale(a[2], R[2]))


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p q: the matrix product of the rotations."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def compose(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p q, brought back to unit length.

    One Newton step for 1/|pq| around 1 squares the error of the norm. So the norm stays 1 to
    rounding over any number of steps, without a square root or a division.
    """
    w, x, y, z = product(p, q)
    inverse_norm = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return w * inverse_norm, x * inverse_norm, y * inverse_norm, z * inverse_norm


def exp_coefficients(angle_squared: Array) -> tuple[Array, Array, Array, Array]:
    """Coefficients of the exponential of SE(3) at the angle t, from t^2.

    Args:
        angle_squared: t^2 = |omega|^2 [rad^2], any shape.

    Returns:
        cos(t/2), sin(t/2)/t, (1 - cos t)/t^2 and (t - sin t)/t^3, each of the same shape. Values
        and derivatives are finite everywhere, 0 included; the relative error is a few units of
        rounding.
    """
    single = jnp.finfo(angle_squared.dtype).bits <= 32

    def series(square: Array, first: int, terms: int) -> Array:
        """sum_n (-square)^n / (2n + first)! up to n = terms, by Horner's rule."""
        value = jnp.full_like(square, 1 / math.factorial(2 * terms + first))
        for n in range(terms - 1, -1, -1):
            value = 1 / math.factorial(2 * n + first) - square * value
        return value

    # First remove whole turns, with 2 pi in two parts (Cody and Waite), so that half the remainder
    # is within pi/2. There one series suffices; library sine and cosine cost four times as much.
    # A branch that is not taken gets a safe argument: its NaN or overflow would otherwise reach the
    # derivative.
    far = angle_squared > math.pi**2
    safe = choose(far, angle_squared, math.pi**2)
    angle = jnp.sqrt(safe)
    turns = jnp.floor(angle * (0.5 / math.pi) + 0.5)
    rest = (angle - turns * TURN[0]) - turns * TURN[1]
    sign = 1 - 2 * (turns - 2 * jnp.floor(0.5 * turns))  # -1 for an odd number of turns
    quarter = 0.25 * choose(far, rest * rest, angle_squared)
    # Enough terms that the first omitted one is below rounding at pi/2 and at SERIES_BELOW.
    small = angle_squared < SERIES_BELOW
    # One division serves both: by the squared angle, and by the angle where it is large.
    per_square = 1 / choose(small, 1.0, angle_squared)
    half_cos = choose(far, sign, 1.0) * series(quarter, 0, 6 if single else 10)
    half_sinc = series(quarter, 1, 6 if single else 10) * choose(
        far, 0.5 * sign * rest * (angle * per_square), 0.5
    )
    one_minus_cos = 2 * half_sinc * half_sinc
    sinc = 2 * half_sinc * half_cos
    t2 = choose(small, angle_squared, 0.0)
    closed = (1 - sinc) * per_square
    t_minus_sin = choose(small, series(t2, 3, 5 if single else 9), closed)
    return half_cos, half_sinc, one_minus_cos, t_minus_sin


def move(q: Quaternion, P: Vec3, omega: Vec3, v: Vec3) -> tuple[Quaternion, Vec3]:
    """T exp([omega; v]^): the pose after the body-frame displacement [omega; v] (rad, m).

    Exact for a constant twist: R exp([omega]x) and P + R V(omega) v with
    V = I + (1 - cos t)/t^2 [omega]x + (t - sin t)/t^3 [omega]x^2.
    """
    return displaced(q, P, omega, v, exp_coefficients(dot(omega, omega)))


def displaced(
    q: Quaternion, P: Vec3, omega: Vec3, v: Vec3, coefficients: tuple[Array, Array, Array, Array]
) -> tuple[Quaternion, Vec3]:
    """`move` with the coefficients of the exponential at |omega|^2 (`exp_coefficients`)."""
    half_cos, half_sinc, b, c = coefficients
    turned = cross(omega, v)
    displacement = add(v, add(scale(b, turned), scale(c, cross(omega, turned))))
    x, y, z = scale(half_sinc, omega)
    return compose(q, (half_cos, x, y, z)), add(P, rotate(rows(q), displacement))


def velocity_to(omega: Vec3, displacement: Vec3) -> Vec3:
    """The v with V(omega) v = displacement, so that exp([omega; v]^) moves by it (rad, m).

    V^-1 = I - 1/2 [omega]x + c [omega]x^2, c = (1 - t/2 cot t/2) / t^2, t = |omega| < 2 pi.
    """
    t2 = dot(omega, omega)
    small = t2 < 0.01
    series = 1 / 12 + t2 * (1 / 720 + t2 * (1 / 30240))
    half = 0.5 * jnp.sqrt(choose(small, jnp.ones_like(t2), t2))
    closed = (1 - half / jnp.tan(half)) / (4 * half * half)
    turned = cross(omega, displacement)
    twice = scale(choose(small, series, closed), cross(omega, turned))
    return add(subtract(displacement, scale(0.5, turned)), twice)


def log(q: Quaternion, P: Vec3) -> tuple[Vec3, Vec3]:
    """[theta; rho] of the pose (q, P) = exp([theta; rho]^), |theta| <= pi (rad, m)."""
    sign = choose(q[0] < 0, -jnp.ones_like(q[0]), 1.0)
    w, axis = sign * q[0], scale(sign, (q[1], q[2], q[3]))
    sine = norm(axis)
    turned = sine > 0
    angle = 2 * jnp.arctan2(sine, w)
    theta = scale(choose(turned, angle / choose(turned, sine, 1.0), 2.0), axis)
    # rho = V^-1 P with V^-1 = I - 1/2 [theta]x + c [theta]x^2, c = (1 - t/2 cot t/2) / t^2.
    t2 = dot(theta, theta)
    small = t2 < 0.01
    series = 1 / 12 + t2 * (1 / 720 + t2 * (1 / 30240))
    closed = (1 - 0.5 * angle * w / choose(small, 1.0, sine)) / choose(small, 1.0, t2)
    once = cross(theta, P)
    twice = scale(choose(small, series, closed), cross(theta, once))
    return theta, add(subtract(P, scale(0.5, once)), twice)


def attitude_distance(q_est: Quaternion, q: Quaternion) -> Array:
    """||R_est R^T||_I = (1/4) tr(I - R_est R^T), in [0, 1] but for rounding.

    Near half a turn it may be a few units of rounding above 1. It is not clipped here, because
    that changes how XLA rounds other sums of the hot loop; use `clip_distance` after the loop.

    Computed as |q_est - q|^2 |q_est + q|^2 / 4, which is equal for unit quaternions and keeps its
    relative accuracy near 0, where the trace cancels.
    """
    near = sum((a - b) ** 2 for a, b in zip(q_est, q, strict=True))
    far = sum((a + b) ** 2 for a, b in zip(q_est, q, strict=True))
    return jnp.asarray(0.25 * near * far)


# --- array form ---


def unstack(a: Array) -> tuple[Array, ...]:
    """Components of an array (..., n): n arrays of shape (...)."""
    return tuple(a[..., i] for i in range(a.shape[-1]))


def vec3(a: Array) -> Vec3:
    """Components of an array (..., 3)."""
    x, y, z = unstack(a)
    return x, y, z


def stack(components: tuple[Array, ...]) -> Array:
    """Array (..., n) of n components, the inverse of `unstack`."""
    return jnp.stack(jnp.broadcast_arrays(*components), axis=-1)


def rotation_matrix(quaternion: Array) -> Array:
    """R (..., 3, 3) of unit quaternions (..., 4), (w, x, y, z)."""
    w, x, y, z = unstack(quaternion)
    return jnp.stack([stack(row) for row in rows((w, x, y, z))], axis=-2)


def quaternion(R: Array) -> Array:
    """Unit quaternion (..., 4), w >= 0, of rotation matrices R (..., 3, 3).

    All four of Shepperd's forms are computed and the one with the largest divisor is used, so no
    rotation is near a singularity (S. W. Shepperd, J. Guidance and Control 1(3), 1978).
    """
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    x_, y_, z_ = (R[..., i, j] - R[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    xy, xz, yz = (R[..., i, j] + R[..., j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    candidates = jnp.stack(
        [
            stack((1 + xx + yy + zz, x_, y_, z_)),
            stack((x_, 1 + xx - yy - zz, xy, xz)),
            stack((y_, xy, 1 - xx + yy - zz, yz)),
            stack((z_, xz, yz, 1 - xx - yy + zz)),
        ],
        axis=-2,
    )
    diagonal = jnp.diagonal(candidates, axis1=-2, axis2=-1)
    index = jnp.argmax(diagonal, axis=-1)[..., None, None]
    best = jnp.squeeze(jnp.take_along_axis(candidates, index, axis=-2), axis=-2)
    unit = best / jnp.linalg.norm(best, axis=-1, keepdims=True)
    return jnp.where(unit[..., :1] < 0, -unit, unit)


def exp(xi: Array) -> Array:
    """The exponential (..., 4, 4) of tangent vectors xi = [omega; v] (..., 6) (rad, m)."""
    wx, wy, wz, vx, vy, vz = unstack(xi)
    one, zero = jnp.ones_like(wx), jnp.zeros_like(wx)
    q, P = move((one, zero, zero, zero), (zero, zero, zero), (wx, wy, wz), (vx, vy, vz))
    return transform(rotation_matrix(stack(q)), stack(P))


def transform(R: Array, P: Array) -> Array:
    """Homogeneous matrices T (..., 4, 4) of R (..., 3, 3) and P (..., 3) [m]."""
    top = jnp.concatenate([R, P[..., None]], axis=-1)
    bottom = jnp.broadcast_to(jnp.eye(4, dtype=top.dtype)[3:], (*top.shape[:-2], 1, 4))
    return jnp.concatenate([top, bottom], axis=-2)


def euler_angles(R: Array) -> Array:
    """Roll, pitch and yaw (..., 3) [rad], the paper's (phi, theta, psi).

    R = Rz(yaw) Ry(pitch) Rx(roll). Pitch is in [-pi/2, pi/2]; at exactly +-pi/2 only yaw -+ roll is
    defined, and roll is set to 0.
    """
    roll = jnp.arctan2(R[..., 2, 1], R[..., 2, 2])
    pitch = jnp.arctan2(-R[..., 2, 0], jnp.hypot(R[..., 2, 1], R[..., 2, 2]))
    # From R without its roll, which defines the yaw at every pitch.
    sine, cosine = jnp.sin(roll), jnp.cos(roll)
    yaw = jnp.arctan2(
        sine * R[..., 0, 2] - cosine * R[..., 0, 1], cosine * R[..., 1, 1] - sine * R[..., 1, 2]
    )
    return jnp.stack([roll, pitch, yaw], axis=-1)


def clip_distance(distance: Array) -> Array:
    """Distances ||R_err||_I (...) with those above 1 set to 1; NaN stays NaN."""
    return jnp.minimum(distance, 1.0)


def rotation_angle(distance: Array) -> Array:
    """Angle [rad] of a rotation error from its distance ||R_err||_I = sin^2(angle/2)."""
    return 2 * jnp.arcsin(safe_sqrt(jnp.clip(distance, 0.0, 1.0)))


def project_rotation(A: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) nearest to A (3, 3) in the Frobenius norm, by SVD (on the host, in float64).

    Raises:
        ValueError: A is singular or its determinant is negative, so no rotation is near it.
    """
    A = np.asarray(A, dtype=np.float64)
    U, singular, Vt = np.linalg.svd(A)
    if singular[-1] <= 1e-9 or np.linalg.det(A) <= 0:
        raise ValueError(
            f"no rotation is near {A.tolist()}: its determinant is {np.linalg.det(A):.3g}"
        )
    return U @ Vt


def random_rotation(key: Array, angle: Array) -> Array:
    """Rotation matrix (3, 3) about a uniformly random axis by `angle` (scalar, rad)."""
    axis = jax.random.normal(key, (3,), jnp.float32).astype(angle.dtype)
    omega = angle * axis / jnp.linalg.norm(axis)
    return exp(jnp.concatenate([omega, jnp.zeros_like(omega)]))[:3, :3]
