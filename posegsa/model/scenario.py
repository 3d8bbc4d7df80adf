"""Truth and sensor errors: the measurements of a configured scenario for one noise key."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.model.measurements import Measurements, normalised, with_cross_vector
from posegsa.model.se3 import move, quaternion, rotation_matrix, stack, unstack


class Profile(NamedTuple):
    """A sum of sines for each of three axes, sum_j amplitude_j sin(frequency_j t + phase_j)."""

    amplitude: Array
    """(3, J) [rad/s or m/s]; axes with fewer sines are filled up with amplitude 0."""
    frequency: Array
    """(3, J) [rad/s]."""
    phase: Array
    """(3, J) [rad]."""

    def at(self, time: Array) -> Array:
        """Values (N, 3) at times (N,) [s]."""
        angle = self.frequency[None] * time[:, None, None] + self.phase[None]
        return jnp.sum(self.amplitude[None] * jnp.sin(angle), axis=-1)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "time_step",
        "angular_velocity",
        "velocity",
        "bias",
        "angular_noise",
        "linear_noise",
        "vectors",
        "vector_bias",
        "vector_noise",
        "vector_weights",
        "landmarks",
        "landmark_bias",
        "landmark_noise",
        "landmark_weights",
        "rotation",
        "position",
        "rotation_estimate",
        "position_estimate",
        "bias_estimate",
    ],
    meta_fields=["samples", "cross_vector", "normalise_vectors"],
)
@dataclass(frozen=True)
class Scenario:
    """One motion and its sensors. Numbers are traced; counts and choices are structure."""

    samples: int
    """N."""
    cross_vector: bool
    normalise_vectors: bool
    time_step: Array
    """[s]"""
    angular_velocity: Profile
    """Omega, body frame [rad/s]."""
    velocity: Profile
    """V, body frame [m/s]."""
    bias: Array
    """(6,) b, body frame [rad/s, m/s], angular first."""
    angular_noise: Array
    """Standard deviation [rad/s]."""
    linear_noise: Array
    """Standard deviation [m/s]."""
    vectors: Array
    """(n, 3) v_i^I, without the cross product."""
    vector_bias: Array
    """(n, 3) body frame."""
    vector_noise: Array
    """(n,) standard deviations."""
    vector_weights: Array
    """(n,) s_i^R, or (n + 1,) with the cross product's last."""
    landmarks: Array
    """(m, 3) p_i, inertial frame [m]."""
    landmark_bias: Array
    """(m, 3) body frame [m]."""
    landmark_noise: Array
    """(m,) standard deviations [m]."""
    landmark_weights: Array
    """(m,) s_i^L."""
    rotation: Array
    """(3, 3) R(0)."""
    position: Array
    """(3,) P(0) [m]."""
    rotation_estimate: Array
    """(3, 3) R_est(0), a rotation."""
    position_estimate: Array
    """(3,) P_est(0) [m]."""
    bias_estimate: Array
    """(6,) b_est(0) [rad/s, m/s]."""


class Truth(NamedTuple):
    """The true motion over N samples."""

    time: Array
    """(N,) [s]."""
    rotation: Array
    """(N, 3, 3) R, body to inertial."""
    position: Array
    """(N, 3) P [m], inertial frame."""
    angular_velocity: Array
    """(N, 3) Omega [rad/s], body frame, held over each time step."""
    velocity: Array
    """(N, 3) V [m/s], body frame, held over each time step."""


def integrate(scenario: Scenario) -> Truth:
    """The true motion, T_{k+1} = T_k exp([Omega_k; V_k]^ dt): exact for velocities held a step."""
    step = scenario.time_step
    time = jnp.arange(scenario.samples, dtype=step.dtype) * step
    omega, v = scenario.angular_velocity.at(time), scenario.velocity.at(time)

    def body(pose, twist):
        attitude, place = pose
        (ox, oy, oz), (vx, vy, vz) = unstack(twist[0] * step), unstack(twist[1] * step)
        return move(attitude, place, (ox, oy, oz), (vx, vy, vz)), pose

    w, x, y, z = unstack(quaternion(scenario.rotation))
    px, py, pz = unstack(scenario.position)
    _, (attitude, place) = lax.scan(body, ((w, x, y, z), (px, py, pz)), (omega, v))
    return Truth(
        time=time,
        rotation=rotation_matrix(stack(attitude)),
        position=stack(place),
        angular_velocity=omega,
        velocity=v,
    )


def measure(scenario: Scenario, truth: Truth, key: Array) -> Measurements:
    """What the sensors say of a motion, for one noise key (pure, jittable).

    Y_m = Y + b + n; v_i^B = R^T v_i^I + b_i + n_i; y_i = R^T (p_i - P) + b_i + n_i; then the cross
    product v_1 x v_2 is appended and all vectors are normalised, as configured (Section V of the
    paper).
    """
    of_angular, of_linear, of_vectors, of_landmarks = jax.random.split(key, 4)
    dtype = truth.time.dtype

    def noise(key: Array, *shape: int) -> Array:
        # Drawn in float32 whatever the dtype: the same key gives unrelated normals in float64.
        return jax.random.normal(key, shape, jnp.float32).astype(dtype)

    N, n, m = scenario.samples, scenario.vectors.shape[0], scenario.landmarks.shape[0]
    angular = truth.angular_velocity + scenario.bias[None, :3]
    linear = truth.velocity + scenario.bias[None, 3:]

    def from_body(inertial: Array) -> Array:
        """R^T a at each sample, (N, i, 3)."""
        return jnp.einsum("kji,k...j->k...i", truth.rotation, inertial, precision="highest")

    spread = jnp.broadcast_to(scenario.vectors[None], (N, n, 3))
    vectors = from_body(spread) + scenario.vector_bias[None]
    vectors = vectors + scenario.vector_noise[None, :, None] * noise(of_vectors, N, n, 3)
    landmarks = from_body(scenario.landmarks[None] - truth.position[:, None])
    landmarks = landmarks + scenario.landmark_bias[None]
    landmarks = landmarks + scenario.landmark_noise[None, :, None] * noise(of_landmarks, N, m, 3)
    references = scenario.vectors
    if scenario.cross_vector:
        vectors, references = with_cross_vector(vectors), with_cross_vector(references)
    if scenario.normalise_vectors:
        vectors, references = normalised(vectors), normalised(references)
    return Measurements(
        time_step=jnp.broadcast_to(scenario.time_step, (N,)),
        angular_velocity=angular + scenario.angular_noise * noise(of_angular, N, 3),
        velocity=linear + scenario.linear_noise * noise(of_linear, N, 3),
        vectors=vectors,
        vector_references=jnp.broadcast_to(references[None], vectors.shape),
        vector_weights=jnp.broadcast_to(scenario.vector_weights[None], vectors.shape[:2]),
        landmarks=landmarks,
        landmark_references=jnp.broadcast_to(scenario.landmarks[None], landmarks.shape),
        landmark_weights=jnp.broadcast_to(scenario.landmark_weights[None], (N, m)),
    )
