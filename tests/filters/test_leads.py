"""Velocities extrapolated to the middle of the step that they drive."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.errors import ArgumentError
from posegsa.filters.base import Sensors
from posegsa.filters.kalman import KalmanFilter
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter
from posegsa.search.configured_filters import filter_of

STEP = 0.01


def flight(*, mean: bool) -> tuple[Recording, Rotation]:
    """A body that swings at 1 Hz. Its gyroscope has no noise, and gives means over steps or not."""
    time = STEP * np.arange(1501)
    turn = Rotation.from_euler("z", 0.5 * np.sin(2 * np.pi * time)[:, None])
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / STEP
    if not mean:
        rate = np.stack([0 * time, 0 * time, np.pi * np.cos(2 * np.pi * time)], axis=1)[:-1]
    R = turn.as_matrix()[:-1]
    references = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    places = np.array([[2.0, 1.0, 0.0], [-2.0, 1.0, 1.0], [0.0, -2.0, 0.5]])
    rng = np.random.default_rng(3)
    recording = Recording.from_arrays(
        time=time[:-1],
        angular_velocity=rate,
        velocity=np.zeros((1500, 3)),
        vectors=np.einsum("kji,nj->kni", R, references) + 0.05 * rng.normal(size=(1500, 2, 3)),
        vector_references=references,
        landmarks=np.einsum("kji,nj->kni", R, places) + 0.05 * rng.normal(size=(1500, 3, 3)),
        landmark_references=places,
        truth_quaternion=turn[:-1].as_quat(scalar_first=True),
        truth_position=np.zeros((1500, 3)),
    )
    return recording, turn[:-1]


def kalman(**leads: float) -> config.Experiment:
    """Of 12 states, which are compiled in half the time of 18."""
    noises = {"angular_velocity": 1e-4, "velocity": 1e-4, "vector": 0.05, "landmark": 0.05}
    filter = {"kind": "kalman", "vector_bias": "off"} | noises | leads
    return config.from_dict({"run": {"dtype": "float64"}, "filter": filter, "parameters": {}})


def error_of(experiment: config.Experiment, recording: Recording, turn: Rotation) -> float:
    """Root mean square attitude error over the last 10 s [deg]."""
    with jax.enable_x64(True):
        found = run_filter(filter_of(experiment), recording).rotation
    off = (Rotation.from_matrix(np.asarray(found)) * turn.inv()).magnitude()[500:]
    return float(np.degrees(np.sqrt(np.mean(off**2))))


def test_half_a_step_makes_up_for_a_velocity_at_its_stamp() -> None:
    recording, turn = flight(mean=False)
    late = error_of(kalman(), recording, turn)
    assert late > 0.5, "half a step late at up to 3 rad/s"
    assert error_of(kalman(angular_lead=0.5), recording, turn) < 0.25 * late


def test_a_mean_over_the_step_needs_no_lead() -> None:
    recording, turn = flight(mean=True)
    assert error_of(kalman(), recording, turn) < 0.2
    assert error_of(kalman(angular_lead=0.5), recording, turn) > 0.5


@pytest.mark.quick
def test_each_sample_is_extrapolated_from_the_last_change() -> None:
    """By NumPy, with varying time steps; the first sample is unchanged."""
    rng = np.random.default_rng(0)
    steps = rng.uniform(0.005, 0.05, 200)
    turning, moving = rng.normal(size=(2, 200, 3))
    ahead = np.stack([0.7 * np.ones(3), 1.5 * np.ones(3)])
    share = np.minimum(1, steps[1:] / steps[:-1])[:, None]
    by_hand = [
        np.concatenate([a[:1], a[1:] + lead * share * np.diff(a, axis=0)])
        for a, lead in zip((turning, moving), ahead, strict=True)
    ]

    def found(filter: Any, angular: np.ndarray, linear: np.ndarray) -> Any:
        """In a recording with as many sensors as `flight`: the same program."""
        places = np.array([[2.0, 1.0, 0.0], [-2.0, 1.0, 1.0], [0.0, -2.0, 0.5]])
        recording = Recording.from_arrays(
            time_step=steps,
            angular_velocity=angular,
            velocity=linear,
            vectors=np.tile(np.eye(3)[:2], (200, 1, 1)),
            vector_references=np.eye(3)[:2],
            landmarks=np.tile(places, (200, 1, 1)),
            landmark_references=places,
        )
        return run_filter(filter, recording, posegsa.initial_state(np.eye(3), np.zeros(3)))

    with jax.enable_x64(True):
        led = found(filter_of(kalman(angular_lead=0.7, linear_lead=1.5)), turning, moving)
        expected = found(filter_of(kalman()), *by_hand)
    np.testing.assert_allclose(led.rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(led.position, expected.position, atol=1e-12)
    assert np.abs(led.rotation[-1] - np.eye(3)).max() > 1e-3, "it turns"


@pytest.mark.quick
def test_a_filter_without_leads_has_no_state_for_them() -> None:
    plain, led = filter_of(kalman()), filter_of(kalman(angular_lead=0.5))
    start = posegsa.initial_state(np.eye(3), np.zeros(3))
    assert isinstance(plain, KalmanFilter)
    assert plain.start(start, Sensors(0, 0)).last == ()
    assert len(jax.tree.leaves(led.start(start, Sensors(0, 0)).last)) == 7
    with pytest.raises(ArgumentError, match="angular_lead: not a number of this filter"):
        plain.with_values({"angular_lead": np.float32(0.5)})


@pytest.mark.quick
def test_a_scale_divides_the_weight_of_its_sensor() -> None:
    """As if the weights had been given with the measurements."""
    rng = np.random.default_rng(1)

    def measured(weights: np.ndarray) -> posegsa.Measurements:
        return posegsa.Measurements.from_arrays(
            dtype=np.float64,
            time_step=0.01,
            angular_velocity=np.zeros((3, 3)),
            velocity=np.zeros((3, 3)),
            vectors=np.tile(np.eye(3), (3, 1, 1)) + 0.1 * rng.normal(size=(1, 3, 3)),
            vector_references=np.eye(3),
            vector_weights=weights,
        )

    given = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 2.0], [1.0, 1.0, 1.0]])
    with jax.enable_x64(True):
        start = posegsa.initial_state(np.eye(3), np.zeros(3))
        one = filter_of(config.override(kalman(), ["filter.vector_scales=[1.0,4.0]"]))
        found = run_filter(one, measured(given), start)
        rng = np.random.default_rng(1)
        by_hand = measured(given / [1.0, 16.0, 1.0])
        expected = run_filter(filter_of(kalman()), by_hand, start)
        np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-15)
