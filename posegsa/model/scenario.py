"""Truth and sensor errors: the measurements of a configured scenario for one noise key."""

from dataclasses import dataclass, field
from functools import partial
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
    """Times in which sensors of one kind are disturbed by a constant, in the body frame."""

    window: Array
    """(s, w, 2) start and end [s], of each sensor: in order, none before the last one's end."""
    offset: Array
    """(s, w, 3) offset added to the sensor, in its unit; 0 where it is not disturbed."""

    def at(self, time: Array) -> Array:
        """Offsets (N, s, 3) at times (N,) [s]; 0 where there is no burst."""
        return jax.vmap(partial(_offsets, time), out_axes=1)(self.window, self.offset)


class NoiseJumps(NamedTuple):
    """Factors on the noise of each sensor, constant from one jump to the next.

    The sensors are, in order, the angular velocity, the linear velocity, the vectors and the
    landmarks: s = 2 + n + m.
    """

    time: Array
    """(s, w) times of the jumps [s], ascending; before the first one the factor is 1."""
    factor: Array
    """(s, w) factor from each jump on."""

    def at(self, time: Array) -> Array:
        """Factors (N, s) at times (N,) [s]."""
        return jax.vmap(partial(_last, time), out_axes=1)(self.time, self.factor)


class Jumps(NamedTuple):
    """Displacements of the body between two samples, which the velocities do not measure."""

    time: Array
    """(w,) [s], ascending. Of several between the same two samples only the last happens."""
    twist: Array
    """(w, 6) xi of T <- T exp(xi^), body frame [rad, m]."""


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
    vector_period: Array
    """(n,) samples from one measurement of a vector to the next; 1 is every sample."""
    vector_begin: Array
    """(n,) first sample at which a vector is measured."""
    bursts: Bursts
    """Disturbances of the vectors."""
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
    landmark_turns: Array
    """(w,) ascending times [s] from which on one landmark is in sight, then the next, and after the
    last the first again; (0,) if all are always in sight."""
    landmark_bursts: Bursts
    """Disturbances of the landmarks."""
    noise_jumps: NoiseJumps
    """Factors on all noises."""
    jumps: Jumps
    """Jumps of the body."""
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
    """The true motion T_{k+1} = T_k exp([Omega_k; V_k]^ dt) exp(xi_k^), for held velocities.

    xi_k is the jump between the two samples (`jumps_between`), where there is one.
    """
    step = scenario.time_step
    time = jnp.arange(scenario.samples, dtype=jnp.int32).astype(step.dtype) * step
    moving = jnp.where(_inside(scenario.rest, time), 0.0, 1.0).astype(step.dtype)[:, None]
    omega = moving * scenario.angular_velocity.at(time)
    v = moving * scenario.velocity.at(time)

    def body(pose, twist):
        attitude, place = pose
        (ox, oy, oz), (vx, vy, vz) = unstack(twist[0] * step), unstack(twist[1] * step)
        after = move(attitude, place, (ox, oy, oz), (vx, vy, vz))
        if len(twist) > 2:
            tx, ty, tz, x, y, z = unstack(twist[2])
            after = move(*after, (tx, ty, tz), (x, y, z))
        return after, pose

    begin = unstack(quaternion(scenario.rotation)), unstack(scenario.position)
    jumps = (jumps_between(scenario),) if scenario.jumps.time.size else ()
    _, (attitude, place) = scan(body, begin, (omega, v, *jumps))
    return Truth(
        time=time,
        rotation=rotation_matrix(stack(attitude)),
        position=stack(place),
        angular_velocity=omega,
        velocity=v,
    )


def jumps_between(scenario: Scenario) -> Array:
    """Jumps (N, 6) from each sample to the next, xi of T <- T exp(xi^) [rad, m]; 0 without one."""
    at, twist = scenario.jumps
    none = jnp.zeros((scenario.samples, 6), twist.dtype)
    if not at.size:
        return none
    edges = jnp.arange(scenario.samples + 1, dtype=jnp.int32).astype(at.dtype) * scenario.time_step
    before = _count(edges, at)
    happened = before[1:] > before[:-1]
    return jnp.where(happened[:, None], twist[jnp.maximum(before[1:] - 1, 0)], none)


