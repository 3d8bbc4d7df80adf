"""A filter run over recordings in parts, and in one piece, from the recording's start."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.own_filter import Complementary
from helpers.recordings import motion
from helpers.schedules import K, tuned

import posegsa
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.filters.observer import Observer
from posegsa.model.measurements import Measurements
from posegsa.model.schedules import ConstantGain
from posegsa.model.signal import SignalSettings
from posegsa.recordings import running
from posegsa.recordings.recording import Recording

OBSERVER = Observer(ConstantGain(jnp.float32(8.0)))


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A recording with three full parts and one padded part."""
    return Recording.from_arrays(**motion(350, start="rest"), landmark_weights=0.1)


def test_it_follows_the_truth_and_learns_the_bias(recording: Recording) -> None:
    estimates = posegsa.run_filter(OBSERVER, recording.off(degrees=60, metres=1))
    errors = posegsa.recording_errors(estimates, recording)
    assert errors.attitude.total[0] == pytest.approx(60, abs=1e-3)
    assert errors.attitude.total[-1] < 1
    assert errors.position is not None
    assert errors.position[-1] < 0.1
    assert isinstance(estimates.rotation, np.ndarray)
    from_its_start = posegsa.run_filter(OBSERVER, recording)
    assert posegsa.recording_errors(from_its_start, recording).rmse()["judged"].total < 0.5


def test_parts_make_the_estimates_of_one_piece(recording: Recording) -> None:
    """They are compared with those of the model for all measurements at once."""
    parts = posegsa.run_filter(OBSERVER, recording)
    m = jax.tree.map(lambda a: jnp.asarray(np.asarray(a), jnp.float32), recording.measurements)
    initial = running.state_of(recording.initial())
    whole = posegsa.run_filter(OBSERVER, Measurements(*m), initial)
    for name, mine, theirs in zip(whole._fields, parts, whole, strict=True):
        if theirs is None:
            assert mine is None, name
        else:
            np.testing.assert_allclose(mine, theirs, rtol=1e-5, atol=1e-5, err_msg=name)


def test_a_filter_of_the_users_own_sees_a_slow_sensor_as_its_stream_does() -> None:
    """Weights by the sensors' rates are for the observer alone."""
    given = motion(120)
    given["landmarks"][np.arange(120) % 10 != 0] = np.nan
    recording, own = Recording.from_arrays(**given), Complementary(jnp.float32(1), jnp.float32(2))
    start, m = recording.initial(), recording.measurements
    assert recording.measurements.landmark_weights.max() == 10
    replayed = posegsa.run_filter(own, recording)
    live = posegsa.PoseFilter(
        own,
        rotation=start.rotation,
        position=start.position,
        vector_references=given["vector_references"],
        landmark_references=given["landmark_references"],
    )
    for k in range(119):
        pose = live.update(
            time_step=m.time_step[k],
            angular_velocity=given["angular_velocity"][k],
            velocity=given["velocity"][k],
            vectors=given["vectors"][k],
            landmarks=given["landmarks"][k],
        )
        np.testing.assert_allclose(pose.position, replayed.position[k + 1], atol=1e-5)
        np.testing.assert_allclose(pose.rotation, replayed.rotation[k + 1], atol=1e-5)


def test_attitude_only_has_no_position() -> None:
    given = motion(velocity=None, landmarks=None, landmark_references=None)
    recording = Recording.from_arrays(**given)
    estimates = posegsa.run_filter(OBSERVER, recording)
    assert np.isnan(estimates.position).all()
    assert posegsa.recording_errors(estimates, recording).rmse()["judged"].total < 2


@pytest.mark.usefixtures("x64")
def test_float32_measurements_for_a_float64_filter_are_warned_of(recording: Recording) -> None:
    fields = recording.measurements._asdict()
    rounded = Measurements.from_arrays(**fields, dtype=np.float32)
    exact = Measurements.from_arrays(**fields, dtype=np.float64)
    observer = Observer(ConstantGain(jnp.float64(8.0)))
    initial = running.state_of(recording.initial())
    with pytest.warns(PosegsaWarning, match="float32.* float64") as warned:
        estimates = posegsa.run_filter(observer, rounded, initial)
    assert warned[0].filename == __file__
    assert estimates.position.dtype == np.float64
    error = np.abs(estimates.position - posegsa.run_filter(observer, exact, initial).position).max()
    assert 0 < error < 1e-4


def test_float32_measurements_for_a_float64_result_are_warned_of(recording: Recording) -> None:
    result = tuned(K, dtype="float64")
    with jax.enable_x64(True):
        measurements = Measurements.from_arrays(**recording.measurements._asdict())
    with pytest.warns(PosegsaWarning, match="float32.* float64") as warned:
        result.estimate(measurements, rotation=np.eye(3), position=np.zeros(3))
    assert warned[0].filename == __file__


def test_what_does_not_fit_is_refused(recording: Recording) -> None:
    with pytest.raises(ArgumentError, match="initial: None"):
        posegsa.run_filter(OBSERVER, Measurements(*recording.measurements))  # type: ignore[call-overload]  # wrong on purpose
    with pytest.raises(ArgumentError, match='signal "pose"'):
        posegsa.run_filter(replace(OBSERVER, signal=SignalSettings(signal="pose")), recording)
    with pytest.raises(ArgumentError, match="noise: a float; allowed: a KalmanNoise"):
        posegsa.run_filter(posegsa.KalmanFilter(0.1), recording)  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(ArgumentError, match="filter: a str"):
        posegsa.run_filter("fast", recording)  # type: ignore[arg-type]  # wrong on purpose


def test_measurements_in_double_precision_run_in_that_of_jax(
    recording: Recording, recwarn: pytest.WarningsRecorder
) -> None:
    assert np.asarray(recording.measurements.velocity).dtype == np.float64
    start = running.state_of(recording.initial())
    found = posegsa.run_filter(OBSERVER, recording.measurements, start)
    assert found.position.dtype == np.float32
    assert not [one for one in recwarn if "dtype" in str(one.message)]
