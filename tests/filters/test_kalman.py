"""The Kalman filter against a plain reference, against gtsam, and against statistics."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from helpers import reference_ekf
from helpers.arrays import as_arrays
from helpers.experiments import experiment
from helpers.filters import state_of
from helpers.measurements import random_measurements, random_poses, trajectory_cost
from helpers.measurements import reference_sample as sample_of
from helpers.reference import se3_exp
from jax import Array

from posegsa.errors import ArgumentError
from posegsa.filters.base import Samples, Sensors, samples_of
from posegsa.filters.covariance import Reset
from posegsa.filters.kalman import (
    KalmanFilter,
    KalmanNoise,
    KalmanState,
    propagate,
    update,
)
from posegsa.filters.rollout import simulate, simulate_cost, simulate_errors
from posegsa.filters.uncertainty import nees
from posegsa.model.cost import CostWeights
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, prepare
from posegsa.model.scenario import integrate, measure
from posegsa.model.se3 import exp, transform
from posegsa.model.signal import TruePose
from posegsa.model.vectors import VectorSettings
from posegsa.search.drawn_scenarios import scenario

PLAIN = reference_ekf.Noise(
    velocity=np.array([0.02, 0.02, 0.02, 0.01, 0.01, 0.01]),
    bias_walk=np.array([0.003, 0.003, 0.003, 0.002, 0.002, 0.002]),
    vector_walk=0.001,
    vector=0.1,
    landmark=0.2,
    pose=np.array([0.5, 0.5, 0.5, 2.0, 2.0, 2.0]),
    bias=np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3]),
    vector_bias=0.15,
)


def noise_of(plain: reference_ekf.Noise, dtype: Any = np.float64) -> KalmanNoise:
    """The same noise as `KalmanNoise`."""
    return as_arrays(
        KalmanNoise(
            angular_velocity=plain.velocity[0],
            velocity=plain.velocity[3],
            angular_walk=plain.bias_walk[0],
            linear_walk=plain.bias_walk[3],
            vector_walk=plain.vector_walk,
            vector=plain.vector,
            landmark=plain.landmark,
            initial_attitude=plain.pose[0],
            initial_position=plain.pose[3],
            initial_angular_bias=plain.bias[0],
            initial_linear_bias=plain.bias[3],
            initial_vector_bias=plain.vector_bias,
        ),
        dtype,
    )


def samples_for(m: Measurements, rotation: Any = None, position: Any = None) -> Samples:
    """The input of the filter, which does not depend on its noise."""
    return samples_of(KalmanFilter(noise_of(PLAIN, np.float32)), m, rotation, position)


def started(initial: FilterState, noise: KalmanNoise) -> KalmanState:
    """The state before the first sample; the vectors' biases that `initial` has are states."""
    learnt = len(initial.vector_biases)
    return KalmanFilter(noise, vector_biases=learnt > 0).start(initial, Sensors(learnt, 0))


def plain(noise: KalmanNoise) -> KalmanFilter:
    """The filter of 12 states."""
    return KalmanFilter(noise, vector_biases=False)


jitted_samples = jax.jit(samples_for)
jitted_prepare = jax.jit(prepare)


@jax.jit
def nees_of(state: KalmanState, truth: TruePose) -> Array:
    covariance = plain(noise_of(PLAIN, np.float32)).ready().pose_covariance(state)
    return nees(state.estimate, covariance, truth)


def leaves_close(got: Any, want: Any, atol: float) -> None:
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=atol)


def step(
    state: KalmanState,
    sample: Sample,
    noise: KalmanNoise,
    iterations: int = 1,
    reset: Reset = "off",
) -> KalmanState:
    """Process one sample, as in a user's own loop."""
    updated, found = update(state, sample, noise, iterations)
    return propagate(updated, found.correction, sample, noise, reset)


def held(state: KalmanState) -> tuple[Array, ...]:
    """T_est, b_est, the vectors' biases and Sigma."""
    estimate = state.estimate
    T = transform(estimate.rotation, estimate.position)
    return T, estimate.bias, estimate.vector_bias, state.covariance_matrix


