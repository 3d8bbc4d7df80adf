"""The attitude filter for inertial sensors, live."""

import pickle
from typing import Any

import numpy as np
import pytest
from helpers.recordings import inertial_motion

import posegsa
from posegsa.errors import ArgumentError, MeasurementError, PosegsaWarning
from posegsa.stream_inputs import FIRST_SAMPLES

pytestmark = pytest.mark.quick


def test_the_attitude_filter_runs_live_as_it_replays() -> None:
    """Without a start; missing values are None; it pickles and continues from a checkpoint."""
    given = inertial_motion(2.0, 4.0, noise=0.3, shaking=2.0)
    given["mag"][np.arange(len(given["mag"])) % 3 != 0] = np.nan
    given["mag"][300:320] = np.nan
    recording = posegsa.imu(**given)
    replayed = posegsa.replay("imu", recording)[0].estimates
    live, m = posegsa.PoseFilter("imu"), recording.measurements
    for k in range(recording.samples - 1):
        if k == 250:
            checkpoint = live.checkpoint()
            live = pickle.loads(pickle.dumps(live))
            again = posegsa.PoseFilter("imu")
            again.restore(checkpoint)
        field = None if np.isnan(given["mag"][k]).any() else given["mag"][k]
        sample = {"time_step": m.time_step[k], "gyr": given["gyr"][k], "acc": given["acc"][k]}
        pose = live.update(**sample, mag=field)
        if k >= 250:
            np.testing.assert_array_equal(again.update(**sample, mag=field).rotation, pose.rotation)
        np.testing.assert_allclose(pose.rotation, replayed.rotation[k + 1], atol=1e-12)
        np.testing.assert_allclose(live.bias, replayed.bias[k + 1], atol=1e-12)
        assert bool(live.own_state.at_rest) or k != 185
    assert not bool(live.own_state.at_rest)
    assert 0.5 < live.own_state.field_belief <= 1
    assert 0 < live.own_state.inclination_deviation < live.own_state.heading_deviation < 0.2
    assert live.observable
    np.testing.assert_array_equal(live.pose.position, 0.0)


def fed_the_same(live: posegsa.PoseFilter, times: int, **sample: Any) -> None:
    for _ in range(times):
        live.update(**sample)


def test_a_time_step_in_milliseconds_is_said_once() -> None:
    live = posegsa.PoseFilter("imu")
    sample = {"gyr": np.zeros(3), "acc": [0, 0, 9.8]}
    fed_the_same(live, FIRST_SAMPLES - 1, time_step=10.0, **sample)
    with pytest.warns(
        PosegsaWarning, match="time_step: .*over 0.25 s .median 10 s.*a pause.*seconds"
    ):
        live.update(time_step=10.0, **sample)
    fed_the_same(live, FIRST_SAMPLES, time_step=10.0, **sample)
    # A pause among the first samples is none.
    live = posegsa.PoseFilter("imu")
    for k in range(FIRST_SAMPLES + 1):
        live.update(time_step=0.01 if k == 3 else 10.0, **sample)


def test_an_acceleration_in_multiples_of_g_is_said_once() -> None:
    live, sample = posegsa.PoseFilter("imu"), {"time_step": 0.01, "gyr": np.zeros(3)}
    fed_the_same(live, FIRST_SAMPLES - 1, **sample, acc=[0, 0, 0.98])
    fed_the_same(live, FIRST_SAMPLES, **sample)  # a slower accelerometer
    with pytest.warns(PosegsaWarning, match="acc: .*first 50.*median 0.98.*m/s") as said:
        fed_the_same(live, 2 * FIRST_SAMPLES, **sample, acc=[0, 0, 0.98])
    assert len(said) == 1
    live = posegsa.PoseFilter("imu")
    for k in range(FIRST_SAMPLES + 1):  # one that is dropped, or hit, at first
        live.update(**sample, acc=[0, 0, 9.8 if k > 40 else 0.5])


def test_names_of_inertial_sensors_have_one_meaning_each() -> None:
    live = posegsa.PoseFilter("imu")
    still = {"time_step": 0.01, "gyr": [0, 0, 0], "acc": [0, 0, 9.81]}
    with pytest.raises(ArgumentError, match="gyr with angular_velocity; allowed: one of"):
        live.update(**still, angular_velocity=[0, 0, 0])
    with pytest.raises(ArgumentError, match="acc, mag; allowed: without vectors"):
        live.update(**still, vectors=[None, None])
    with pytest.raises(MeasurementError, match="angular_velocity: missing"):
        live.update(time_step=0.01, acc=[0, 0, 9.81])
    with pytest.raises(MeasurementError, match=r"mag: must have the shape \(3\)"):
        live.update(**still, mag=[1.0, 2.0])
    with pytest.raises(MeasurementError, match=r"acc = 1e\+09; allowed"):
        live.update(**still | {"acc": [0, 0, 1e9]})


def test_the_attitude_filter_needs_two_references_that_are_not_parallel() -> None:
    with pytest.raises(ArgumentError, match="vector_references: are parallel"):
        posegsa.PoseFilter("imu", vector_references=[[0, 0, 9.81], [0, 0, -1]])


def test_after_a_pause_an_attitude_stream_states_that_it_knows_nothing() -> None:
    stream = posegsa.PoseFilter("imu")
    seen = {"gyr": np.zeros(3), "acc": [0.0, 0.0, 9.81], "mag": [0.0, 20.0, -40.0]}
    for _ in range(2000):
        stream.update(time_step=0.01, **seen)
    known = stream.own_state
    assert known.heading_deviation < 0.1
    assert known.heading_deviation.dtype == known.inclination_deviation.dtype == np.float64
    stream.update(time_step=10.0, **seen)
    unknown = stream.own_state
    assert unknown.heading_deviation == pytest.approx(1.0)
    assert unknown.inclination_deviation == pytest.approx(0.35 * np.sqrt(2))
    assert unknown.velocity == (0, 0)
