"""Errors of estimates against a reference, compared with their definitions and with SciPy."""

import numpy as np
import pytest
from helpers.recordings import motion
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.errors import MeasurementError, RecordingError
from posegsa.filters.rollout import Estimates
from posegsa.recordings.accuracy import BLOCKS_IN_FIGURE, pose_nees
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick


def test_errors_of_attitude_are_those_of_the_error_quaternion() -> None:
    true, error = Rotation.random(200, rng=0), Rotation.random(200, rng=1)
    found = posegsa.attitude_errors((error * true).as_matrix(), true.as_matrix())
    w, _, _, z = error.as_quat(scalar_first=True).T
    np.testing.assert_allclose(found.total, np.degrees(error.magnitude()), atol=1e-9)
    np.testing.assert_allclose(found.heading, np.degrees(2 * np.arctan(np.abs(z / w))), atol=1e-9)
    inclined = 2 * np.arccos(np.minimum(np.sqrt(w * w + z * z), 1))
    np.testing.assert_allclose(found.inclination, np.degrees(inclined), atol=1e-6)


def test_a_turn_about_the_vertical_is_heading_and_any_other_axis_inclination() -> None:
    true = Rotation.random(1, rng=3)
    for axis, expected in (((0, 0, 1), (2, 2, 0)), ((0.6, 0.8, 0), (2, 0, 2))):
        error = Rotation.from_rotvec(np.radians(2) * np.array(axis))
        found = posegsa.attitude_errors((error * true).as_matrix(), true.as_matrix())
        np.testing.assert_allclose(np.ravel(found), expected, atol=1e-9)
    small = Rotation.from_rotvec([1e-9, 0, 0])  # too small for an arc cosine
    found = posegsa.attitude_errors((small * true).as_matrix(), true.as_matrix())
    np.testing.assert_allclose(found.inclination, np.degrees(1e-9), rtol=1e-4)


def estimates_of(recording: Recording, turned: Rotation, moved: list[float]) -> Estimates:
    """The truth, turned in the inertial frame and moved."""
    assert recording.truth is not None
    count = recording.samples
    nothing = np.zeros(count)
    position = recording.truth.position
    return Estimates(
        time=recording.time,
        rotation=turned.as_matrix() @ recording.truth.rotation,
        position=np.zeros((count, 3)) if position is None else position + moved,
        bias=np.zeros((count, 6)),
        vector_bias=np.zeros((count, 0, 3)),
        gain=nothing,
        gain_used=nothing,
        error=nothing,
        rate=nothing,
    )  # type: ignore[arg-type]  # NumPy arrays will do


@pytest.mark.parametrize(
    ("seconds", "blocks"), [(4, BLOCKS_IN_FIGURE), (10, BLOCKS_IN_FIGURE), (20, 4), (60, 12)]
)
def test_a_short_recording_has_blocks_for_a_figure(seconds: float, blocks: int) -> None:
    recording = Recording.from_arrays(**motion(100 * seconds))
    turned = Rotation.from_rotvec([0, 0, 0.1])
    errors = posegsa.recording_errors(estimates_of(recording, turned, [0.0, 0.0, 0.3]), recording)
    found = errors.blocks()
    np.testing.assert_allclose(found.attitude, [np.degrees(0.1) ** 2] * blocks)
    np.testing.assert_allclose(found.position or [], [0.3**2] * blocks)


def test_errors_are_judged_by_phase_where_the_truth_is_known() -> None:
    given = motion()
    given["truth_rotation"][5] = np.nan
    recording = Recording.from_arrays(**given, judged=np.arange(400) < 300)
    turned = Rotation.from_rotvec([0, 0, 0.1])
    errors = posegsa.recording_errors(estimates_of(recording, turned, [0.3, 0, 0.4]), recording)
    found = errors.rmse()
    assert list(found) == ["judged", "rest", "motion"]
    assert [one.samples for one in found.values()] == [299, 99, 300]
    for one in found.values():
        assert one.total == pytest.approx(np.degrees(0.1))
        assert one.heading == pytest.approx(np.degrees(0.1))
        assert one.inclination == pytest.approx(0, abs=1e-6)
        assert one.position == pytest.approx(0.5)
    attitude = Recording.from_arrays(
        **motion(velocity=None, landmarks=None, landmark_references=None)
    )
    errors = posegsa.recording_errors(estimates_of(attitude, turned, []), attitude)
    assert errors.position is None
    assert errors.rmse()["judged"].position is None