@partial(jax.jit, static_argnums=(3, 4))
def one_by_one(
    state: KalmanState,
    samples: Sample,
    noise: KalmanNoise,
    iterations: int = 1,
    reset: Reset = "off",
) -> tuple[Array, ...]:
    """The numbers of `held` before each of N samples and after the last, (N + 1, ...)."""

    def body(state: KalmanState, now: Sample) -> tuple[KalmanState, tuple[Array, ...]]:
        return step(state, now, noise, iterations, reset), held(state)

    last, before = jax.lax.scan(body, state, samples)
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), before, held(last))


def first_of(samples: Samples) -> Sample:
    """The first sample by itself."""
    return jax.tree.map(lambda a: np.asarray(a)[0], samples.sample)


COUNT = 40
"""Samples in a sequence. It is always the same number, so that programs are compiled once."""


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("vectors", "landmarks", "learnt", "iterations", "reset"),
    [
        (1, 0, 0, 1, "off"),
        (0, 1, 0, 1, "two frames"),
        (2, 1, 2, 1, "off"),
        (1, 1, 0, 3, "off"),
        (2, 1, 2, 1, "two frames"),
        (2, 1, 2, 10, "off"),
    ],
    ids=[
        *("12 states, a vector", "reset, a landmark", "18 states", "iterated", "18 states, reset"),
        "18 states, iterated until it hardly changes",
    ],
)
def test_agrees_with_the_matrix_form(vectors, landmarks, learnt, iterations, reset) -> None:
    """Measurements that fit no pose, uneven steps and weights, a third of the sensors missing."""
    rng = np.random.default_rng(0)
    m = random_measurements(rng, COUNT, vectors, landmarks, missing=0.3)
    T, b = random_poses(rng, 1)[0], 0.3 * rng.normal(size=6)
    samples, noise = seen(m, rng), noise_of(PLAIN)
    state = started(state_of(T, b, learnt_vectors=learnt), noise)
    begin = reference_ekf.start(T, b, learnt, PLAIN)
    each = [sample_of(m, k) for k in range(COUNT)]
    want = reference_ekf.run(each, begin, PLAIN, iterations, reset)
    wanted = zip(*((one.T, one.b, one.c, one.Sigma) for one in want), strict=True)
    found = one_by_one(state, samples.sample, noise, iterations, reset)
    for got, expected in zip(found, wanted, strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    if iterations == 10:  # some samples end after one linearisation, some later, some not at all
        last = [
            [reference_ekf.update(one, s, PLAIN, most)[0].T for most in (1, 2, 9, 10)]
            for one, s in zip(want, each, strict=False)
            if np.any(s.sR) or np.any(s.sL)
        ]
        ended = {tuple(np.array_equal(T, of_one[-1]) for T in of_one[:-1]) for of_one in last}
        assert {(True,) * 3, (False, False, True), (False,) * 3} <= ended


def seen(m: Measurements, rng: np.random.Generator) -> Samples:
    """The input of the filter from measurements, with an unrelated truth."""
    truth = random_poses(rng, len(m.time_step))
    return jitted_samples(as_arrays(m, np.float64), truth[:, :3, :3], truth[:, :3, 3])


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("size", [1e-9, 0.05, 0.2, 3.0])
def test_the_nees_is_that_of_the_pose_error_in_exponential_coordinates(size) -> None:
    rng = np.random.default_rng(5)
    T = random_poses(rng, 1)[0]
    xi = np.concatenate([size * np.array([0.6, 0.0, -0.8]), rng.normal(size=3)])
    state = started(state_of(T), noise_of(PLAIN))
    truth = T @ se3_exp(xi)
    origin = truth[:3, :3].T @ truth[:3, 3]
    truth = TruePose(state_of(truth).attitude, (origin[0], origin[1], origin[2]))
    got = nees_of(state, truth)
    np.testing.assert_allclose(got, np.sum((xi / PLAIN.pose) ** 2), rtol=1e-9)


def test_the_reference_agrees_with_gtsam() -> None:
    """Without biases both are the same filter.

    gtsam moves the covariance to the new estimate by the exact Jacobian, so corrections are small.
    """
    gtsam = pytest.importorskip("gtsam", reason="gtsam is not installed")
    rng = np.random.default_rng(0)
    noise = replace(PLAIN, bias_walk=np.zeros(6), bias=np.zeros(6))
    state = reference_ekf.start(random_poses(rng, 1)[0], np.zeros(6), 0, noise)
    theirs = gtsam.InvariantEKFPose3(gtsam.Pose3(state.T), state.Sigma[:6, :6])
    m = random_measurements(rng, 100, 2, 1)
    for k in range(100):
        s = sample_of(m, k)
        H, _, expected, R = reference_ekf.linearised(state, s, noise)
        z = expected + 0.02 * rng.normal(size=len(expected))
        s = replace(s, vB=z[:6].reshape(2, 3), y=z[6:].reshape(1, 3))
        theirs.updateWithVector(expected, H[:, :6], z, R, True)
        displacement = se3_exp(np.concatenate([s.omega, s.v]) * s.dt)
        theirs.predict(gtsam.Pose3(displacement), np.diag(noise.velocity**2 * s.dt))
        state = reference_ekf.propagate(*reference_ekf.update(state, s, noise), s, noise)
        np.testing.assert_allclose(theirs.state().matrix(), state.T, rtol=0, atol=1e-5)
        np.testing.assert_allclose(theirs.covariance(), state.Sigma[:6, :6], rtol=0, atol=1e-5)


@pytest.mark.usefixtures("x64")
def test_a_step_is_the_same_jitted_and_not() -> None:
    rng = np.random.default_rng(1)
    samples = seen(random_measurements(rng, COUNT, 1, 0), rng)
    noise = noise_of(PLAIN)
    state = started(state_of(random_poses(rng, 1)[0]), noise)
    jitted = [a[1] for a in one_by_one(state, samples.sample, noise)]
    leaves_close(jitted, list(jax.jit(held)(step(state, first_of(samples), noise))), atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_all_simulations_are_the_same_steps() -> None:
    """Batched scenarios and noises, cost, errors and estimates agree with single steps."""
    rng = np.random.default_rng(2)
    weights = CostWeights(
        transient=jnp.asarray(rng.uniform(size=COUNT)),
        steady=jnp.asarray(rng.uniform(size=COUNT)),
        window=jnp.ones(COUNT, bool),
        position=jnp.asarray(0.2),
    )
    runs, places = [], []
    for _ in range(2):
        m = as_arrays(random_measurements(rng, COUNT, 1, 0, missing=0.2), np.float64)
        truth, T = random_poses(rng, COUNT), random_poses(rng, 1)[0]
        places.append(truth[:, :3, 3])
        samples = jitted_samples(m, truth[:, :3, :3], truth[:, :3, 3])
        runs.append((samples, state_of(T)))
    noises = [noise_of(PLAIN), noise_of(replace(PLAIN, vector=0.4, pose=2 * PLAIN.pose))]
    all_samples, all_initial = jax.tree.map(lambda *a: np.stack(a), *runs)
    all_noises = jax.tree.map(lambda *a: np.stack(a), *noises)

    def costs(samples: Samples, initial: FilterState) -> Array:
        return jax.vmap(lambda noise: simulate_cost(plain(noise), samples, initial, weights).total)(
            all_noises
        )

    together = jax.jit(jax.vmap(costs))(all_samples, all_initial)
    errors_of, cost_of = jax.jit(simulate_errors), jax.jit(trajectory_cost)
    for i, (samples, initial) in enumerate(runs):
        for j, noise in enumerate(noises):
            track = errors_of(plain(noise), samples, initial)
            alone = cost_of(track.attitude, track.position, weights).total
            np.testing.assert_allclose(together[i, j], alone, rtol=1e-10)
            assert np.isnan(track.gain).all()
        estimates = jax.tree.map(np.asarray, simulate(plain(noises[0]), samples, initial))
        away = np.linalg.norm(estimates.position - places[i], axis=1)
        track = errors_of(plain(noises[0]), samples, initial)
        np.testing.assert_allclose(track.distance, away, atol=1e-10)
        T, bias, _, _ = one_by_one(started(initial, noises[0]), samples.sample, noises[0])
        np.testing.assert_allclose(estimates.rotation, T[:-1, :3, :3], rtol=0, atol=1e-10)
        np.testing.assert_allclose(estimates.position, T[:-1, :3, 3], rtol=0, atol=1e-10)
        np.testing.assert_allclose(estimates.bias, bias[:-1], rtol=0, atol=1e-10)


@pytest.mark.usefixtures("x64")
def test_updates_that_end_after_different_iterations_are_the_same_together_and_alone() -> None:
    rng = np.random.default_rng(4)
    m = random_measurements(rng, COUNT, 2, 1)
    truth = random_poses(rng, 1)[0]
    R, P = truth[:3, :3], truth[:3, 3]
    m = m._replace(
        vectors=m.vector_references @ R + np.zeros_like(m.vectors),
        landmarks=(m.landmark_references - P) @ R + np.zeros_like(m.landmarks),
    )
    noise = noise_of(PLAIN)
    off = [np.zeros(3), [0.01, 0.0, 0.0], [0.0, 0.6, 0.0], [2.0, -1.0, 1.0]]
    turned = (truth @ se3_exp(np.concatenate([theta, np.zeros(3)])) for theta in off)
    states = [started(state_of(T, learnt_vectors=2), noise) for T in turned]
    sample = first_of(seen(m, rng))

    once, several = (
        [jax.jit(update, static_argnums=3)(one, sample, noise, most) for one in states]
        for most in (1, 10)
    )
    for i, same in enumerate((True, True, False, False)):
        one, other = (np.asarray(found[i][0].estimate.attitude) for found in (once, several))
        assert np.max(np.abs(other - one)) < 1e-14 if same else np.max(np.abs(other - one)) > 1e-6
    wide = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    together = jax.jit(update, static_argnums=3)(wide, sample, noise, 10)
    mapped = jax.jit(jax.vmap(lambda one: update(one, sample, noise, 10)))(wide)
    for i, want in enumerate(several):
        for got in (together, mapped):
            leaves_close(jax.tree.map(lambda a, i=i: a[i], got), want, atol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("iterations", [1, 10])
def test_without_measurements_an_update_changes_nothing(iterations: int) -> None:
    rng = np.random.default_rng(3)
    m = random_measurements(rng, COUNT, 2, 1)
    missing = m._replace(
        vectors=np.full_like(m.vectors, np.nan),
        vector_weights=np.zeros_like(m.vector_weights),
        landmarks=np.full_like(m.landmarks, np.nan),
        landmark_weights=np.zeros_like(m.landmark_weights),
    )
    noise = noise_of(PLAIN)
    state = started(state_of(random_poses(rng, 1)[0]), noise)
    sample = first_of(seen(missing, rng))
    updated, found = update(state, sample, noise, iterations)
    leaves_close(updated, state, atol=1e-15)
    # Iterated, it is the difference of an estimate from itself.
    assert not np.any(found.correction)


def test_samples_of_an_observer_that_learns_the_biases_serve_too() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(4), 3, 2, 1), np.float32)
    settings = VectorSettings(
        weights=(jnp.asarray(0.3), jnp.asarray(2.0)),
        cross_weight=jnp.asarray(1.0),
        normalise=True,
        cross=True,
        each_agent=True,
    )
    theirs, own = jitted_prepare(m, settings), jitted_samples(m).sample
    for a, b in zip(theirs.vectors.each, own.vectors.each, strict=True):
        leaves_close((a.measured, a.known, a.factor), (b.measured, b.known, b.factor), atol=0)
    sums = jax.eval_shape(prepare, m, replace(settings, weights=None, each_agent=False))
    noise = noise_of(PLAIN, np.float32)
    state = started(state_of(np.eye(4), dtype=np.float32), noise)
    with pytest.raises(ArgumentError, match=r"VectorSettings\(each_agent=True\)"):
        update(state, sums, noise)


# The paper's sensors; errors of the start and the biases are drawn with the last three fields.
SENSED = reference_ekf.Noise(
    velocity=np.array([0.2, 0.2, 0.2, 0.1, 0.1, 0.1]) * 0.01**0.5,
    bias_walk=np.zeros(6),
    vector_walk=0.0,
    vector=0.1,
    landmark=0.1,
    pose=np.array([0.05, 0.05, 0.05, 0.2, 0.2, 0.2]),
    bias=np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1]),
    vector_bias=0.05,
)
SIDE, CHUNK, BETWEEN = 10, 400, 20
"""Number of filters at once, samples in a chunk, and samples between two checks. Both tests below
share one program."""


