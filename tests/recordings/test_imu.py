"""Vectors, references and start from an inertial sensor's signals."""

import math
from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_told
from helpers.recordings import BIAS, ENU_TO, FIELD, RATE, inertial_motion
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.errors import MeasurementError, RecordingError
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick

VECTORS = config.ImuVectorsConfig()
HORIZONTAL = float(np.hypot(*FIELD[:2]))


def looped(given: dict[str, Any], rest: int, low_pass: float, tolerance: float) -> np.ndarray:
    """Up, east and the weight of east (K, 7), sample by sample, in plain NumPy."""
    gyr, acc, mag = given["gyr"], given["acc"], given["mag"]
    step = 1 / given["rate"]
    bias = gyr[:rest].mean(axis=0)
    S = Rotation.identity()
    turned = []
    for k in range(len(gyr)):
        if k:
            S = S * Rotation.from_rotvec((gyr[k] - bias) * step)
        turned.append(S)
    inertial = np.stack([R.apply(a) for R, a in zip(turned, acc, strict=True)])
    field = np.stack([R.apply(m) for R, m in zip(turned, mag, strict=True)])
    gravity, usual = (np.median(a[:rest], axis=0) for a in (inertial, field))
    g = np.linalg.norm(gravity)
    b, a = butter(2, math.sqrt(2) / (2 * math.pi * low_pass), fs=1 / step)
    steady, _ = lfilter(b, a, inertial, axis=0, zi=lfilter_zi(b, a)[:, None] * gravity)
    up = np.stack([R.inv().apply(v) / g for R, v in zip(turned, steady, strict=True)])
    vertical = usual @ gravity / g
    reference = np.array([math.sqrt(usual @ usual - vertical**2), vertical])
    smooth, rows = np.zeros(2), []
    for k in range(len(gyr)):
        u = up[k] / np.linalg.norm(up[k])
        v = mag[k] @ u
        parts = np.array([np.linalg.norm(mag[k] - v * u), v])
        off = (parts - reference) / np.linalg.norm(reference)
        smooth = smooth + step / (0.1 + step) * (off - smooth)
        weight = 1 / (1 + (np.linalg.norm(smooth) / tolerance) ** 2)
        rows.append([*up[k], *np.cross(mag[k], up[k]) / reference[0], weight])
    return np.array(rows)


def test_vectors_and_weights_are_those_of_a_loop() -> None:
    given = inertial_motion(noise=1.0, shaking=3.0)
    settings = config.ImuVectorsConfig(low_pass=0.8, field_tolerance=0.03)
    recording = posegsa.imu(**given, rest=2.0, settings=settings)
    expected = looped(given, 200, 0.8, 0.03)
    measured = recording.measurements
    np.testing.assert_allclose(measured.vectors[:, 0], expected[:, :3], atol=1e-9)
    np.testing.assert_allclose(measured.vectors[:, 1], expected[:, 3:6], atol=1e-9)
    np.testing.assert_allclose(measured.vector_weights[:, 1], expected[:, 6], rtol=1e-6)
    np.testing.assert_array_equal(measured.vector_weights[:, 0], 1.0)


def test_an_angular_velocity_is_about_the_time_before_its_stamp_or_after_it() -> None:
    given = inertial_motion()
    before = posegsa.imu(**given).measurements.angular_velocity
    np.testing.assert_array_equal(before, [*given["gyr"][1:], given["gyr"][-1]])
    after = config.ImuVectorsConfig(gyroscope_interval="after")
    recording = posegsa.imu(**given, settings=after)
    np.testing.assert_array_equal(recording.measurements.angular_velocity, given["gyr"])


@pytest.mark.parametrize("frame", ["ENU", "NED", "NWU"])
def test_frames_are_those_of_their_names(frame: Any) -> None:
    given = inertial_motion(frame=frame)
    recording = posegsa.imu(**given, frame=frame, settings=config.ImuVectorsConfig(low_pass=0.0))
    measured, truth = recording.measurements, given["truth_rotation"]
    np.testing.assert_allclose(recording.initial().rotation, truth[0], atol=1e-9)
    assert np.linalg.det(recording.initial().rotation) == pytest.approx(1)
    # Without noise or acceleration, the true rotation maps the measurements to the references.
    np.testing.assert_allclose(
        np.einsum("kij,knj->kni", truth, measured.vectors), measured.vector_references, atol=1e-6
    )
    east, up = ENU_TO[frame] @ [1, 0, 0], ENU_TO[frame] @ [0, 0, 1]
    np.testing.assert_array_equal(measured.vector_references[0], [up, east])


def test_a_rest_gives_the_bias_and_the_lengths_of_the_references() -> None:
    given = inertial_motion()
    given["acc"] *= 9.70 / 9.81
    recording = posegsa.imu(**given)
    np.testing.assert_allclose(recording.initial().bias[:3], BIAS, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(recording.measurements.vectors[0], axis=1), 1)
    assert "at rest for the first 2." in recording.sources["start"]
    again = posegsa.imu(**given, rest=1.0)
    np.testing.assert_allclose(again.initial().bias[:3], BIAS, atol=1e-12)
    assert "at rest for the first 1.0 s" in again.sources["start"]


