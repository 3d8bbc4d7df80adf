"""Truth and sensor errors, against the reference's integration and the sensors' equations."""

import warnings
from dataclasses import replace
from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.experiments import AT_REST, experiment
from jax import Array
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from posegsa.config import Landmark, Sine, Vector
from posegsa.errors import PosegsaWarning
from posegsa.model.measurements import Measurements
from posegsa.model.scenario import (
    Bursts,
    Jumps,
    NoiseJumps,
    Scenario,
    Truth,
    integrate,
    measure,
)
from posegsa.search.drawn_scenarios import all_scenarios, scenario

SILENT = {
    "angular_velocity_noise": 0.0,
    "velocity_noise": 0.0,
    "angular_velocity_bias": (0.0, 0.0, 0.0),
    "velocity_bias": (0.0, 0.0, 0.0),
}
"""Velocities without errors; each vector and landmark sets its own errors."""

SINES = (
    (Sine(amplitude=1.0, frequency=0.7), Sine(amplitude=-0.4, frequency=3.0, phase=1.0)),
    (),
    (Sine(amplitude=0.5, frequency=0.3, phase=2.0),),
)
"""Two sines, none and one."""

START = {
    "initial_rotation": Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix().tolist(),
    "initial_position": (1.0, -2.0, 0.5),
}


jitted_integrate, jitted_sense = jax.jit(integrate), jax.jit(measure)


def jitted_measure(s: Scenario, truth: Truth, key: Array) -> Measurements:
    return jitted_sense(s, truth, key).measurements


def vector(*direction: float, **errors: object) -> Vector:
    return Vector(direction=direction, **({"noise": 0.0} | errors))


def landmark(*position: float, **errors: object) -> Landmark:
    return Landmark(position=position, **({"noise": 0.0} | errors))


def sum_of_sines(axes: tuple[tuple[Sine, ...], ...], time: np.ndarray) -> np.ndarray:
    """(N, 3), by the definition."""
    return np.array(
        [
            [sum(s.amplitude * np.sin(s.frequency * t + s.phase) for s in axis) for axis in axes]
            for t in time
        ]
    )


def simulated(s: Scenario, seed: int = 0) -> tuple[Truth, Measurements]:
    truth = jitted_integrate(s)
    return truth, jitted_measure(s, truth, jax.random.key(seed))


def same(got: object, want: object, **tolerance: float) -> None:
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        np.testing.assert_allclose(a, b, **({"rtol": 0, "atol": 0} | tolerance))


# The truth ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"angular_velocity": SINES, "velocity": SINES[::-1], **START},
        {"sampling_time": 0.1, "duration": 30.0},
    ],
    ids=["paper", "sums of sines, another start", "long steps"],
)
def test_truth_equals_the_references_integration(changes) -> None:
    given = {"duration": 3.0, **changes}
    e = experiment(**given)
    c = e.scenario
    truth = jitted_integrate(scenario(e))
    time = np.arange(c.samples) * c.sampling_time
    omega = sum_of_sines(c.angular_velocity, time)
    v = sum_of_sines(c.velocity, time)
    T0 = np.eye(4)
    T0[:3, :3], T0[:3, 3] = c.initial_rotation, c.initial_position
    poses = reference.integrate_truth(omega, v, np.full(c.samples, c.sampling_time), T0)
    np.testing.assert_allclose(truth.time, time, atol=1e-12)
    np.testing.assert_allclose(truth.angular_velocity, omega, atol=1e-13)
    np.testing.assert_allclose(truth.velocity, v, atol=1e-13)
    np.testing.assert_allclose(truth.rotation, poses[:, :3, :3], atol=1e-11)
    np.testing.assert_allclose(truth.position, poses[:, :3, 3], atol=1e-11)


@pytest.mark.usefixtures("x64")
def test_truth_at_rest_stays_where_it_starts() -> None:
    truth = jitted_integrate(scenario(experiment(duration=3.0, **AT_REST, **START)))
    want = np.tile(START["initial_rotation"], (300, 1, 1))
    np.testing.assert_allclose(truth.rotation, want, atol=1e-14)
    np.testing.assert_array_equal(truth.position, np.tile(START["initial_position"], (300, 1)))


# Sensors without noise ---------------------------------------------------------------------------

