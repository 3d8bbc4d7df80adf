"""The clairvoyant against a plain filter that knows the same."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference_ekf
from helpers.arrays import as_arrays
from helpers.filters import state_of
from helpers.measurements import random_measurements, random_poses
from helpers.measurements import reference_sample as sample_of
from helpers.reference import adjoint, se3_exp

from posegsa.errors import ArgumentError
from posegsa.filters.base import Sensors, samples_of
from posegsa.filters.clairvoyant import Clairvoyant, with_events
from posegsa.filters.kalman import KalmanNoise
from posegsa.filters.rollout import run
from posegsa.model.events import Events
from posegsa.model.measurements import Measurements

COUNT = 40
PLAIN = reference_ekf.Noise(
    velocity=np.zeros(6),  # given at each sample
    bias_walk=np.array([0.003, 0.003, 0.003, 0.002, 0.002, 0.002]),
    vector_walk=0.0,
    vector=1.0,
    landmark=1.0,
    pose=np.array([0.5, 0.5, 0.5, 2.0, 2.0, 2.0]),
    bias=np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3]),
    vector_bias=0.15,
)


def filter_of(dtype: type[np.floating]) -> Clairvoyant:
    """The clairvoyant with the same start; its walks come with the samples."""
    numbers = dict.fromkeys(KalmanNoise._fields, 0.0) | {
        **{"vector": 1.0, "landmark": 1.0},
        **{"initial_attitude": 0.5, "initial_position": 2.0, "initial_vector_bias": 0.15},
        **{"initial_angular_bias": 0.1, "initial_linear_bias": 0.3},
    }
    return Clairvoyant(as_arrays(KalmanNoise(**numbers), dtype))


def some_events(rng: np.random.Generator, count: int) -> Events:
    """Noise of another size at each sample of two vectors and a landmark, and three jumps."""
    jumps = np.zeros((count, 6))
    jumps[[5, 6, 30]] = rng.normal(size=(3, 6)) * np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])
    arrays = {
        "angular_noise": rng.uniform(0.1, 2, count),
        "linear_noise": rng.uniform(0.1, 2, count),
        "vector_noise": rng.uniform(0.1, 2, (count, 2)),
        "landmark_noise": rng.uniform(0.1, 2, (count, 1)),
        "vector_bursts": rng.uniform(size=(count, 2)) < 0.2,
        "landmark_bursts": rng.uniform(size=(count, 1)) < 0.2,
        "jumps": jumps,
    }
    return Events(**jax.tree.map(jnp.asarray, arrays))


@partial(jax.jit, static_argnames="jumps")
def states(filter: Clairvoyant, m: Measurements, events: Events, initial, jumps: bool = True):
    """Pose, biases and covariance before each sample."""
    walk = jnp.asarray(PLAIN.bias_walk, m.time_step.dtype)
    samples = with_events(samples_of(filter, events.weighted(m)), events, walk, jumps=jumps)

    def look(total, view, entry):
        estimate = view.estimate
        return total, (estimate.rotation, estimate.position, estimate.bias, estimate.vector_bias)

    state = filter.start(initial, Sensors(2, 1))
    last, _, stored = run(look, filter, samples, state)
    return stored, last.covariance_matrix


@pytest.mark.usefixtures("x64")
def test_each_sample_has_its_own_noise_bursts_are_dropped_and_jumps_are_followed() -> None:
    rng = np.random.default_rng(0)
    m = as_arrays(random_measurements(rng, COUNT, 2, 1, missing=0.2), np.float64)
    events = some_events(rng, COUNT)
    T, b = random_poses(rng, 1)[0], 0.3 * rng.normal(size=6)
    state, want = reference_ekf.start(T, b, 2, PLAIN), []
    known = jax.tree.map(np.asarray, events)
    for k in range(COUNT):
        s = sample_of(m, k)
        use = [
            (weights > 0) & ~bursts[k]
            for weights, bursts in ((s.sR, known.vector_bursts), (s.sL, known.landmark_bursts))
        ]
        s = replace(
            s,
            sR=np.where(use[0], known.vector_noise[k] ** -2, 0),
            sL=np.where(use[1], known.landmark_noise[k] ** -2, 0),
        )
        deviation = np.repeat([known.angular_noise[k], known.linear_noise[k]], 3)
        noise = replace(PLAIN, velocity=deviation * np.sqrt(s.dt))
        want.append(state)
        updated, correction = reference_ekf.update(state, s, noise)
        state = reference_ekf.propagate(updated, correction, s, noise)
        jump = se3_exp(known.jumps[k])
        A = np.eye(18)
        A[:6, :6] = np.linalg.inv(adjoint(jump))
        state = replace(state, T=state.T @ jump, Sigma=A @ state.Sigma @ A.T)
    (R, P, biases, c), sigma = states(
        filter_of(np.float64), m, events, state_of(T, b, learnt_vectors=2)
    )
    # A jump takes a nanosecond, in which the biases act.
    np.testing.assert_allclose(R, [one.T[:3, :3] for one in want], atol=1e-7)
    np.testing.assert_allclose(P, [one.T[:3, 3] for one in want], atol=1e-7)
    np.testing.assert_allclose(biases, [one.b for one in want], atol=1e-7)
    np.testing.assert_allclose(c, [one.c for one in want], atol=1e-7)
    np.testing.assert_allclose(sigma, state.Sigma, atol=1e-7)


def test_a_jump_is_exact_in_single_precision() -> None:
    rng = np.random.default_rng(1)
    m = as_arrays(random_measurements(rng, COUNT, 2, 1, missing=1.0), np.float32)
    m = m._replace(angular_velocity=m.angular_velocity * 0, velocity=m.velocity * 0)
    events = some_events(rng, COUNT)
    T = np.eye(4)
    (R, P, _, _), _ = states(filter_of(np.float32), m, events, state_of(T, dtype=np.float32))
    for k in range(COUNT):
        np.testing.assert_allclose(R[k], T[:3, :3], atol=2e-6)
        np.testing.assert_allclose(P[k], T[:3, 3], atol=2e-5)
        T = T @ se3_exp(np.asarray(events.jumps[k], np.float64))
    assert np.abs(P[-1]).max() > 1


@pytest.mark.usefixtures("x64")
def test_without_jumps_the_shorter_step_is_the_same() -> None:
    rng = np.random.default_rng(2)
    m = as_arrays(random_measurements(rng, COUNT, 2, 1), np.float64)
    events = some_events(rng, COUNT)._replace(jumps=jnp.zeros((COUNT, 6)))
    initial = state_of(np.eye(4), learnt_vectors=2)
    both = [states(filter_of(np.float64), m, events, initial, jumps) for jumps in (True, False)]
    for a, b in zip(*map(jax.tree.leaves, both), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


def test_a_number_that_it_does_not_have_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"gain.*initial_attitude"):
        filter_of(np.float32).with_values({"gain": jnp.float32(1.0)})