def test_root_mean_squares() -> None:
    assert posegsa.rmse([3.0, 4.0, 100.0], np.array([True, True, False])) == pytest.approx(
        np.sqrt(12.5)
    )
    assert np.isnan(posegsa.rmse([1.0], np.array([False])))
    assert posegsa.rmse([1.0, np.nan]) == np.inf  # diverged: no small error
    with pytest.raises(RecordingError, match=r"mask:.* bool"):
        posegsa.rmse([1.0], np.array([1]))
    np.testing.assert_allclose(posegsa.position_errors([[1, 2, 2]], [[0, 0, 0]]), [3])
    with pytest.raises(MeasurementError, match=r"true:.* \(1, 3, 3\)"):
        posegsa.attitude_errors(np.eye(3)[None], np.eye(3))
    blind = Recording.from_arrays(**motion(truth_rotation=None, truth_position=None))
    with pytest.raises(RecordingError, match="has no truth"):
        blind.masks()


def uncertain(count: int = 50) -> tuple[Estimates, np.ndarray, np.ndarray, np.ndarray]:
    """Estimates with a covariance, true rotations and positions, and the NEES."""
    rng = np.random.default_rng(0)
    xi = rng.normal(0, 0.8, (count, 6))
    xi[0, :3], xi[1, :3] = 0, 1e-6
    twist = np.zeros((count, 4, 4))
    twist[:, [2, 0, 1], [1, 2, 0]] = xi[:, :3]
    twist[:, [1, 2, 0], [2, 0, 1]] = -xi[:, :3]
    twist[:, :3, 3] = xi[:, 3:]
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, :3] = Rotation.random(count, rng=1).as_matrix()
    pose[:, :3, 3] = rng.normal(0, 5.0, (count, 3))
    true = pose @ expm(twist)
    root = rng.normal(size=(count, 6, 6))
    sigma = root @ root.swapaxes(1, 2) + 0.1 * np.eye(6)
    recording = Recording.from_arrays(**motion(count))
    plain = estimates_of(recording, Rotation.identity(), [0.0, 0.0, 0.0])
    found = plain._replace(rotation=pose[:, :3, :3], position=pose[:, :3, 3], covariance=sigma)
    nees = [x @ np.linalg.inv(s) @ x for x, s in zip(xi, sigma, strict=True)]
    return found, true[:, :3, :3], true[:, :3, 3], np.array(nees)


def test_the_nees_is_of_the_logarithm_of_the_pose_error() -> None:
    estimates, rotation, position, expected = uncertain()
    found = pose_nees(estimates, rotation, position)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_nees_is_unknown_where_the_truth_is_and_infinite_where_the_estimate_fails() -> None:
    estimates, rotation, position, expected = uncertain()
    position[3], rotation[4] = np.nan, np.nan
    sigma, place = np.array(estimates.covariance), np.array(estimates.position)
    sigma[5], sigma[6], sigma[7] = 0, np.inf, np.diag([-1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    place[8] = np.nan
    found = pose_nees(estimates._replace(covariance=sigma, position=place), rotation, position)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found)), [3, 4])
    np.testing.assert_array_equal(np.flatnonzero(np.isinf(found)), [5, 6, 7, 8])
    np.testing.assert_allclose(found[9:], expected[9:], rtol=1e-9)


def test_the_nis_of_a_filter_that_is_lost_is_infinite() -> None:
    recording = Recording.from_arrays(**motion())
    estimates = estimates_of(recording, Rotation.identity(), [0.0, 0.0, 0.0])
    rotation, nis = np.array(estimates.rotation), np.ones(400)
    rotation[200:], nis[200:] = np.nan, np.nan
    lost = estimates._replace(rotation=rotation, nis=nis)
    assert posegsa.recording_errors(lost, recording).rmse()["judged"].nis == np.inf


def test_nees_and_nis_are_means_over_a_phase() -> None:
    recording = Recording.from_arrays(**motion(), judged=np.arange(400) < 300)
    estimates = estimates_of(recording, Rotation.identity(), [0.3, 0.0, 0.0])
    nis = np.where(np.arange(400) % 2, np.nan, np.arange(400))
    sure = np.tile(0.1**2 * np.eye(6), (400, 1, 1))
    found = posegsa.recording_errors(estimates._replace(nis=nis, covariance=sure), recording)
    judged = found.rmse()["judged"]
    assert judged.nees == pytest.approx(9.0)
    assert judged.nis == pytest.approx(np.mean(np.arange(0, 300, 2)))
    without = posegsa.recording_errors(estimates, recording).rmse()["judged"]
    assert (without.nees, without.nis) == (None, None)
