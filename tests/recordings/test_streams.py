"""Sensors with time stamps of their own on one clock."""

from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import LANDMARKS, motion
from scipy.spatial.transform import Rotation

from posegsa.errors import MeasurementError, RecordingError
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick

FIRST = 1_700_000_000_000_000_000
TIME = FIRST + 10_000_000 * np.arange(400)
"""A clock of 100 Hz [ns]."""


def streams(**changes: Any) -> dict[str, Any]:
    """`motion` as streams: velocity at 50 Hz, landmarks at 10 Hz and 3 ms late, truth at 100 Hz."""
    given = motion()
    R = Rotation.from_matrix(given["truth_rotation"])
    found = {
        "angular_velocity": (TIME, given["angular_velocity"]),
        "velocity": (TIME[::2], given["velocity"][::2]),
        "landmarks": [(TIME[::10] + 3_000_000, given["landmarks"][::10, n]) for n in range(3)],
        "landmark_references": LANDMARKS,
        "truth_quaternion": (TIME, R.as_quat(scalar_first=True)),
        "truth_position": (TIME, given["truth_position"]),
    }
    return found | changes


def refusal(**changes: Any) -> str:
    with pytest.raises(MeasurementError) as caught:
        Recording.from_streams(**streams(**changes))
    return str(caught.value)


def test_a_sample_goes_to_the_nearest_stamp_and_is_missing_elsewhere() -> None:
    recording = Recording.from_streams(**streams())
    m = recording.measurements
    seen = np.asarray(m.landmark_weights) > 0
    assert np.flatnonzero(seen[:, 1]).tolist() == list(range(0, 400, 10))
    np.testing.assert_array_equal(m.landmarks[::10], motion()["landmarks"][::10])
    assert_states(recording.describe(), "landmarks[1]", "40 samples", "10 Hz", "3 ms")


def test_a_velocity_is_held_as_a_filter_has_it_live() -> None:
    ramp = np.arange(200.0)[:, None] * np.ones(3)
    recording = Recording.from_streams(**streams(velocity=(TIME[::2] + 1, ramp)))
    # At the even stamps the value of the same time has not come yet.
    np.testing.assert_array_equal(recording.measurements.velocity[:5, 0], [0, 0, 1, 1, 2])
    assert_states(recording.describe(), "velocity", "50 Hz", "held", "1 sample")


def test_streams_are_interpolated_where_the_user_says_so() -> None:
    velocity = (TIME[::2], np.arange(200.0)[:, None] * np.ones(3))
    given = streams()
    given["truth_quaternion"] = tuple(a[::2] for a in given["truth_quaternion"])
    between = {"velocity": "interpolate", "truth": "interpolate", "landmarks": "hold"}
    recording = Recording.from_streams(**given | {"velocity": velocity, "between": between})
    assert recording.samples == 399  # up to the last velocity
    np.testing.assert_allclose(recording.measurements.velocity[:4, 0], [0, 0.5, 1, 1.5])
    assert recording.truth is not None
    expected = motion()["truth_rotation"][:399]
    np.testing.assert_allclose(recording.truth.rotation, expected, atol=1e-4)
    seen = np.asarray(recording.measurements.landmark_weights) > 0
    assert seen[1:].all()
    assert not seen[0].any()  # nothing has come yet
    assert_states(recording.describe(), "truth_quaternion", "interpolated", "landmarks[0]", "held")


def test_nothing_is_held_or_interpolated_for_longer_than_the_longest_gap() -> None:
    position = streams()["truth_position"]
    kept = np.r_[0:100, 250:400]
    some = tuple(a[kept] for a in position)
    recording = Recording.from_streams(
        **streams(truth_position=some, between={"truth": "interpolate"}, longest_gap=1.0)
    )
    assert recording.truth is not None
    assert recording.truth.position is not None
    known = np.isfinite(recording.truth.position).all(axis=1)
    assert np.flatnonzero(~known).tolist() == list(range(100, 250))
    velocity = tuple(a[np.r_[0:50, 125:200]] for a in streams()["velocity"])
    assert_states(refusal(velocity=velocity), "velocity", "hold")


def test_another_sensor_or_any_stamps_can_be_the_clock() -> None:
    recording = Recording.from_streams(**streams(clock="velocity"))
    assert recording.samples == 200
    np.testing.assert_array_equal(
        recording.measurements.angular_velocity, motion()["angular_velocity"][::2]
    )
    stamps = FIRST / 1e9 + np.array([1.0, 1.02, 1.04])
    assert Recording.from_streams(**streams(clock=stamps)).samples == 3


def test_of_several_samples_at_one_stamp_the_nearest_is_used() -> None:
    time = np.array([TIME[5] - 4_000_000, TIME[5] + 1_000_000, TIME[5] + 4_000_000])
    one = (time, np.array([[1.0, 0, 0], [2, 0, 0], [3, 0, 0]]))
    recording = Recording.from_streams(
        **streams(landmarks=[one], landmark_references=LANDMARKS[:1])
    )
    assert recording.measurements.landmarks[5, 0, 0] == 2
    assert_states(recording.describe(), "2", "another is nearer")


def test_samples_outside_the_clock_are_left_out_and_counted() -> None:
    time, values = streams()["landmarks"][0]
    early = np.concatenate([time[:2] - 10_000_000_000, time])
    one = (early, np.concatenate([values[:2], values]))
    recording = Recording.from_streams(
        **streams(landmarks=[one], landmark_references=LANDMARKS[:1])
    )
    assert np.sum(np.asarray(recording.measurements.landmark_weights) > 0) == 40
    assert_states(recording.describe(), "2 outside it left out")


def test_seconds_and_nanoseconds_can_be_mixed() -> None:
    time, values = streams()["truth_position"]
    recording = Recording.from_streams(**streams(truth_position=(time / 1e9, values)))
    assert recording.truth is not None
    np.testing.assert_array_equal(recording.truth.position, motion()["truth_position"])


def test_mistakes_are_named() -> None:
    time, values = streams()["velocity"]
    assert_states(refusal(velocity=(time / 1e9 - 1e9, values)), "velocity", "clock")
    assert_states(refusal(velocity=(time[::-1], values)), "velocity", "sample 1", "bridge")
    assert_states(refusal(velocity=(time, values[:, :2])), "velocity", "(200, 3)", "(200, 2)")
    assert_states(refusal(velocity=(time[:9], values)), "velocity", "(9, 3)", "(200, 3)")
    assert_states(refusal(velocity=(time, np.full((200, 3), np.nan))), "velocity", "finite")
    assert_states(refusal(landmarks=[values]), "landmarks[0]", "pair")
    assert_states(refusal(velocity=values), "velocity", "pair")
    assert_states(refusal(between={"wheel": "hold"}), "wheel", "velocity")
    assert_states(refusal(between={"velocity": "spline"}), "spline", "interpolate")
    assert_states(refusal(between={"velocity": "missing"}), "velocity", "hold")
    assert_states(refusal(clock="gps"), "gps", "angular_velocity")
    assert_states(refusal(clock=[1.7e9]), "clock", "1 sample", "2")


def test_samples_whose_stamps_go_back_are_dropped_with_a_bridge() -> None:
    time, values = streams()["velocity"]
    swapped = time.copy()
    swapped[10] = time[8]
    recording = Recording.from_streams(**streams(velocity=(swapped, values), bridge="hold"))
    assert recording.samples == 400
    assert_states(recording.describe(), "velocity", "1 stamp", "dropped")


def test_an_error_is_of_recordings() -> None:
    with pytest.raises(RecordingError):
        Recording.from_streams(**streams(clock="gps"))