@jax.jit
def scenarios(keys: Array) -> tuple[Samples, FilterState]:
    """The paper's motion and noise for 4 s, with random starts and biases."""

    def one(key: Array) -> tuple[Samples, FilterState]:
        of_start, of_noise = jax.random.split(key)
        deviations = np.concatenate([SENSED.pose, SENSED.bias, np.full(6, SENSED.vector_bias)])
        error = jax.random.normal(of_start, (18,)) * deviations.astype(np.float32)
        paper = scenario(experiment("float32", duration=0.01 * CHUNK))
        drawn = replace(paper, bias=error[6:12], vector_bias=error[12:].reshape(2, 3))
        truth = integrate(drawn)
        T = transform(truth.rotation[0], truth.position[0]) @ exp(-error[:6])
        m = measure(drawn, truth, of_noise).measurements
        initial = initial_state(T[:3, :3], T[:3, 3], learnt_vectors=2)
        return samples_for(m, truth.rotation, truth.position), initial

    return jax.vmap(one)(keys)


@partial(jax.jit, static_argnames=("reset", "iterations"))
def watched(
    states: KalmanState,
    samples: Samples,
    noises: KalmanNoise,
    reset: Reset = "off",
    iterations: int = 1,
) -> tuple[KalmanState, Any]:
    """The states after a chunk of samples; NEES and covariance before every 20th of them."""

    def one(state: KalmanState, samples: Samples, noise: KalmanNoise) -> tuple[KalmanState, Any]:
        def body(state: KalmanState, now: Sample) -> tuple[KalmanState, None]:
            return step(state, now, noise, iterations, reset), None

        def look(state: KalmanState, some: Samples) -> tuple[KalmanState, tuple[Array, Array]]:
            assert some.truth is not None
            now = nees_of(state, jax.tree.map(lambda a: a[0], some.truth)), state.covariance_matrix
            return jax.lax.scan(body, state, some.sample)[0], now

        parts = jax.tree.map(lambda a: a.reshape(CHUNK // BETWEEN, BETWEEN, *a.shape[1:]), samples)
        return jax.lax.scan(look, state, parts)

    return jax.vmap(one)(states, samples, noises)


starts = jax.jit(jax.vmap(started))


def test_consistent_for_small_initial_errors_and_the_true_noise() -> None:
    """The mean NEES of 100 runs with the noise that the filter assumes has the mean of chi^2(6)."""
    noise = as_arrays(
        jax.tree.map(lambda a: np.full(SIDE, a), noise_of(SENSED, np.float32)), np.float32
    )
    values = []
    for keys in jax.random.split(jax.random.key(0), (10, SIDE)):
        samples, initial = scenarios(keys)
        values.extend(np.asarray(watched(starts(initial, noise), samples, noise)[1][0]))
    assert len(values) == 100
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], 6 * len(values)) / len(values)
    mean = np.mean(values, axis=0)
    for k in (0, 20, 100, 200, CHUNK - BETWEEN):
        assert low < mean[k // BETWEEN] < high, (k, mean[k // BETWEEN])


@pytest.mark.parametrize(("reset", "iterations"), [("off", 1), ("two frames", 1), ("off", 10)])
def test_the_covariance_stays_positive_definite_in_float32(reset: Reset, iterations: int) -> None:
    """6000 steps from a large covariance; the assumed sensor noise is up to 20 times too small."""
    wide = replace(
        SENSED,
        pose=np.array([3.0, 3.0, 3.0, 30.0, 30.0, 30.0]),
        bias=np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0]),
        vector_bias=0.3,
    )
    sharpness = np.geomspace(1, 20, SIDE)
    noises = [
        noise_of(
            replace(wide, velocity=wide.velocity / s, vector=0.1 / s, landmark=0.1 / s), np.float32
        )
        for s in sharpness
    ]
    noise = as_arrays(jax.tree.map(lambda *a: np.stack(a), *noises), np.float32)
    samples, initial = scenarios(jax.random.split(jax.random.key(1), SIDE))
    state = starts(initial, noise)
    for _ in range(6000 // CHUNK):
        state, (_, sigma) = watched(state, samples, noise, reset, iterations)
        some = np.asarray(sigma, np.float64).reshape(-1, 18, 18)
        assert np.isfinite(some).all()
        np.testing.assert_array_equal(some, some.transpose(0, 2, 1))
        deviation = np.sqrt(np.diagonal(some, axis1=1, axis2=2))
        correlation = some / (deviation[:, :, None] * deviation[:, None, :])
        assert np.linalg.eigvalsh(correlation).min() > 0