def measure(scenario: Scenario, truth: Truth, key: Array) -> Sensed:
    """The measurements of a motion, for one noise key (pure, jittable).

    Y_m = Y + b + n (Eq. 6), v_i^B = R^T v_i^I + b_i + n_i (Eq. 2) and
    y_i = R^T (p_i - P) + b_i + n_i (Eq. 4). Vectors are as measured, neither normalised nor with
    their cross product; a missing one has weight 0. Bursts are added, and the noise n is multiplied
    by its factor at that time.
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
    factors = scenario.noise_jumps.at(time) if scenario.noise_jumps.time.size else None

    def factored(drawn: Array, first: int) -> Array:
        """Noise (N, i, 3) of i sensors from number `first` on, with the factors on it."""
        if factors is None:
            return drawn
        return factors[:, first : first + drawn.shape[1], None] * drawn

    vector_noise = scenario.vector_noise[None, :, None] * noise(of_vectors, n, 3)
    vectors = vectors + factored(vector_noise, 2)
    if scenario.bursts.window.size:
        vectors = vectors + scenario.bursts.at(time)
    landmarks = from_body(scenario.landmarks[None] - truth.position[:, None])
    landmarks = landmarks + scenario.landmark_bias[None]
    landmark_noise = scenario.landmark_noise[None, :, None] * noise(of_landmarks, m, 3)
    landmarks = landmarks + factored(landmark_noise, 2 + n)
    if scenario.landmark_bursts.window.size:
        landmarks = landmarks + scenario.landmark_bursts.at(time)
    index, period = jnp.arange(N, dtype=jnp.int32)[:, None], scenario.vector_period[None]
    measured = (index % period == 0) & (index >= scenario.vector_begin[None])
    vectors_seen = measured & ~_inside(scenario.vector_outages, time)[:, None]
    measured = index % scenario.landmark_period == 0
    landmarks_seen = measured & ~_inside(scenario.landmark_outages, time)[:, None]
    if scenario.landmark_turns.size:
        turn = _count(time, scenario.landmark_turns)[:, None] - 1
        own = jnp.arange(m, dtype=turn.dtype)[None]
        landmarks_seen = landmarks_seen & (turn >= 0) & (turn % m == own)
    angular_noise = scenario.angular_noise * noise(of_angular, 3)
    linear_noise = scenario.linear_noise * noise(of_linear, 3)
    measurements = Measurements(
        time_step=jnp.broadcast_to(scenario.time_step, (N,)),
        angular_velocity=truth.angular_velocity
        + bias[:, :3]
        + factored(angular_noise[:, None], 0)[:, 0],
        velocity=truth.velocity + bias[:, 3:] + factored(linear_noise[:, None], 1)[:, 0],
        vectors=vectors,
        vector_references=spread,
        vector_weights=vectors_seen.astype(dtype),
        landmarks=landmarks,
        landmark_references=jnp.broadcast_to(scenario.landmarks[None], landmarks.shape),
        landmark_weights=jnp.broadcast_to(landmarks_seen, (N, m)).astype(dtype),
    )
    return Sensed(measurements, bias)


def _inside(windows: Array, time: Array) -> Array:
    """Whether times (N,) lie in any of the windows (w, 2), start included, end excluded."""
    started = time[:, None] >= windows[None, :, 0]
    return jnp.any(started & (time[:, None] < windows[None, :, 1]), axis=1)


def _count(time: Array, events: Array) -> Array:
    """How many of the events (w,) have happened by times (N,), events at that time included."""
    return jnp.sum(events[None] <= time[:, None], axis=1, dtype=jnp.int32)


def _last(time: Array, events: Array, values: Array) -> Array:
    """The value (N,) of the last of the events (w,) at times (N,); 1 before the first."""
    count = _count(time, events)
    return jnp.where(count > 0, values[jnp.maximum(count - 1, 0)], 1)


def _offsets(time: Array, windows: Array, offsets: Array) -> Array:
    """Offsets (N, 3) of a sensor at times (N,), of windows (w, 2) and offsets (w, 3)."""
    count = _count(time, windows[:, 0])
    last = jnp.maximum(count - 1, 0)
    active = (count > 0) & (time < windows[last, 1])
    return jnp.where(active[:, None], offsets[last], 0)
