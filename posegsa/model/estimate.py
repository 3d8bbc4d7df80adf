"""The estimate of a filter at one sample, by components, and how to make it from arrays."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from posegsa.errors import MeasurementError
from posegsa.model.measurements import finite_array, numeric_array
from posegsa.model.se3 import Quaternion, Vec3, quaternion, rotation_matrix, stack, unstack


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
    vector_biases: tuple[Vec3, ...] = ()
    """c_i of each vector, body frame, in its unit; () if they are not estimated."""
    turning: Vec3 | tuple[()] = ()
    """Low-passed measured angular velocity [rad/s], body frame; () if it is not needed."""

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

    @property
    def vector_bias(self) -> Array:
        """c_i (..., n, 3) of n vectors, body frame; n is 0 if they are not estimated."""
        if not self.vector_biases:
            return jnp.zeros((*self.place[0].shape, 0, 3), self.place[0].dtype)
        return jnp.stack([stack(c) for c in self.vector_biases], axis=-2)


def initial_state(
    rotation: ArrayLike,
    position: ArrayLike,
    bias: ArrayLike | None = None,
    *,
    learnt_vectors: int = 0,
) -> FilterState:
    """Filter state from arrays.

    Args:
        rotation: (..., 3, 3) R_est, body to inertial; a rotation (see `se3.project_rotation`).
        position: (..., 3) P_est [m], inertial frame.
        bias: (..., 6) b_est [rad/s, m/s], angular first; zeros by default.
        learnt_vectors: number of vectors whose biases are estimated; the estimates start at 0.

    Raises:
        MeasurementError: wrong shape, or not numbers; the message names the argument.
    """
    batch = np.shape(position)[:-1]
    numeric_array("rotation", rotation, (*batch, 3, 3))
    numeric_array("position", position, (*batch, 3))
    if bias is None:
        bias = np.zeros((*batch, 6), int)  # the other arrays decide the type
    numeric_array("bias", bias, (*batch, 6))
    dtype = _floating(rotation, position, bias)
    R, P, b = (jnp.asarray(a).astype(dtype) for a in (rotation, position, bias))
    w, x, y, z = unstack(quaternion(R))
    px, py, pz = unstack(P)
    b0, b1, b2, b3, b4, b5 = unstack(b)
    zero = jnp.zeros_like(px)
    zeros: Vec3 = (zero, zero, zero)
    return FilterState(
        attitude=(w, x, y, z),
        place=(px, py, pz),
        bias_angular=(b0, b1, b2),
        bias_linear=(b3, b4, b5),
        vector_biases=(zeros,) * learnt_vectors,
        turning=zeros if learnt_vectors else (),
    )


def _floating(*values: ArrayLike) -> DTypeLike:
    """The widest floating type among arrays, and at least JAX's default."""
    dtypes = [jnp.asarray(a).dtype for a in values]
    floating = [d for d in dtypes if jnp.issubdtype(d, jnp.floating)]
    with jax.numpy_dtype_promotion("standard"):
        return jnp.result_type(float, *floating)


def checked_state(
    rotation: ArrayLike,
    position: ArrayLike,
    bias: ArrayLike | None,
    dtype: DTypeLike,
) -> FilterState:
    """One filter state from a user's arrays, checked (on the host, not inside jit).

    Args:
        rotation: (3, 3) R_est, body to inertial; orthonormal to 1e-3.
        position: (3,) P_est [m], inertial frame.
        bias: (6,) b_est [rad/s, m/s], angular first; None for zeros.
        dtype: floating type of the state.

    Raises:
        MeasurementError: an argument has the wrong shape, is not finite, or is not a rotation.
    """
    R = finite_array("rotation", rotation, (3, 3))
    with np.errstate(over="ignore", invalid="ignore"):
        rotates = np.abs(R @ R.T - np.eye(3)).max() <= 1e-3 and np.linalg.det(R) > 0
    if not rotates:
        raise MeasurementError(
            f"rotation: must be a rotation (se3.project_rotation makes one), got {R.tolist()}"
        )
    P = finite_array("position", position, (3,))
    b = np.zeros(6) if bias is None else finite_array("bias", bias, (6,))
    arrays = (jnp.asarray(a, dtype) for a in (R, P, b))
    return initial_state(*arrays)