SENSORS = {
    "duration": 0.5,
    "vectors": (
        vector(2.0, 0.0, 1.0, bias=(0.3, 0.0, -0.1), weight=0.5),
        vector(0.0, 0.0, 3.0, bias=(0.0, 0.2, 0.0), weight=2.0),
    ),
    "landmarks": (landmark(1.0, 2.0, 3.0, bias=(0.0, 0.5, 0.0)), landmark(-4.0, 0.0, 1.0)),
    **START,
    **SILENT,
}


NEVER = ((1e9, 2e9), (3e9, 4e9))


def lively(given: dict[str, Any] | None = None, **changes: Any) -> Scenario:
    """A scenario of 50 samples with two vectors and two landmarks, with other numbers.

    It has two outages, bursts, jumps of the noise of each sensor and two of the body, all after the
    end by default, so that all scenarios share one program.
    """
    s = scenario(experiment(**(SENSORS | (given or {}))))
    windows = jnp.asarray(NEVER)
    never = Bursts(jnp.tile(windows[None], (2, 1, 1)), jnp.ones((2, 2, 3)))
    always = {
        **{"vector_outages": windows, "landmark_outages": windows},
        **{"bursts": never, "landmark_bursts": never},
        "noise_jumps": NoiseJumps(jnp.full((6, 2), 1e9), jnp.full((6, 2), 7.0)),
        "landmark_turns": jnp.zeros(0),
        "jumps": Jumps(jnp.full(2, 1e9), jnp.ones((2, 6))),
    }
    return replace(s, **(always | changes))


def from_body(truth: Truth, a: np.ndarray) -> np.ndarray:
    """R^T a for each sample, in a loop."""
    return np.array([R.T @ b for R, b in zip(np.asarray(truth.rotation), a, strict=True)])


@pytest.mark.usefixtures("x64")
def test_noise_free_vectors_are_the_turned_ones_with_bias() -> None:
    truth, m = simulated(lively())
    for i, v in enumerate(SENSORS["vectors"]):
        seen = from_body(truth, np.tile(v.direction, (50, 1))) + v.bias
        np.testing.assert_allclose(np.asarray(m.vectors)[:, i], seen, atol=1e-14)
        assert (np.asarray(m.vector_references)[:, i] == v.direction).all()
    # The filter has its own weights; these only mark what is missing.
    np.testing.assert_array_equal(m.vector_weights, np.ones((50, 2)))


@pytest.mark.usefixtures("x64")
def test_noise_free_landmarks_and_velocities() -> None:
    c = experiment(**SENSORS).scenario
    truth, m = simulated(lively())
    for i, p in enumerate(c.landmarks):
        y = from_body(truth, np.array(p.position) - np.asarray(truth.position)) + p.bias
        np.testing.assert_allclose(np.asarray(m.landmarks)[:, i], y, atol=1e-14)
        assert (np.asarray(m.landmark_references)[:, i] == p.position).all()
    assert (np.asarray(m.landmark_weights) == 1).all()
    np.testing.assert_array_equal(m.angular_velocity, truth.angular_velocity)
    np.testing.assert_array_equal(m.velocity, truth.velocity)
    np.testing.assert_array_equal(m.time_step, np.full(50, 0.01))


@pytest.mark.usefixtures("x64")
def test_velocity_biases_are_added() -> None:
    biases = {"angular_velocity_bias": (0.1, -0.2, 0.3), "velocity_bias": (1.0, 2.0, 3.0)}
    truth, m = simulated(lively(biases))
    for name, bias in biases.items():
        sensor = name.removesuffix("_bias")
        shift = np.asarray(getattr(m, sensor)) - np.asarray(getattr(truth, sensor))
        np.testing.assert_allclose(shift, np.tile(bias, (50, 1)), atol=1e-14)


def test_landmarks_alone_make_a_scenario() -> None:
    e = experiment(
        "float32",
        duration=0.1,
        vectors=(),
        cross_vector=False,
        landmarks=tuple(landmark(*p) for p in np.eye(3).tolist()),
    )
    s = scenario(e)
    truth = jax.eval_shape(integrate, s)
    m = jax.eval_shape(measure, s, truth, jax.random.key(0)).measurements
    assert m.vectors.shape == (10, 0, 3)
    assert m.landmarks.shape == (10, 3, 3)


# Noise -------------------------------------------------------------------------------------------

