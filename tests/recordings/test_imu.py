"""Recordings of an inertial sensor, as the attitude filter reads them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import ENU_TO, RATE, inertial_motion

import posegsa
from posegsa.errors import MeasurementError, RecordingError
from posegsa.recordings.bridging import gaps_in
from posegsa.recordings.imu import ImuRecording, as_read_by
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("frame", ["ENU", "NED", "NWU"])
def test_frames_are_those_of_their_names(frame: Any) -> None:
    given = inertial_motion(frame=frame)
    recording = posegsa.imu(**given, frame=frame)
    measured, truth = recording.measurements, given["truth_rotation"]
    np.testing.assert_allclose(recording.initial().rotation, truth[0], atol=1e-9)
    assert np.linalg.det(recording.initial().rotation) == pytest.approx(1)
    north, up = ENU_TO[frame] @ [0, 1, 0], ENU_TO[frame] @ [0, 0, 1]
    np.testing.assert_array_equal(measured.vector_references[0], [9.81 * up, north])
    found = posegsa.replay("imu", recording)[0].errors
    assert found is not None
    assert found.rmse()["judged"].total < 1.0


def test_the_vectors_are_what_is_measured() -> None:
    given = inertial_motion(noise=1.0)
    given["acc"][500:503] = np.nan
    given["mag"][650:652] = np.nan
    recording = posegsa.imu(**given)
    m = recording.measurements
    np.testing.assert_array_equal(m.angular_velocity, given["gyr"])
    np.testing.assert_array_equal(m.vectors[:500, 0], given["acc"][:500])
    np.testing.assert_array_equal(m.vectors[:650, 1], given["mag"][:650])
    missing = [np.flatnonzero(weights == 0).tolist() for weights in m.vector_weights.T]
    assert missing == [[500, 501, 502], [650, 651]]
    described = recording.describe()
    assert_states(
        described, "accelerometer", "3 of 900 samples missing", "2 of 900 samples missing"
    )


def test_without_a_magnetometer_the_heading_is_free_and_that_is_said() -> None:
    given = inertial_motion()
    del given["mag"]
    for frame in ("ENU", "NED", "NWU"):
        recording = posegsa.imu(**given, frame=frame)
        assert not recording.measurements.vector_weights[:, 1].any()
        R = recording.initial().rotation
        up = ENU_TO[frame] @ [0, 0, 1]
        np.testing.assert_allclose(R.T @ up, given["truth_rotation"][0].T @ [0, 0, 1], atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1)
        assert "free" in recording.sources["heading"]


def test_a_recording_is_made_again_from_its_sensors() -> None:
    given = inertial_motion(noise=1.0)
    first = posegsa.imu(**given, name="bench", phases={"late": np.arange(900) > 700})
    again = posegsa.as_imu(posegsa.as_imu(first, frame="NED"), frame="ENU")
    for found, expected in zip(again.measurements, first.measurements, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert (again.name, again.attitude_only) == ("bench", True)
    assert again.describe() == first.describe()
    np.testing.assert_array_equal(again.judged, first.judged)
    np.testing.assert_array_equal(again.phases["late"], first.phases["late"])
    assert again.truth is not None
    np.testing.assert_array_equal(again.truth.rotation, given["truth_rotation"])


def test_other_filters_read_a_recording_as_it_is() -> None:
    recording = Recording.from_arrays(
        time_step=0.01,
        angular_velocity=np.zeros((50, 3)),
        sensors={"accelerometer": np.tile([0.0, 0.0, 9.81], (50, 1))},
    )
    assert as_read_by("observer", recording) is recording
    read = as_read_by("imu", recording)
    assert isinstance(read, ImuRecording)
    assert as_read_by("imu", read) is read


def test_a_gap_stays_a_pause_unless_it_is_filled() -> None:
    given = inertial_motion()
    del given["rate"]
    time = np.arange(900) / RATE
    time[400:] += 0.2
    given["gyr"][700:702] = np.nan
    given["gyr"][0] = np.nan
    words = r"3 samples.*\(NaN\), the first at 0: dropped"
    with pytest.warns(posegsa.PosegsaWarning, match=words):
        kept = posegsa.imu(**given, time=time)
    seen = np.delete(np.arange(900), [0, 700, 701])
    np.testing.assert_allclose(kept.stamps, time[seen])
    assert kept.time[0] == 0
    np.testing.assert_array_equal(kept.sensors["accelerometer"], given["acc"][seen])
    assert_states(kept.describe(), "1 gap", "0.21 s", "3.98 s")
    with pytest.raises(MeasurementError, match=r"gap.*longest_gap = 0\.1 s"):
        posegsa.imu(**given, time=time, bridge="keep", longest_gap=0.1)
    with pytest.raises(MeasurementError, match=r"NaN.*bridge"):
        posegsa.imu(**given, time=time, bridge="refuse")
    # Stamps that go back need a policy.
    back = time.copy()
    back[10] = back[8]
    with pytest.raises(MeasurementError, match=r"1 stamp.*keep"):
        posegsa.imu(**given, time=back)
    with pytest.warns(posegsa.PosegsaWarning, match="1 sample dropped"):
        assert posegsa.imu(**given, time=back, bridge="keep").samples == 896
    # Filters that would turn on with the last velocity refuse it.
    for kind in ("observer", "kalman"):
        with pytest.raises(MeasurementError, match=r"1 gap.*hold"):
            as_read_by(kind, kept)
    given["gyr"][0] = 0.0
    with pytest.warns(posegsa.PosegsaWarning, match="gap"):
        recording = posegsa.imu(**given, time=time, bridge="interpolate")
    assert recording.samples == 920
    assert not gaps_in(recording.time)[0].size
    assert (recording.measurements.vector_weights[401:419, 0] == 0).all()


def test_the_heading_is_right_after_a_gap(tmp_path: Path) -> None:
    """The body has turned by 2 rad in it, which no sensor has seen."""
    given = inertial_motion(2.0, 20.0)
    seen = (np.arange(2200) < 1000) | (np.arange(2200) >= 1400)
    rows = np.column_stack([np.arange(2200) / RATE, given["gyr"], given["acc"], given["mag"]])
    path = tmp_path / "log.csv"
    head = "time,wx,wy,wz,ax,ay,az,mx,my,mz"
    np.savetxt(path, rows[seen], delimiter=",", header=head, comments="")
    (replay,) = posegsa.replay("imu", Recording.read(path))
    off = posegsa.attitude_errors(replay.estimates.rotation, given["truth_rotation"][seen])
    assert posegsa.rmse(off.heading[1100:]) < 1.0
    with pytest.warns(posegsa.PosegsaWarning, match="bridged by 400 samples"):
        filled = Recording.read(path, bridge="hold", longest_gap=10.0)
    (replay,) = posegsa.replay("imu", filled)
    off = posegsa.attitude_errors(replay.estimates.rotation, given["truth_rotation"])
    assert posegsa.rmse(off.heading[1500:]) > 3.0


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"frame": "END"}, r"frame = 'END'.*ENU, NED, NWU"),
        ({"rate": 0.0}, r"rate = 0.0.*allowed"),
        ({"time": np.arange(900)}, r"rate, time:.*one of the two"),
        ({"rate": None}, r"rate, time:.*one of the two"),
        ({"acc": np.zeros((5, 3))}, "acc: must have"),
        ({"gyr": np.full((900, 3), np.nan)}, "gyr: all 900 samples are NaN"),
        ({"mag": np.zeros((900, 3))}, "mag: all 900 samples are missing"),
        ({"mag": np.full((900, 3), np.nan)}, "mag: all 900 samples are missing"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(posegsa.PosegsaError, match=message):
        posegsa.imu(**(inertial_motion() | changed))


@pytest.mark.parametrize("frame", ["ENU", "NED"])
def test_a_saved_recording_keeps_its_frame(tmp_path: Path, frame: Any) -> None:
    given = inertial_motion(frame=frame)
    given["mag"][::2] = np.nan
    made = posegsa.imu(**given, frame=frame)
    made.save(tmp_path / "saved.npz")
    read = posegsa.as_imu(Recording.read(tmp_path / "saved.npz"))
    assert read.frame == frame
    for name, values in made.measurements._asdict().items():
        np.testing.assert_array_equal(getattr(read.measurements, name), values, err_msg=name)


def test_a_field_without_heading_is_refused() -> None:
    given = inertial_motion()
    with pytest.raises(RecordingError, match="mag: is parallel to acc"):
        posegsa.imu(**(given | {"mag": 4 * given["acc"]}))


def test_a_first_acceleration_along_the_field_is_passed_over() -> None:
    given = inertial_motion()
    expected = posegsa.imu(**given).initial().rotation
    given["acc"][0] = 0.1 * given["mag"][0]
    np.testing.assert_allclose(posegsa.imu(**given).initial().rotation, expected, atol=0.01)


def test_a_sample_beyond_all_sensors_is_left_out_and_said() -> None:
    given = inertial_motion()
    given["acc"][5, 0], given["acc"][7, 1], given["mag"][9, 2] = np.inf, 3e7, -np.inf
    with pytest.warns(posegsa.PosegsaWarning, match="accelerometer: 2 of 900 samples left out"):
        recording = posegsa.imu(**given)
    missing = [np.flatnonzero(w == 0).tolist() for w in recording.measurements.vector_weights.T]
    assert missing == [[5, 7], [9]]
    assert any("magnetometer: 1 of 900 samples left out" in note for note in recording.notes)


def test_a_recording_without_an_accelerometer_is_refused() -> None:
    recording = Recording.from_arrays(time_step=0.01, angular_velocity=np.zeros((10, 3)))
    with pytest.raises(RecordingError, match="has no accelerometer"):
        posegsa.as_imu(recording)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gyr": np.zeros((50, 2))}, r"^gyr:.* \(N, 3\)"),
        ({"gyr": "fast"}, r"^gyr:.*array of numbers"),
        ({"gyr": np.full((50, 3), np.inf)}, r"^gyr:.*infinite"),
        ({"gyr": np.full((50, 3), np.nan)}, "^gyr: all 50 samples are NaN"),
        ({"acc": np.zeros((40, 3))}, r"^acc:.* \(50, 3\).* \(40, 3\)"),
        ({"acc": None}, r"^acc:.* \(50, 3\)"),
        ({"mag": np.zeros((50, 1))}, r"^mag:.* \(50, 3\).* \(50, 1\)"),
    ],
)
def test_errors_name_the_arguments(changes: dict[str, Any], words: str) -> None:
    given = {"gyr": np.zeros((50, 3)), "acc": np.tile([0.0, 0, 9.81], (50, 1))}
    with pytest.raises(MeasurementError, match=words):
        posegsa.imu(**given | changes, rate=100.0)


def test_it_is_shown_in_a_line() -> None:
    recording = posegsa.imu(np.zeros((50, 3)), np.tile([0.0, 0, 9.81], (50, 1)), rate=100.0)
    assert_states(repr(recording), "ImuRecording", "50 samples", "0.5 s", "100 Hz", "2 vectors")
    assert len(repr(recording)) < 200
