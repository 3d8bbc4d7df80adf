"""Truth and sensor errors: the measurements of a configured scenario for one noise key."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.model.loops import scan
from posegsa.model.measurements import Measurements
from posegsa.model.se3 import move, quaternion, rotation_matrix, stack, unstack


class Sines(NamedTuple):
    """A sum of sines for each of three axes, sum_j amplitude_j sin(frequency_j t + phase_j)."""

    amplitude: Array
    """(3, J) [rad/s or m/s]; axes with fewer sines are padded with amplitude 0."""
    frequency: Array
    """(3, J) [rad/s]."""
    phase: Array
    """(3, J) [rad]."""

    def at(self, time: Array) -> Array:
        """Values (N, 3) at times (N,) [s]."""
        angle = self.frequency[None] * time[:, None, None] + self.phase[None]
        return jnp.sum(self.amplitude[None] * jnp.sin(angle), axis=-1)


class Bursts(NamedTuple):
    """Times in which one vector is disturbed by a constant, in the body frame."""

    window: Array
    """(w, 2) start and end [s]."""
    vector: Array
    """(w,) index of the vector."""
    offset: Array
    """(w, 3) offset added to it, in its unit."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Scenario:
    """One motion and its sensors. Numbers are traced; counts and choices are structure."""

    samples: int = field(metadata={"static": True})
    """N."""
    time_step: Array
    """[s]"""
    angular_velocity: Sines
    """Omega, body frame [rad/s]."""
    velocity: Sines
    """V, body frame [m/s]."""
    rest: Array
    """(r, 2) start and end [s] of each time at rest, where both velocities are 0."""
    bias: Array
    """(6,) b at the start, body frame [rad/s, m/s], angular first."""
    bias_drift: Array
    """(6,) intensity of the random walk of b [rad/s/sqrt(s), m/s/sqrt(s)]."""
    angular_noise: Array
    """Standard deviation [rad/s]."""
    linear_noise: Array
    """Standard deviation [m/s]."""
    vectors: Array
    """(n, 3) v_i^I."""
    vector_bias: Array
    """(n, 3) body frame."""
    vector_noise: Array
    """(n,) standard deviations."""
    vector_outages: Array
    """(w, 2) start and end [s] of each time without any vector."""
    bursts: "Bursts"
    """Disturbances of single vectors."""
    landmarks: Array
    """(m, 3) p_i, inertial frame [m]."""
    landmark_bias: Array
    """(m, 3) body frame [m]."""
    landmark_noise: Array
    """(m,) standard deviations [m]."""
    landmark_outages: Array
    """(w, 2) start and end [s] of each time without any landmark."""
    landmark_period: Array
    """Samples from one measurement of the landmarks to the next; 1 is every sample."""
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
    end: Array
    """Time [s] after which samples no longer count; infinite if all count."""


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


class Sensed(NamedTuple):
    """The measurements of a scenario, and the biases in them."""

    measurements: Measurements
    bias: Array
    """(N, 6) b of the velocities over time [rad/s, m/s], angular first."""


def integrate(scenario: Scenario) -> Truth:
    """The true motion T_{k+1} = T_k exp([Omega_k; V_k]^ dt), for velocities held over each step."""
    step = scenario.time_step
    time = jnp.arange(scenario.samples, dtype=jnp.int32).astype(step.dtype) * step
    moving = jnp.where(_inside(scenario.rest, time), 0.0, 1.0).astype(step.dtype)[:, None]
    omega = moving * scenario.angular_velocity.at(time)
    v = moving * scenario.velocity.at(time)

    def body(pose, twist):
        attitude, place = pose
        (ox, oy, oz), (vx, vy, vz) = unstack(twist[0] * step), unstack(twist[1] * step)
        return move(attitude, place, (ox, oy, oz), (vx, vy, vz)), pose

    begin = unstack(quaternion(scenario.rotation)), unstack(scenario.position)
    _, (attitude, place) = scan(body, begin, (omega, v))
    return Truth(
        time=time,
        rotation=rotation_matrix(stack(attitude)),
        position=stack(place),
        angular_velocity=omega,
        velocity=v,
    )