NOISES = {
    "angular_velocity": 0.2,
    "velocity": 0.7,
    "vector 0": 0.3,
    "vector 1": 0.05,
    "landmark 0": 0.1,
    "landmark 1": 2.0,
}
NOISY = {
    "duration": 50.0,
    "angular_velocity_noise": NOISES["angular_velocity"],
    "velocity_noise": NOISES["velocity"],
    "vectors": (
        vector(1.0, 0.0, 0.0, noise=NOISES["vector 0"]),
        vector(0.0, 0.0, 3.0, noise=NOISES["vector 1"]),
    ),
    "landmarks": (
        landmark(1.0, 2.0, 3.0, noise=NOISES["landmark 0"]),
        landmark(0.0, 0.0, 0.0, noise=NOISES["landmark 1"]),
    ),
}


def noises(m: Measurements, silent: Measurements) -> dict[str, np.ndarray]:
    """The noise in each sensor, (N, 3)."""
    d = jax.tree.map(lambda a, b: np.asarray(a, np.float64) - np.asarray(b, np.float64), m, silent)
    vectors = {f"vector {i}": d.vectors[:, i] for i in range(2)}
    landmarks = {f"landmark {i}": d.landmarks[:, i] for i in range(2)}
    return {"angular_velocity": d.angular_velocity, "velocity": d.velocity, **vectors, **landmarks}


@pytest.fixture(scope="module")
def residuals() -> dict[str, np.ndarray]:
    """Noise of each sensor over 5000 samples."""
    given = {k: v for k, v in NOISY.items() if not k.endswith("_noise")}
    given["vectors"] = tuple(v.model_copy(update={"noise": 0.0}) for v in NOISY["vectors"])
    given["landmarks"] = tuple(p.model_copy(update={"noise": 0.0}) for p in NOISY["landmarks"])
    with jax.enable_x64(True):
        truth, silent = simulated(
            scenario(experiment(**given, angular_velocity_noise=0.0, velocity_noise=0.0))
        )
        noisy = jitted_measure(scenario(experiment(**NOISY)), truth, jax.random.key(3))
        return noises(noisy, silent)


@pytest.mark.parametrize(("sensor", "deviation"), NOISES.items())
def test_noise_has_the_standard_deviation_asked_for_and_mean_zero(
    residuals, sensor, deviation
) -> None:
    noise = residuals[sensor]
    count = noise.shape[0]
    # Five standard deviations of the estimates: s / sqrt(N) of the mean, s / sqrt(2N) of s.
    np.testing.assert_allclose(noise.mean(axis=0), 0, atol=5 * deviation / np.sqrt(count))
    np.testing.assert_allclose(noise.std(axis=0), deviation, rtol=5 / np.sqrt(2 * count))


def test_noise_is_normal(residuals) -> None:
    # The share beyond one and two standard deviations, 0.3173 and 0.0455, over 90 000 draws.
    z = np.concatenate([residuals[k] / s for k, s in NOISES.items()], axis=None)
    assert np.mean(np.abs(z) > 1) == pytest.approx(0.3173, abs=0.008)
    assert np.mean(np.abs(z) > 2) == pytest.approx(0.0455, abs=0.004)


def test_noises_are_independent_between_sensors_axes_and_samples(residuals) -> None:
    columns = np.concatenate([residuals[k] / s for k, s in NOISES.items()], axis=1)
    limit = 5 / np.sqrt(len(columns))
    for i, j in combinations(range(columns.shape[1]), 2):
        assert abs(np.mean(columns[:, i] * columns[:, j])) < limit, (i, j)
    later = np.mean(columns[1:] * columns[:-1], axis=0)
    assert (np.abs(later) < limit).all()
    # No draw is used twice: all values differ, except by chance (1 %).
    values = np.round(columns, 6)
    assert len(np.unique(values)) > 0.95 * values.size


def test_same_key_gives_the_same_measurements_in_both_precisions() -> None:
    def measured(dtype: str) -> Measurements:
        with jax.enable_x64(dtype == "float64"):
            m = simulated(scenario(experiment(dtype, duration=0.5)))[1]
            assert {a.dtype.name for a in m} == {dtype}
            return jax.tree.map(np.asarray, m)

    # 50 steps of rounding in float32; two draws of noise would differ by 0.1.
    same(measured("float32"), measured("float64"), atol=1e-5)


def test_same_key_gives_the_same_and_another_key_other_measurements() -> None:
    s = scenario(experiment("float32", duration=0.5))
    (_, a), (_, again), (_, b) = (simulated(s, seed) for seed in (0, 0, 1))
    same(a, again)
    for name in ("angular_velocity", "velocity", "vectors", "landmarks"):
        assert (np.asarray(getattr(a, name)) != np.asarray(getattr(b, name))).all(), name
    np.testing.assert_array_equal(a.vector_references, b.vector_references)


