"""Attitude filters of other libraries on an IMU recording: frames, starts and required signals."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.recordings import ENU_TO
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.errors import ArgumentError, RecordingError
from posegsa.judging.other_filters import OTHER_FILTERS, installed, other_filter
from posegsa.recordings.frames import UP
from posegsa.recordings.recording import Recording


def imu(samples: int = 2000, rate: float = 100.0) -> Recording:
    """A body that turns slowly and never accelerates, x east, y north, z up."""
    time = np.arange(samples) / rate
    R = Rotation.from_euler("zx", np.stack([1 + 0.3 * np.sin(time), 0.2 * np.cos(time)], axis=1))
    omega = np.zeros((samples, 3))
    omega[1:] = (R[:-1].inv() * R[1:]).as_rotvec() * rate
    mag = R.inv().apply([0, 15.0, -41.0])
    mag[10] = np.nan
    return Recording.from_arrays(
        time_step=1 / rate,
        angular_velocity=omega,
        truth_rotation=R.as_matrix(),
        judged=time > 5,
        sensors={"accelerometer": R.inv().apply([0, 0, 9.81]), "magnetometer": mag},
    )


@pytest.mark.parametrize("name", list(OTHER_FILTERS))
def test_each_filter_is_in_the_frame_of_the_recording(name: str) -> None:
    if not installed(name):
        pytest.skip(f'{name} is not installed (pip install ".[compare]")')
    recording, found = imu(), {}
    assert recording.truth is not None
    for frame in UP:
        truth = recording.truth._replace(rotation=ENU_TO[frame] @ recording.truth.rotation)
        one = replace(recording, frame=frame, truth=truth)
        estimates = other_filter(name, one)
        found[frame] = posegsa.recording_errors(estimates, one).rmse()["judged"]
        assert np.isnan(estimates.position).all()
    assert found["ENU"].total < 2
    for frame in UP:
        np.testing.assert_allclose(found[frame][:3], found["ENU"][:3], atol=1e-5)


@pytest.mark.quick
def test_what_they_need_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    blind = Recording.from_arrays(time_step=0.01, angular_velocity=np.zeros((9, 3)))
    with pytest.raises(RecordingError, match=r"accelerometer.*magnetometer.*none"):
        other_filter("VQF", blind)
    monkeypatch.setitem(__import__("sys").modules, "vqf", None)
    with pytest.raises(ArgumentError, match=r"vqf.*\[compare\]"):
        other_filter("VQF", imu(20))


@pytest.mark.quick
def test_a_missing_sample_has_the_last_value() -> None:
    if not installed("VQF"):
        pytest.skip('VQF is not installed (pip install ".[compare]")')

    def estimated(missing: slice, held: int) -> list[np.ndarray]:
        gaps, filled = (imu(200) for _ in range(2))
        gaps.sensors["magnetometer"][missing] = np.nan
        filled.sensors["magnetometer"][missing] = filled.sensors["magnetometer"][held]
        return [other_filter("VQF", one).rotation for one in (gaps, filled)]

    np.testing.assert_array_equal(*estimated(slice(50, 60), 49))
    np.testing.assert_array_equal(*estimated(slice(0, 5), 5))
    with pytest.raises(RecordingError, match="missing at all samples"):
        estimated(slice(None), 0)