def measure(scenario: Scenario, truth: Truth, key: Array) -> Sensed:
    """The measurements of a motion, for one noise key (pure, jittable).

    Y_m = Y + b + n (Eq. 6), v_i^B = R^T v_i^I + b_i + n_i (Eq. 2) and
    y_i = R^T (p_i - P) + b_i + n_i (Eq. 4). Vectors are as measured, neither normalised nor with
    their cross product; a missing one has weight 0.
    """
    of_angular, of_linear, of_vectors, of_landmarks = jax.random.split(key, 4)
    of_drift = jax.random.fold_in(key, 4)
    dtype, time = truth.time.dtype, truth.time
    N, n, m = time.shape[0], scenario.vectors.shape[0], scenario.landmarks.shape[0]

    def noise(key: Array, *shape: int) -> Array:
        # Always drawn in float32: in float64 the same key gives unrelated normals.
        drawn = jax.random.normal(key, (N, *shape), jnp.float32)
        # Otherwise XLA folds the factor sqrt(2) of the normals into the noise level, which rounds
        # differently.
        return jax.lax.optimization_barrier(drawn).astype(dtype)

    walks = jnp.cumsum(jnp.sqrt(scenario.time_step) * noise(of_drift, 6), axis=0)
    walk = jnp.pad(walks[:-1], ((1, 0), (0, 0)))  # of intensity 1, from 0 [sqrt(s)]
    bias = scenario.bias[None] + scenario.bias_drift[None] * walk

    def from_body(inertial: Array) -> Array:
        """R^T a at each sample, (N, i, 3)."""
        return jnp.einsum("kji,k...j->k...i", truth.rotation, inertial, precision="highest")

    spread = jnp.broadcast_to(scenario.vectors[None], (N, n, 3))
    vectors = from_body(spread) + scenario.vector_bias[None]
    vectors = vectors + scenario.vector_noise[None, :, None] * noise(of_vectors, n, 3)
    vectors = vectors + _disturbance(scenario.bursts, time, n)
    landmarks = from_body(scenario.landmarks[None] - truth.position[:, None])
    landmarks = landmarks + scenario.landmark_bias[None]
    landmarks = landmarks + scenario.landmark_noise[None, :, None] * noise(of_landmarks, m, 3)
    vectors_seen = ~_inside(scenario.vector_outages, time)
    period = scenario.landmark_period
    in_turn = jnp.arange(N, dtype=period.dtype) % period == 0
    landmarks_seen = in_turn & ~_inside(scenario.landmark_outages, time)
    measurements = Measurements(
        time_step=jnp.broadcast_to(scenario.time_step, (N,)),
        angular_velocity=truth.angular_velocity
        + bias[:, :3]
        + scenario.angular_noise * noise(of_angular, 3),
        velocity=truth.velocity + bias[:, 3:] + scenario.linear_noise * noise(of_linear, 3),
        vectors=vectors,
        vector_references=spread,
        vector_weights=jnp.broadcast_to(vectors_seen[:, None], (N, n)).astype(dtype),
        landmarks=landmarks,
        landmark_references=jnp.broadcast_to(scenario.landmarks[None], landmarks.shape),
        landmark_weights=jnp.broadcast_to(landmarks_seen[:, None], (N, m)).astype(dtype),
    )
    return Sensed(measurements, bias)


def _inside(windows: Array, time: Array) -> Array:
    """Whether times (N,) lie in any of the windows (w, 2), start included, end excluded."""
    begun = time[:, None] >= windows[None, :, 0]
    return jnp.any(begun & (time[:, None] < windows[None, :, 1]), axis=1)


def _disturbance(bursts: Bursts, time: Array, count: int) -> Array:
    """The offsets that bursts add to `count` vectors at times (N,), (N, count, 3)."""
    begun = time[:, None] >= bursts.window[None, :, 0]
    active = begun & (time[:, None] < bursts.window[None, :, 1])
    vectors = jnp.arange(count, dtype=bursts.vector.dtype)
    hit = bursts.vector[:, None] == vectors[None, :]
    which = (active[:, :, None] & hit[None]).astype(time.dtype)
    return jnp.einsum("kwi,wj->kij", which, bursts.offset, precision="highest")