def test_without_a_rest_bias_and_references_are_those_of_motion() -> None:
    given = inertial_motion(0.0, 6.0)
    recording = posegsa.imu(**given)
    np.testing.assert_array_equal(recording.initial().bias, 0.0)
    assert "begins in motion" in recording.sources["start"]
    error = Rotation.from_matrix(recording.initial().rotation @ given["truth_rotation"][0].T)
    assert np.degrees(error.magnitude()) < 2
    # At first the field has full weight even if it is disturbed.
    given["mag"][50:] += [30.0, 0.0, 0.0]
    disturbed = posegsa.imu(**given).measurements.vector_weights[:, 1]
    assert (disturbed >= np.exp(-np.arange(600) / RATE / 10) - 1e-9).all()


def test_without_a_magnetometer_the_heading_is_free_and_that_is_said() -> None:
    given = inertial_motion()
    del given["mag"]
    for frame in ("ENU", "NED", "NWU"):
        recording = posegsa.imu(**given, frame=frame)
        assert recording.measurements.vectors.shape == (900, 1, 3)
        R = recording.initial().rotation
        up = ENU_TO[frame] @ [0, 0, 1]
        np.testing.assert_allclose(R.T @ up, given["truth_rotation"][0].T @ [0, 0, 1], atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1)
        assert "free" in recording.sources["heading"]


def test_what_is_missing_or_out_of_all_proportion_has_no_weight_and_is_told() -> None:
    given = inertial_motion()
    clean = posegsa.imu(**given)
    given["acc"][500:503] = np.nan
    given["acc"][600] = [500.0, 0.0, 0.0]
    given["mag"][650:652] = np.nan
    given["mag"][700] = [0.0, 0.0, 5e4]
    recording = posegsa.imu(**given)
    weights = recording.measurements.vector_weights
    assert np.flatnonzero(weights[:, 0] == 0).tolist() == [500, 501, 502, 600]
    assert np.flatnonzero(weights[:, 1] == 0).tolist() == [500, 501, 502, 600, 650, 651, 700]
    told = recording.describe()
    assert_told(told, "accelerometer", "3 samples missing", "1 sample ignored", "10 times")
    assert_told(told, "magnetometer", "2 samples missing")
    # They affect neither the low-pass filter nor the weights of later samples.
    np.testing.assert_allclose(
        recording.measurements.vectors[701:, 0], clean.measurements.vectors[701:, 0], atol=2e-3
    )
    assert weights[701:, 1].min() > 0.9


def test_a_recording_is_made_anew_from_its_sensors() -> None:
    given = inertial_motion(noise=1.0)
    first = posegsa.imu(**given, name="bench", phases={"late": np.arange(900) > 700})
    other = config.ImuVectorsConfig(low_pass=0.5)
    again = posegsa.as_imu(posegsa.as_imu(first, settings=other))
    for found, expected in zip(again.measurements, first.measurements, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
    assert (again.name, again.attitude_only) == ("bench", True)
    assert again.describe() == first.describe()
    np.testing.assert_array_equal(again.judged, first.judged)
    np.testing.assert_array_equal(again.phases["late"], first.phases["late"])
    assert again.truth is not None
    np.testing.assert_array_equal(again.truth.rotation, given["truth_rotation"])


def test_a_gap_is_bridged_before_anything_is_made() -> None:
    given = inertial_motion()
    time = np.arange(900) / RATE
    time[400:] += 0.2
    del given["rate"]
    with pytest.raises(MeasurementError, match="bridge"):
        posegsa.imu(**given, time=time)
    with pytest.warns(posegsa.PosegsaWarning, match="gap"):
        recording = posegsa.imu(**given, time=time, bridge="interpolate")
    assert recording.samples == 920
    assert (recording.measurements.vector_weights[401:419, 0] == 0).all()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"frame": "END"}, r"frame = 'END'.*ENU, NED, NWU"),
        ({"rest": "long"}, r"rest = 'long'.*allowed"),
        ({"rest": 100.0}, r"rest = 100 s.*up to 9 s"),
        ({"rest": -1.0}, r"rest = -1.0.*allowed"),
        ({"rest": 2.0, "gyr": np.full((900, 3), 0.1)}, r"rest = 2 s.* 9.92"),
        ({"rate": 0.0}, r"rate = 0.0.*allowed"),
        ({"time": np.arange(900)}, r"rate, time:.*one of both"),
        ({"rate": None}, r"rate, time:.*one of both"),
        ({"acc": np.zeros((5, 3))}, "acc: must have"),
        ({"gyr": np.full((900, 3), np.nan)}, "gyr: 900 samples"),
        ({"mag": np.zeros((900, 3))}, "mag: the first .* samples are all missing"),
        ({"mag": np.full((900, 3), np.nan)}, "mag: the first .* samples are all missing"),
        ({"settings": 3}, "settings: a int"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(posegsa.PosegsaError, match=message):
        posegsa.imu(**(inertial_motion() | changed))


def test_a_field_without_heading_is_refused() -> None:
    given = inertial_motion()
    with pytest.raises(RecordingError, match="mag: is parallel to acc"):
        posegsa.imu(**(given | {"mag": 4 * given["acc"]}))


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
        ({"gyr": np.full((50, 3), np.nan)}, "^gyr: 50 samples without velocities"),
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
    assert_told(repr(recording), "ImuRecording", "50 samples", "0.5 s", "100 Hz", "1 vector")
    assert len(repr(recording)) < 200
