"""Schedules of a Kalman filter's noises: their inputs, factors and effects."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference_ekf
from helpers.arrays import as_arrays
from helpers.filters import state_of
from helpers.measurements import random_measurements, random_poses
from helpers.measurements import reference_sample as sample_of
from hypothesis import given, settings
from hypothesis import strategies as st

import posegsa
from posegsa.filters.base import Samples, Sensors, samples_of
from posegsa.filters.belief import (
    Factors,
    Residual,
    halfway_to_the_least,
    initial_beliefs,
    next_mean,
    residuals,
)
from posegsa.filters.kalman import (
    KalmanFilter,
    KalmanNoise,
    KalmanState,
    forgotten,
)
from posegsa.filters.measurement_model import measured_error, weighted
from posegsa.filters.noise_schedules import (
    NoiseGains,
    NoiseSignal,
    NoiseSignals,
    initial_noise_memory,
    noise_factor,
)
from posegsa.model.schedules import ConstantGain, RampGain

pytestmark = pytest.mark.usefixtures("x64")

NOISE = KalmanNoise(0.02, 0.01, 1e-4, 1e-4, 1e-4, 0.1, 0.1, 0.5, 1.0, 0.1, 0.3, 0.1)
LARGEST = 1e6
SIGNAL = NoiseSignal(smoothing=0.1, scale=1e6, rate_scale=0.1, largest=LARGEST)


def numbers(record: Any) -> Any:
    return jax.tree.map(jnp.asarray, record)


def kalman(schedule: NoiseGains, signal: NoiseSignal = SIGNAL) -> KalmanFilter:
    signals = numbers(NoiseSignals(signal._replace(scale=100.0, largest=1000.0), signal))
    return KalmanFilter(numbers(NOISE), schedule=numbers(schedule), signals=signals)


def sequence(count: int, seed: int = 0, missing: float = 0.3) -> tuple[Any, np.ndarray]:
    rng = np.random.default_rng(seed)
    return random_measurements(rng, count, 2, 1, missing=missing), random_poses(rng, 1)[0]


@jax.jit
def ten_steps(filter: KalmanFilter, state: KalmanState, samples: Samples) -> KalmanState:
    def body(state: KalmanState, now: Samples) -> tuple[KalmanState, None]:
        return filter.ready().step(state, now)[0], None

    return jax.lax.scan(body, state, samples)[0]


def ran(filter: KalmanFilter, m: Any, T: np.ndarray) -> KalmanState:
    """The state after all samples, ten at a time: one program for runs of any length."""
    state = filter.start(state_of(T, learnt_vectors=2), Sensors(2, 1))
    samples = jax.tree.map(np.asarray, samples_of(filter, as_arrays(m, np.float64)))
    for k in range(0, len(m.time_step), 10):
        state = ten_steps(filter, state, jax.tree.map(lambda a, k=k: a[k : k + 10], samples))
    return state


residuals_of = jax.jit(residuals, static_argnames="of")
error_of = jax.jit(measured_error)


@given(st.lists(st.floats(1e-3, 1e5), min_size=2, max_size=20), st.floats(0, 1))
@settings(max_examples=20, deadline=None)
def test_the_input_is_the_logarithm_of_the_low_passed_value(values, smoothing) -> None:
    """Against backward Euler written out, with a schedule that returns its input."""
    signal = numbers(SIGNAL._replace(smoothing=smoothing))
    ramp = RampGain(jnp.asarray(0.0), jnp.asarray(1.0))
    memory = initial_noise_memory(ramp, jnp.asarray(0.0))
    low_passed = values[0]
    for k, value in enumerate(values):
        if k:
            low_passed += (value - low_passed) * 0.01 / (smoothing + 0.01)
        now = jnp.asarray(value)
        factor, memory, inputs = noise_factor(
            ramp.prepare(), signal, memory, now, jnp.asarray(True), now, jnp.asarray(0.01)
        )
        np.testing.assert_allclose(memory.value, low_passed, rtol=1e-6)
        e = np.clip(np.log(low_passed) / np.log(1e6), 0, 1)
        np.testing.assert_allclose(inputs.error, e, atol=1e-7)
        np.testing.assert_allclose(factor, 1e6**e, rtol=1e-5)  # the power 1 of the value


def test_without_an_input_only_the_age_changes() -> None:
    ramp = RampGain(jnp.asarray(0.0), jnp.asarray(1.0))
    memory = initial_noise_memory(ramp, jnp.asarray(0.0))
    step = jnp.asarray(0.01)
    follow = partial(noise_factor, ramp.prepare(), numbers(SIGNAL))
    _, seen, _ = follow(memory, jnp.asarray(50.0), jnp.asarray(True), step, step)
    _, after, _ = follow(seen, jnp.asarray(9e9), jnp.asarray(False), step, step)
    assert after == seen._replace(age=after.age)
    np.testing.assert_allclose(after.age, 0.02)


def test_residuals_are_those_of_the_matrix_form() -> None:
    """|z - y|^2 over tr(H Sigma H^T) + tr(N), sensor by sensor, from a covariance that is full.

    And the variance that it implies: less tr(H Sigma H^T), over tr(N).
    """
    m, T = sequence(60)
    filter = kalman(NoiseGains())
    state = ran(filter, m, T)
    noise = reference_ekf.Noise(
        np.zeros(6), np.zeros(6), 0.0, NOISE.vector, NOISE.landmark, np.zeros(6), np.zeros(6), 0.0
    )
    estimate = state.estimate
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = estimate.rotation, estimate.position
    held = reference_ekf.State(
        pose, np.zeros(6), np.asarray(estimate.vector_bias), np.asarray(state.covariance_matrix)
    )
    given = as_arrays(m, np.float64)
    checked = 0
    for k in range(10):
        sample, s = filter.prepare(given.at(k)), sample_of(m, k)
        deviations = filter.noise.vector, filter.noise.landmark
        found = residuals_of(state.estimate, state.covariance, sample, *deviations)
        got = np.concatenate([one.normalised for one in found])
        found = residuals_of(state.estimate, state.covariance, sample, *deviations, of="variance")
        variances = np.concatenate([one.normalised for one in found])
        squares = {}
        seen = np.concatenate([np.flatnonzero(s.sR), 2 + np.flatnonzero(s.sL)])
        H, z, y, N = reference_ekf.linearised(held, s, noise)
        for i, sensor in enumerate(seen):
            part = slice(3 * i, 3 * i + 3)
            square, own = np.sum((z - y)[part] ** 2), np.trace(N[part, part])
            spread = np.trace(H[part] @ held.Sigma @ H[part].T)
            np.testing.assert_allclose(got[sensor], square / (spread + own))
            np.testing.assert_allclose(variances[sensor], (square - spread) / own)
            squares[sensor] = square / own
            checked += 1
        rms, any_seen = error_of(state.estimate, sample, *deviations)
        assert bool(any_seen) == bool(len(seen))
        np.testing.assert_allclose(rms**2 * len(seen), sum(squares.values()), atol=1e-12)
        half = [0.5 * vector.factor for vector in sample.vectors.each]
        less = weighted(sample, half, [one.factor for one in sample.landmarks])
        rms, _ = error_of(state.estimate, less, *deviations)
        left = [square * (0.5 if sensor < 2 else 1) for sensor, square in squares.items()]
        np.testing.assert_allclose(rms**2 * len(seen), sum(left), atol=1e-12)
    assert checked > 10


def test_belief_in_landmarks_alone_changes_their_noise_alone() -> None:
    """Also where the vectors' noise is not scheduled."""
    m, T = sequence(30, missing=0.0)
    factor = ConstantGain(jnp.asarray(26.0))
    believed = ran(kalman(NoiseGains(landmarks=factor)), m, T)
    variance = float(SIGNAL.largest) ** 0.25
    louder = NOISE._replace(landmark=NOISE.landmark * np.sqrt(variance))
    plain = ran(KalmanFilter(numbers(louder)), m, T)
    for a, b in zip(jax.tree.leaves(believed[:2]), jax.tree.leaves(plain[:2]), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kinds", ["both", "vectors", "landmarks"])
def test_half_of_the_doubt_that_all_measured_sensors_share_is_taken_back(kinds) -> None:
    """A kind without belief is believed; a sample without a sensor has no least factor."""
    m, _ = sequence(40, missing=0.5)
    filter, rng, leasts = kalman(NoiseGains()), np.random.default_rng(3), []
    for k in range(40):
        sample, s = filter.prepare(as_arrays(m, np.float64).at(k)), sample_of(m, k)
        of = [LARGEST ** rng.uniform(0.2, 1, len(weights)) for weights in (s.sR, s.sL)]
        given = [tuple(jnp.asarray(f) for f in each) for each in of]
        for i, kind in enumerate(("vectors", "landmarks")):
            if kinds not in (kind, "both"):
                of[i], given[i] = np.ones_like(of[i]), None
        found = halfway_to_the_least(Factors(*given), sample, jnp.asarray(LARGEST))
        measured = np.concatenate([f[w > 0] for f, w in zip(of, (s.sR, s.sL), strict=True)])
        leasts.append(min(measured, default=LARGEST))
        assert [got is None for got in found] == [one is None for one in given]
        for factors, got in zip(of, found, strict=True):
            if got is not None:
                np.testing.assert_allclose(got, factors / np.sqrt(leasts[-1]))
    assert min(leasts) < 1e4 < max(leasts) == LARGEST


def test_the_doubt_that_is_shared_may_have_a_batch_where_the_sample_has_none() -> None:
    """A candidate's own `belief_largest`, with samples that all candidates share."""
    m, _ = sequence(1, missing=0.0)
    sample = kalman(NoiseGains()).prepare(as_arrays(m, np.float64).at(0))
    largest = jnp.asarray([1e2, 1e4, 1e6])
    found = halfway_to_the_least(Factors((largest, 4 * largest), (9 * largest,)), sample, largest)
    assert found.vectors is not None
    assert found.landmarks is not None
    for got, factor in zip((*found.vectors, *found.landmarks), (1, 4, 9), strict=True):
        np.testing.assert_allclose(got, factor * np.sqrt(largest))


@pytest.mark.parametrize("role", ["unknown", "vectors", "landmarks"])
def test_a_schedule_that_returns_1_changes_nothing(role) -> None:
    m, T = sequence(30)
    idle = ran(kalman(NoiseGains(**{role: ConstantGain(jnp.asarray(1.0))})), m, T)
    plain = ran(KalmanFilter(numbers(NOISE)), m, T)
    for a, b in zip(jax.tree.leaves(idle[:2]), jax.tree.leaves(plain[:2]), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_a_constant_factor_is_another_noise() -> None:
    """A factor of 16 that all sensors share is 4 on their variances, which doubles deviations."""
    m, T = sequence(30)
    gain = 1 + 100 * np.log(16.0) / np.log(1e6)
    constant = ConstantGain(jnp.asarray(gain))
    believed = ran(kalman(NoiseGains(vectors=constant, landmarks=constant)), m, T)
    doubled = numbers(NOISE._replace(vector=0.2, landmark=0.2))
    plain = ran(KalmanFilter(doubled), m, T)
    np.testing.assert_allclose(believed.covariance_matrix, plain.covariance_matrix, atol=1e-9)
    unknown = ConstantGain(jnp.asarray(1 + 100 * np.log(4.0) / np.log(1000.0)))
    faster = ran(kalman(NoiseGains(unknown=unknown)), m, T)
    more = {name: 4 * getattr(NOISE, name) for name in ("angular_velocity", "velocity")}
    plain = ran(KalmanFilter(numbers(NOISE._replace(**more, vector_walk=4e-4))), m, T)
    # What is forgotten of the vectors' biases is a share of 1e-7 a sample here.
    np.testing.assert_allclose(faster.covariance_matrix, plain.covariance_matrix, atol=1e-6)


def test_a_raised_walk_forgets_the_vectors_biases() -> None:
    """In the form of matrices: F = diag(I, k I), k = 1 / (1 + dt (W^2 - w^2) / (2 s^2))."""
    rng = np.random.default_rng(6)
    root = rng.normal(size=(18, 18))
    Sigma, c = root @ root.T, rng.normal(size=(2, 3))
    noise = numbers(NOISE._replace(vector_walk=0.3, initial_vector_bias=0.7))
    state = KalmanFilter(noise).start(state_of(np.eye(4), learnt_vectors=2), Sensors(2, 1))
    state = state._replace(
        estimate=state.estimate._replace(vector_biases=tuple(map(tuple, jnp.asarray(c)))),
        covariance=tuple(tuple(jnp.asarray(Sigma[i, i:])) for i in range(18)),
    )
    k = 1 / (1 + 0.1 * (2.0**2 - 0.3**2) / (2 * 0.7**2))
    F = np.diag([1.0] * 12 + [k] * 6)
    after = forgotten(state, jnp.asarray(0.1), noise, jnp.asarray(2.0))
    np.testing.assert_allclose(after.covariance_matrix, F @ Sigma @ F, rtol=1e-12)
    np.testing.assert_allclose(after.estimate.vector_biases, k * c, rtol=1e-12)


def test_what_is_forgotten_bounds_the_variance_of_the_vectors_biases() -> None:
    """Without measurements, a random walk raised from almost 0 ends at the initial variance."""
    m, T = sequence(1)
    none = m._replace(vector_weights=np.zeros((1, 2)), landmark_weights=np.zeros((1, 1)))
    raised = ConstantGain(jnp.asarray(101.0))
    noise = numbers(NOISE._replace(vector_walk=1e-3, initial_vector_bias=0.2))
    filter = replace(kalman(NoiseGains(unknown=raised)), noise=noise)
    for count in (10, 1000):
        found = ran(filter, jax.tree.map(lambda a, n=count: np.repeat(a, n, axis=0), none), T)
        deviations = np.sqrt(np.diagonal(found.covariance_matrix)[12:])
        np.testing.assert_allclose(deviations, 0.2, rtol=0.1)


def test_a_sensor_that_disagrees_is_not_believed() -> None:
    """The estimate after ten samples with a vector far off is near that without this vector."""
    rng = np.random.default_rng(3)
    T = random_poses(rng, 1)[0]
    m, _ = sequence(10)
    known = np.broadcast_to(m.vector_references[:1], (10, 2, 3))
    exact = m._replace(
        angular_velocity=np.zeros((10, 3)),
        vectors=known @ T[:3, :3] + [[5.0, 0, 0], [0, 0, 0]],
        vector_references=known,
        vector_weights=np.ones((10, 2)),
        landmark_weights=np.zeros((10, 1)),
    )
    without = exact._replace(vector_weights=np.tile([0.0, 1.0], (10, 1)))
    noise = numbers(NOISE._replace(initial_attitude=0.05, initial_vector_bias=0.01))
    steep = RampGain(jnp.asarray(0.0), jnp.asarray(3.0))
    strict = replace(kalman(NoiseGains(vectors=steep)), noise=noise)
    fixed = KalmanFilter(noise)
    best = ran(fixed, without, T).estimate.rotation
    errors = [
        float(jnp.linalg.norm(ran(one, exact, T).estimate.rotation - best))
        for one in (strict, fixed)
    ]
    assert errors[0] < 0.01 * errors[1]


def at_rest(m: Any, T: np.ndarray, rng: np.random.Generator, noise: float) -> Any:
    """The measurements of a body that stays at a pose, with white noise of its sensors."""
    count = len(m.time_step)
    return m._replace(
        angular_velocity=np.zeros((count, 3)),
        velocity=np.zeros((count, 3)),
        vectors=(m.vector_references @ T[:3, :3]) + noise * rng.normal(size=(count, 2, 3)),
        vector_weights=np.ones((count, 2)),
        landmark_weights=np.ones((count, 1)),
        landmarks=(m.landmark_references - T[:3, 3]) @ T[:3, :3]
        + noise * rng.normal(size=(count, 1, 3)),
    )


def test_the_mean_of_residuals_is_low_passed_as_its_page_states() -> None:
    rng, smoothing = np.random.default_rng(7), jnp.asarray(0.05)
    line = RampGain(jnp.asarray(0.0), jnp.asarray(1.0))
    (memory,) = initial_beliefs((line,), (1,), jnp.asarray(0.0), "mean").vectors
    mean, share, age = np.zeros(3), 0.0, np.inf
    for seen in (False, True, True, False, True):
        off = rng.normal(size=3)
        zero = jnp.asarray(0.0)
        now = Residual(zero, jnp.asarray(float(seen)), tuple(map(jnp.asarray, off)), (zero, zero))
        after = next_mean(memory, now, smoothing)
        if seen:
            old = 0.05 / (0.05 + age)
            mean, share, age = off + old * (mean - off), (1 - old) ** 2 + old**2 * share, 0.01
        else:
            age += 0.01
        np.testing.assert_allclose(after.value, mean, rtol=1e-12)
        np.testing.assert_allclose(after.share, share, rtol=1e-12)
        memory = memory._replace(mean=after, age=jnp.asarray(age))


@pytest.mark.parametrize(("off", "least", "most"), [(0.0, 0.2, 3.0), (0.1, 4.0, 20.0)])
def test_the_mean_shows_an_offset_as_small_as_the_noise(off, least, most) -> None:
    """Of a vector, its square over its expectation, which for a single residual would be 4/3."""
    rng = np.random.default_rng(5)
    T, assumed = random_poses(rng, 1)[0], 0.1
    m = at_rest(random_measurements(rng, 2000, 2, 1), T, rng, assumed)
    m.vectors[1900:, 0, 0] += off
    line = RampGain(jnp.asarray(0.0), jnp.asarray(1.0))
    own = kalman(NoiseGains(vectors=line, landmarks=line), SIGNAL._replace(smoothing=0.3))
    memory = ran(replace(own, belief_input="mean"), m, T).memory
    assert least < float(memory.vectors[0].value) < most
    assert 0.1 < float(memory.vectors[1].value) < 3


def test_the_variance_implied_by_residuals_is_the_sensors_own_on_average() -> None:
    """Landmarks have three times the noise that the filter assumes: Sage and Husa's rule finds it.

    The line of slope 1 from 0 makes the low-passed variance the factor itself.
    """
    rng = np.random.default_rng(5)
    T, count, assumed = random_poses(rng, 1)[0], 4000, 0.1
    m = random_measurements(rng, count, 2, 1)
    m = at_rest(m, T, rng, assumed)
    body = (m.landmark_references - T[:3, 3]) @ T[:3, :3]
    m = m._replace(landmarks=body + 3 * assumed * rng.normal(size=(count, 1, 3)))
    line = RampGain(jnp.asarray(0.0), jnp.asarray(1.0))
    own = kalman(NoiseGains(vectors=line, landmarks=line), SIGNAL._replace(smoothing=5.0))
    memory = ran(replace(own, belief_input="variance"), m, T).memory
    np.testing.assert_allclose([one.value for one in memory.landmarks], 9.0, rtol=0.15)
    np.testing.assert_allclose([one.value for one in memory.vectors], 1.0, rtol=0.15)


def test_numbers_of_signals_are_set_by_name() -> None:
    filter = kalman(NoiseGains())
    other = filter.with_values({"belief_smoothing": jnp.asarray(0.7), "vector": jnp.asarray(0.3)})
    assert other.signals is not None
    assert float(other.signals.belief.smoothing) == 0.7
    assert float(other.noise.vector) == 0.3
    with pytest.raises(posegsa.PosegsaError, match="belief_smoothing: not a number"):
        KalmanFilter(numbers(NOISE)).with_values({"belief_smoothing": jnp.asarray(0.7)})