# Realistic sensors: drift, outages and bursts ---------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_at_rest_the_body_does_not_move_and_afterwards_it_does() -> None:
    given = {"duration": 0.5, **START}
    moving = jitted_integrate(scenario(experiment(**given)))
    rests = jitted_integrate(scenario(experiment(**given, rest=((0.0, 0.095), (0.295, 0.395)))))
    still = np.r_[0:10, 30:40]
    for name in ("angular_velocity", "velocity"):
        want = np.array(getattr(moving, name))
        want[still] = 0
        np.testing.assert_array_equal(getattr(rests, name), want)
    for name in ("rotation", "position"):
        poses = np.asarray(getattr(rests, name))
        np.testing.assert_allclose(poses[:11], np.broadcast_to(poses[:1], poses[:11].shape))
        np.testing.assert_allclose(poses[31:41], np.broadcast_to(poses[30:31], poses[31:41].shape))
        assert np.abs(poses[20] - poses[10]).max() > 1e-3


WINDOWS = ((0.095, 0.195), (0.295, 0.305))
"""Samples 10 to 19, and 30."""
LIVELY = np.r_[10:20, 30]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("sensor", ["vector", "landmark"])
def test_in_an_outage_nothing_of_a_sensor_is_measured(sensor: str) -> None:
    _, m = simulated(lively(**{f"{sensor}_outages": jnp.asarray(WINDOWS)}))
    seen = np.ones((50, 2))
    seen[LIVELY] = 0
    other = {"vector": "landmark", "landmark": "vector"}[sensor]
    np.testing.assert_array_equal(getattr(m, f"{sensor}_weights"), seen)
    np.testing.assert_array_equal(getattr(m, f"{other}_weights"), np.ones((50, 2)))


@pytest.mark.usefixtures("x64")
def test_landmarks_are_measured_once_in_a_period() -> None:
    _, m = simulated(lively({"landmark_period": 5}))
    seen = np.zeros((50, 2))
    seen[::5] = 1
    np.testing.assert_array_equal(m.landmark_weights, seen)
    np.testing.assert_array_equal(m.vector_weights, np.ones((50, 2)))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", ["vector", "landmark"])
def test_a_burst_is_added_to_one_sensor_while_it_lasts(kind: str) -> None:
    offsets = np.array([[0.5, 0.0, -1.0], [0.0, 2.0, 0.0], [3.0, 0.0, 0.0]])
    never = NEVER[0]
    windows = [[WINDOWS[0], WINDOWS[1]], [(0.145, 0.245), never]]
    given = [[offsets[0], offsets[1]], [offsets[2], offsets[2]]]
    bursts = Bursts(jnp.asarray(windows), jnp.asarray(given))
    name = {"vector": "bursts", "landmark": "landmark_bursts"}[kind]
    (_, quiet), (_, disturbed) = simulated(lively()), simulated(lively(**{name: bursts}))
    added = np.zeros((50, 2, 3))
    added[10:20, 0] = offsets[0]
    added[30, 0] = offsets[1]
    added[15:25, 1] = offsets[2]
    change = np.asarray(getattr(disturbed, f"{kind}s")) - np.asarray(getattr(quiet, f"{kind}s"))
    np.testing.assert_allclose(change, added, atol=1e-14)
    same(disturbed._replace(**{f"{kind}s": getattr(quiet, f"{kind}s")}), quiet)


@pytest.mark.usefixtures("x64")
def test_a_vector_has_a_period_and_a_time_from_which_on_it_is_measured() -> None:
    slow = (
        vector(2.0, 0.0, 1.0, period=3),
        vector(0.0, 0.0, 3.0, period=10, begin=0.2),
    )
    _, m = simulated(lively({"vectors": slow}))
    seen = np.zeros((50, 2))
    seen[::3, 0] = 1
    seen[20::10, 1] = 1
    np.testing.assert_array_equal(m.vector_weights, seen)
    np.testing.assert_array_equal(m.landmark_weights, np.ones((50, 2)))


