"""The start from sensors: the pose that fits the first sample whose measurements fix one."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.model.measurements import Measurements

INDEPENDENT = 1e-3
"""Directions fix an attitude if the sum of squared sines between them is at least this."""
WAITING = 1e-6
"""Factor on the time steps before the start: nothing moves, and nothing is divided by 0."""
REST = 1.0
"""Time after the start over which the velocities are averaged, if the body is at rest [s]."""


class FirstPose(NamedTuple):
    """The start of an estimate that is made from the sensors alone."""

    sample: Array
    """Index of the first sample that fixes a pose; N if none does."""
    rotation: Array
    """(3, 3) R_est, body to inertial."""
    position: Array
    """(3,) P_est [m], inertial frame."""


def first_pose(measurements: Measurements) -> FirstPose:
    """The pose that fits the first sample whose measurements fix one (pure, jittable).

    A sample fixes a pose if it has a landmark, and two directions that are not collinear: of
    vectors, and from the landmarks' centre to each of them. The attitude solves Wahba's problem for
    these, all normalised (F. L. Markley, "Attitude determination using vector observations and the
    singular value decomposition", 1988); the position follows from the landmarks.

    Args:
        measurements: N samples.
    """
    m = measurements
    of_vectors, of_landmarks = (
        (a > 0).astype(m.time_step.dtype) for a in (m.vector_weights, m.landmark_weights)
    )
    known = jnp.concatenate(
        [_unit(m.vector_references), _unit(_centred(m.landmark_references, of_landmarks))], axis=1
    )
    seen = jnp.concatenate([_unit(m.vectors), _unit(_centred(m.landmarks, of_landmarks))], axis=1)
    weights = jnp.concatenate([of_vectors, of_landmarks], axis=1)
    spread = jnp.einsum("nk,nki,nkj->nij", weights, known, known, precision="highest")
    total = jnp.trace(spread, axis1=1, axis2=2)
    # Sum over pairs of directions of the squared sine between them.
    apart = 0.5 * (total**2 - jnp.sum(spread**2, axis=(1, 2)))
    fixed = (apart >= INDEPENDENT) & jnp.any(of_landmarks > 0, axis=1)
    sample = jnp.where(jnp.any(fixed), jnp.argmax(fixed), fixed.shape[0])
    k = jnp.minimum(sample, fixed.shape[0] - 1)
    B = jnp.einsum("k,ki,kj->ij", weights[k], known[k], seen[k], precision="highest")
    left, _, right = jnp.linalg.svd(B)
    turn = jnp.ones(3, B.dtype).at[2].set(jnp.linalg.det(left) * jnp.linalg.det(right))
    R = jnp.matmul(left * turn[None], right, precision="highest")
    share = of_landmarks[k] / jnp.maximum(jnp.sum(of_landmarks[k]), 1)
    # y_i = R^T (p_i - P), so that P is the mean of p_i - R y_i.
    rotated = jnp.matmul(m.landmarks[k], R.T, precision="highest")
    P = jnp.sum(share[:, None] * (m.landmark_references[k] - rotated), axis=0)
    return FirstPose(sample, R, P)


def waiting_until(measurements: Measurements, sample: Array) -> Measurements:
    """Measurements with which a filter waits: before a sample nothing is seen and nothing moves."""
    count = measurements.time_step.shape[0]
    waits = jnp.arange(count, dtype=sample.dtype) < sample
    none = jnp.where(waits, 0.0, 1.0).astype(measurements.time_step.dtype)
    return measurements._replace(
        time_step=measurements.time_step * jnp.where(waits, WAITING, 1.0).astype(none.dtype),
        vector_weights=measurements.vector_weights * none[:, None],
        landmark_weights=measurements.landmark_weights * none[:, None],
    )


def bias_at_rest(measurements: Measurements, sample: Array) -> Array:
    """Means (6,) of the velocities over REST after a sample [rad/s, m/s]; at rest, the biases."""
    time = jnp.cumsum(measurements.time_step)
    index = jnp.arange(time.shape[0], dtype=sample.dtype)
    begin = time[jnp.minimum(sample, time.shape[0] - 1)]
    inside = ((index >= sample) & (time < begin + REST)).astype(time.dtype)
    both = jnp.concatenate([measurements.angular_velocity, measurements.velocity], axis=1)
    return inside @ both / jnp.maximum(jnp.sum(inside), 1)


def _centred(points: Array, weights: Array) -> Array:
    """Points (N, m, 3) minus the mean of the visible ones, with weights (N, m) of 0 and 1."""
    count = jnp.maximum(jnp.sum(weights, axis=1), 1)[:, None, None]
    return points - jnp.sum(weights[..., None] * points, axis=1, keepdims=True) / count


def _unit(vectors: Array) -> Array:
    """Vectors scaled to length 1; those of length 0 stay 0."""
    squared = jnp.sum(vectors**2, axis=-1, keepdims=True)
    there = squared > 0
    return jnp.where(there, vectors / jnp.sqrt(jnp.where(there, squared, 1.0)), 0.0)