@pytest.mark.parametrize("begin", [0.07, 0.29, 2.0, 4.35, 1e8])
def test_a_vector_begins_at_the_first_sample_that_is_not_before_its_time(begin: float) -> None:
    vectors = (vector(1.0, 0.0, 0.0, begin=begin), vector(0.0, 1.0, 0.0, begin=begin + 0.004))
    first = scenario(experiment("float32", vectors=vectors)).vector_begin
    wanted = [min(round(begin * 100) + late, 2**31 - 1) for late in (0, 1)]
    np.testing.assert_array_equal(first, wanted)


@pytest.mark.usefixtures("x64")
def test_landmarks_in_turn_are_in_sight_one_at_a_time() -> None:
    turns = jnp.asarray([0.055, 0.105, 0.295, 0.395])
    _, m = simulated(lively({"landmark_period": 2}, landmark_turns=turns))
    seen = np.zeros((50, 2))
    seen[6:11:2, 0] = 1
    seen[12:30:2, 1] = 1
    seen[30:40:2, 0] = 1
    seen[40:50:2, 1] = 1
    np.testing.assert_array_equal(m.landmark_weights, seen)
    np.testing.assert_array_equal(m.vector_weights, np.ones((50, 2)))


@pytest.mark.usefixtures("x64")
def test_noise_is_multiplied_by_its_factor_from_each_jump_on() -> None:
    noisy = {"duration": 0.5} | {key: NOISY[key] for key in NOISY if key != "duration"}
    rng = np.random.default_rng(0)
    jumps = NoiseJumps(
        jnp.asarray(np.sort(rng.uniform(0, 0.5, (6, 2)), axis=1)),
        jnp.asarray(rng.uniform(0.5, 4, (6, 2))),
    )
    (_, plain), (_, jumping) = (
        simulated(lively(noisy, **changes)) for changes in ({}, {"noise_jumps": jumps})
    )
    silent = {"vectors": [], "landmarks": []}
    for kind, sensors in silent.items():
        sensors += [one.model_copy(update={"noise": 0.0}) for one in noisy[kind]]
    truth, quiet = simulated(lively({"duration": 0.5, **silent}))
    before, after = noises(plain, quiet), noises(jumping, quiet)
    for i, name in enumerate(before):
        for k, t in enumerate(np.asarray(truth.time)):
            past = [f for at, f in zip(jumps.time[i], jumps.factor[i], strict=True) if at <= t]
            factor = float(past[-1]) if past else 1.0
            wanted = factor * before[name][k]
            np.testing.assert_allclose(after[name][k], wanted, atol=1e-12, err_msg=name)


@pytest.mark.usefixtures("x64")
def test_the_body_jumps_between_two_samples_and_no_velocity_shows_it() -> None:
    twists = np.array([[0.3, -1.0, 0.5, 1.0, 2.0, -3.0], [0.0, 0.0, 3.0, 0.0, 0.0, 0.5]])
    jumps = Jumps(jnp.asarray([0.1049, 0.3], jnp.float64), jnp.asarray(twists))
    (still, seen), (jumped, sensed) = simulated(lively()), simulated(lively(jumps=jumps))
    for name in ("angular_velocity", "velocity"):
        np.testing.assert_array_equal(getattr(jumped, name), getattr(still, name))
        np.testing.assert_array_equal(getattr(sensed, name), getattr(seen, name))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = still.rotation[0], still.position[0]
    at = {10: twists[0], 29: twists[1]}
    for k in range(50):
        np.testing.assert_allclose(jumped.rotation[k], pose[:3, :3], atol=1e-12)
        np.testing.assert_allclose(jumped.position[k], pose[:3, 3], atol=1e-12)
        step = 0.01 * np.concatenate([still.angular_velocity[k], still.velocity[k]])
        pose = pose @ exponential(step) @ exponential(at.get(k, np.zeros(6)))
    # The sensors see where it is.
    landmark_0 = np.asarray(SENSORS["landmarks"][0].position)
    body = from_body(jumped, landmark_0 - np.asarray(jumped.position))
    body = body + np.array([0.0, 0.5, 0.0])
    np.testing.assert_allclose(np.asarray(sensed.landmarks)[:, 0], body, atol=1e-13)


def exponential(xi: np.ndarray) -> np.ndarray:
    """exp(xi^) by the power series of the matrix."""
    (x, y, z), v = xi[:3], xi[3:]
    return expm(
        np.block([[np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), v[:, None]], [np.zeros((1, 4))]])
    )


@pytest.mark.usefixtures("x64")
def test_the_velocities_biases_drift_as_random_walks_and_change_no_other_noise() -> None:
    steady = scenario(experiment(**NOISY))
    drifts = scenario(experiment(**NOISY, angular_velocity_drift=0.3, velocity_drift=2.0))
    truth, key = jitted_integrate(steady), jax.random.key(5)
    a, b = jitted_sense(steady, truth, key), jitted_sense(drifts, truth, key)
    np.testing.assert_array_equal(a.bias, np.tile(steady.bias, (5000, 1)))
    np.testing.assert_array_equal(b.bias[0], steady.bias)
    for name, part in (("angular_velocity", slice(3)), ("velocity", slice(3, 6))):
        free = (np.asarray(getattr(s.measurements, name)) - s.bias[:, part] for s in (a, b))
        np.testing.assert_allclose(*free, atol=1e-12)
    same(a.measurements.vectors, b.measurements.vectors)
    # Increments over 0.01 s have the deviation s sqrt(0.01), to 5 deviations of the estimate.
    moved = np.diff(b.bias, axis=0) / (0.1 * np.repeat([0.3, 2.0], 3))
    np.testing.assert_allclose(moved.std(axis=0), 1, rtol=5 / np.sqrt(2 * 4999))
    np.testing.assert_allclose(moved.mean(axis=0), 0, atol=5 / np.sqrt(4999))
    together = np.corrcoef(moved.T) - np.eye(6)
    assert np.abs(together).max() < 5 / np.sqrt(4999)


# Structure ---------------------------------------------------------------------------------------


def test_the_papers_initial_attitude_estimate_is_projected_in_silence() -> None:
    e = experiment("float32", duration=0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        all_scenarios(e)
    s = scenario(e)
    U, stretch, Vt = np.linalg.svd(e.scenario.initial_rotation_estimate)
    assert stretch.min() < 0.95
    np.testing.assert_allclose(s.rotation_estimate, U @ Vt, atol=1e-7)


def test_another_estimate_that_is_not_a_rotation_is_projected_with_a_warning() -> None:
    rounded = ((-0.83, 0.29, 0.34), (0.4, 0.16, 0.9), (0.21, 0.94, -0.26))
    e = experiment("float32", duration=0.05, initial_rotation_estimate=rounded)
    with pytest.warns(PosegsaWarning, match=r"initial_rotation_estimate.*determinant 0\.9"):
        all_scenarios(e)
    s = scenario(e)
    U, _, Vt = np.linalg.svd(e.scenario.initial_rotation_estimate)
    np.testing.assert_allclose(s.rotation_estimate, U @ Vt, atol=1e-7)


def test_a_rotation_as_initial_estimate_is_used_unchanged_without_a_warning() -> None:
    R = Rotation.from_rotvec([0.1, 0.2, 3.0]).as_matrix()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        e = experiment("float32", duration=0.05, initial_rotation_estimate=R.tolist())
        all_scenarios(e)
    s = scenario(e)
    np.testing.assert_allclose(s.rotation_estimate, R, atol=1e-7)


def test_initial_estimates_are_those_configured() -> None:
    s = scenario(experiment("float32", initial_bias_estimate=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)))
    assert s.position_estimate.tolist() == [4, -3, 5]
    assert s.bias_estimate.tolist() == [1, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(s.bias, [0.1, -0.1, 0.1, 0.2, 0.5, 0.1])


@pytest.mark.usefixtures("x64")
def test_vmap_over_keys_equals_a_loop() -> None:
    s = scenario(experiment(duration=0.5))
    truth, keys = jitted_integrate(s), jax.random.split(jax.random.key(0), 3)
    together = jax.jit(jax.vmap(measure, in_axes=(None, None, 0)))(s, truth, keys)
    loop = [jitted_sense(s, truth, key) for key in keys]
    same(together, jax.tree.map(lambda *a: np.stack(a), *loop), atol=1e-13)


def test_numbers_change_without_compiling_again() -> None:
    given = {
        "duration": 0.5,
        "landmark_period": 3,
        "velocity_noise": 0.1,
        "angular_velocity_bias": (0.1, 0.2, 0.3),
    }
    other = {"duration": 0.5, "velocity_noise": 0.5, "angular_velocity_bias": (0.0, 0.0, 0.0)}
    compiled = []
    for seed, changes in enumerate((given, other, {**other, **START})):
        simulated(scenario(experiment("float32", **changes)), seed)
        compiled.append((jitted_integrate._cache_size(), jitted_sense._cache_size()))
    assert compiled[0] == compiled[1] == compiled[2]
