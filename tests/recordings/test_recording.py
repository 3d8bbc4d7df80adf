"""Recordings from a user's arrays: what is refused, what is bridged, and the initial estimate."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import GRAVITY, motion
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.errors import MeasurementError, PosegsaWarning, RecordingError
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import about, matrices, product, quaternions

pytestmark = pytest.mark.quick


def test_stamps_of_nanoseconds_keep_their_nanoseconds() -> None:
    first = 1_403_715_523_912_143_104
    stamps = first + np.array([0, 5_000_001, 10_000_003], np.int64)
    recording = Recording.from_arrays(
        time=stamps, angular_velocity=np.zeros((3, 3)), velocity=np.zeros((3, 3))
    )
    np.testing.assert_array_equal(recording.time, [0.0, 0.005000001, 0.010000003])
    np.testing.assert_allclose(recording.measurements.time_step[:2], [0.005000001, 0.005000002])
    assert recording.measurements.time_step.dtype == np.float64


def test_a_recording_holds_what_it_was_given() -> None:
    given = motion()
    recording = posegsa.Recording.from_arrays(name="bench", **given)
    assert (recording.samples, recording.name) == (400, "bench")
    assert recording.duration == pytest.approx(4.0)
    assert recording.truth is not None
    np.testing.assert_array_equal(recording.truth.rotation, given["truth_rotation"])
    np.testing.assert_array_equal(recording.measurements.landmarks, given["landmarks"])
    assert recording.judged.all()
    assert {name: int(mask.sum()) for name, mask in recording.masks().items()} == {
        "judged": 400,
        "rest": 100,
        "motion": 300,
    }
    facts = ("400 samples", "4 s", "100 Hz", "2 vectors", "3 landmarks", "pose")
    assert_states(recording.describe(), *facts)


def test_what_is_masked_is_missing() -> None:
    given = motion()
    masked = np.ma.masked_array(given["vectors"], mask=np.zeros(given["vectors"].shape))
    masked[7, 1] = np.ma.masked
    masked.data[7, 1] = 999.0
    weights = Recording.from_arrays(**given | {"vectors": masked}).measurements.vector_weights
    assert np.argwhere(np.asarray(weights) == 0).tolist() == [[7, 1]]


def test_the_truth_may_be_quaternions_and_unknown_parts_are_not_judged() -> None:
    given = motion()
    q = Rotation.from_matrix(given.pop("truth_rotation")).as_quat(scalar_first=True)
    q[7] = np.nan
    given["truth_position"][9, 1] = np.nan
    recording = Recording.from_arrays(**given, truth_quaternion=q)
    assert recording.truth is not None
    np.testing.assert_allclose(recording.truth.rotation[8], motion()["truth_rotation"][8])
    assert set(np.flatnonzero(~recording.judged)) == {7, 9}
    assert recording.masks()["rest"].sum() == 98


def test_attitude_only_has_no_position() -> None:
    given = motion(velocity=None, landmarks=None, landmark_references=None)
    recording = Recording.from_arrays(**given)
    assert recording.attitude_only
    assert recording.truth is not None
    assert recording.truth.position is None
    np.testing.assert_array_equal(recording.initial().position, 0)
    with pytest.raises(RecordingError, match=r"velocity.*landmarks"):
        Recording.from_arrays(**motion(velocity=None))


def test_weights_go_with_the_rate_of_their_sensor() -> None:
    given = motion()
    given["landmarks"][np.arange(400) % 10 != 0] = np.nan
    given["landmarks"][100:200] = np.nan  # an outage does not change the rate
    recording = Recording.from_arrays(**given, landmark_weights=0.5)
    weights = recording.measurements.landmark_weights
    assert set(np.unique(weights)) == {0.0, 5.0}
    np.testing.assert_array_equal(recording.landmark_interval, 10.0)
    np.testing.assert_array_equal(recording.vector_interval, 1.0)
    as_given = Recording.from_arrays(**given, landmark_weights=0.5, weights_by_rate=False)
    assert set(np.unique(as_given.measurements.landmark_weights)) == {0.0, 0.5}


@pytest.mark.parametrize("by_rate", [True, False])
def test_weights_are_the_same_once_saved_and_read(tmp_path: Path, by_rate: bool) -> None:
    given = motion()
    given["landmarks"][np.arange(400) % 10 != 0] = np.nan
    saved = Recording.from_arrays(**given, weights_by_rate=by_rate)
    saved.save(tmp_path / "saved.npz")
    read = Recording.read(tmp_path / "saved.npz")
    for name in ("landmark_weights", "vector_weights"):
        np.testing.assert_array_equal(
            getattr(read.measurements, name), getattr(saved.measurements, name)
        )
    np.testing.assert_array_equal(read.landmark_interval, saved.landmark_interval)


# Missing samples -----------------------------------------------------------------------------


def broken(**changes: Any) -> dict[str, Any]:
    """The motion with a time stamp that decreases, a gap of 0.2 s and velocities that are NaN."""
    given = motion()
    given["time"][200:] += 190_000_000
    given["time"][50] = given["time"][48]
    given["angular_velocity"][300:303] = np.nan
    return given | changes


@pytest.mark.parametrize("policy", ["hold", "interpolate"])
def test_what_is_bridged_is_counted_and_reported(policy: Any) -> None:
    with pytest.warns(PosegsaWarning, match=r"1 sample.*dropped") as warned:
        recording = Recording.from_arrays(**broken(), bridge=policy)
    assert len(recording.notes) == 3
    assert all(note in str(warned[0].message) for note in recording.notes)
    assert_states(recording.notes[1], "1 gap", "5 median steps", "0.2 s", "1.99 s")
    assert_states(recording.notes[1], "19 samples", policy)
    assert_states(recording.notes[2], "3 samples", "velocities", "300")
    assert recording.samples == 400 - 1 + 19
    np.testing.assert_allclose(np.diff(recording.time)[49], 0.02)  # where one sample was dropped
    np.testing.assert_allclose(np.delete(np.diff(recording.time), 49), 0.01, atol=1e-9)
    gap = slice(199, 218)
    m = recording.measurements
    assert not m.vector_weights[gap].any()
    assert not m.landmark_weights[gap].any()
    assert not recording.judged[gap].any()
    assert recording.judged.sum() == 399
    # "hold" gives the measurement before the gap, "interpolate" one between before and after.
    before, after = m.angular_velocity[198], m.angular_velocity[218]
    share = 0.0 if policy == "hold" else 0.5
    np.testing.assert_allclose(m.angular_velocity[208], (1 - share) * before + share * after)
    assert np.isfinite(m.angular_velocity).all()


def test_nothing_is_bridged_unless_it_is_asked_for() -> None:
    for name, spoil, words in (
        ("stamps", lambda g: g["time"].__setitem__(50, 0), "1 stamp"),
        (
            "gap",
            lambda g: g["time"].__setitem__(slice(200, None), g["time"][200:] + 10**9),
            "1 gap",
        ),
        ("NaN", lambda g: g["angular_velocity"].__setitem__(3, np.nan), "1 sample.*velocities"),
    ):
        given = motion()
        spoil(given)
        with pytest.raises(RecordingError, match=words):
            Recording.from_arrays(**given)
        assert name


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda g: g["time"].__setitem__(-1, g["time"][-1] + 10**18), "the longest 1e.09 s"),
        (lambda g: g.update(time=4 * g["time"]), "no time stamp"),
        (lambda g: g["angular_velocity"].__setitem__(slice(100, 250), np.nan), "missing for 1.51"),
        (lambda g: g["angular_velocity"].__setitem__(slice(0, 150), np.nan), "missing for 1.5 s"),
        (lambda g: g["angular_velocity"].fill(np.nan), "all 400 samples are NaN"),
    ],
)
def test_what_is_too_long_to_bridge_is_refused(spoil: Any, words: str) -> None:
    given = motion()
    spoil(given)
    with pytest.raises(RecordingError, match=words):
        Recording.from_arrays(**given, bridge="hold")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time": None}, "give one of the two"),
        ({"time_step": 0.01}, "give one of the two"),
        ({"time": np.zeros(3, int)}, r"must have the shape \(400,\)"),
        ({"time": None, "time_step": -0.01}, r"time_step:.*positive"),
        ({"velocity": np.zeros((4, 3))}, r"velocity: must have the shape"),
        ({"velocity": np.full((400, 3), -np.inf)}, r"^velocity: .* infinite, got -inf at \(0, 0\)"),
        ({"vectors": np.zeros((4, 2, 3))}, r"vectors: must have 400 rows.* 4"),
        ({"vector_weights": -1.0}, r"vector_weights:.*not neg"),
        ({"truth_rotation": np.tile(2 * np.eye(3), (400, 1, 1))}, "must be rotations"),
        ({"truth_rotation": None}, "without a truth_rotation"),
        ({"truth_quaternion": np.ones((400, 4))}, "give one of the two"),
        ({"truth_rotation": None, "truth_quaternion": np.ones((400, 4))}, r"the length 1.* 2"),
        ({"judged": np.full(400, 0.5)}, r"judged:.*mask"),
        ({"phases": {"rest": np.ones(3, bool)}}, r"phases\['rest'\]:.*mask"),
        ({"start": "north"}, "start = 'north'"),
        ({"start": (2 * np.eye(3), np.zeros(3))}, r"start rotation:.* rotations"),
        ({"bridge": "guess"}, "bridge = 'guess'"),
        ({"longest_gap": np.inf, "bridge": "hold"}, "longest_gap = inf"),
    ],
)
def test_refusals_name_the_argument(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(MeasurementError, match=words):
        Recording.from_arrays(**motion(**changes))


# Initial estimates ---------------------------------------------------------------------------


@pytest.mark.parametrize("kept", ["both", "vectors", "landmarks"])
def test_a_start_at_rest_has_pose_and_bias(kept: str) -> None:
    given = motion(start="rest")
    if kept != "both":
        for name in {"vectors": ("landmarks", "landmark_references")}.get(
            kept, ("vectors", "vector_references")
        ):
            del given[name]
    recording = Recording.from_arrays(**given)
    start = recording.initial()
    np.testing.assert_allclose(start.rotation, given["truth_rotation"][0], atol=1e-6)
    expected = [0, 0, 0] if kept == "vectors" else given["truth_position"][0]
    np.testing.assert_allclose(start.position, expected, atol=1e-6)
    # The velocity of the last sample at rest is not 0: it leads to the first sample in motion.
    np.testing.assert_allclose(start.bias, [0.02, 0, 0, 0, 0, 0], atol=2e-2)
    np.testing.assert_allclose(start.bias[:3], [0.02, 0, 0], atol=1e-2)


def test_one_vector_alone_turns_the_start_as_little_as_possible() -> None:
    given = motion(velocity=None, landmarks=None, landmark_references=None)
    given |= {"vectors": given["vectors"][:, :1], "vector_references": GRAVITY[None]}
    given["angular_velocity"][:, 0] -= 0.02  # its bias, which would turn what is averaged
    R = Recording.from_arrays(**given).initial().rotation
    np.testing.assert_allclose(R @ given["vectors"][0, 0], GRAVITY, atol=1e-9)
    expected = Rotation.align_vectors(GRAVITY, given["vectors"][0, 0])[0]
    np.testing.assert_allclose(Rotation.from_matrix(R).magnitude(), expected.magnitude())
    given["vectors"] = np.tile([[[0, 0, -1.0]]], (400, 1, 1))  # upside down: half a turn
    R = Recording.from_arrays(**given).initial().rotation
    np.testing.assert_allclose(R @ [0, 0, -1], GRAVITY, atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1)


def test_a_start_in_motion_is_where_the_body_was_at_the_first_sample() -> None:
    given = motion()
    given["angular_velocity"][:, 0] -= 0.02
    moving = Recording.from_arrays(**given).window(2.0)
    assert moving.truth is not None
    start = moving.initial()
    np.testing.assert_allclose(start.rotation, moving.truth.rotation[0], atol=1e-6)
    np.testing.assert_allclose(start.position, moving.truth.position[0], atol=1e-3)


def test_landmarks_far_apart_turn_the_start_more_than_vectors() -> None:
    given = motion(velocity=None, landmarks=None, landmark_references=None)
    wrong = Rotation.from_rotvec([0.05, -0.05, 0.05]).as_matrix()
    far = np.array([[60.0, 0, 0], [0, 60, 0], [0, 0, 60], [-50, -50, 0]])
    R, P = given["truth_rotation"], given["truth_position"]
    given |= {
        "velocity": motion()["velocity"],
        "vectors": given["vectors"] @ wrong,
        "landmarks": np.einsum("kji,knj->kni", R, far - P[:, None]),
        "landmark_references": far,
    }
    start = Recording.from_arrays(**given).initial()
    off = Rotation.from_matrix(start.rotation @ R[0].T).magnitude()
    assert off < 0.003 < Rotation.from_matrix(wrong).magnitude()
    assert np.linalg.norm(start.position - P[0]) < 0.1


def test_a_start_needs_what_it_is_made_of() -> None:
    nothing = {name: None for name in motion() if "vector" in name or "landmark" in name}
    blind = Recording.from_arrays(**motion(**nothing))
    with pytest.raises(RecordingError, match="no vectors and no landmarks"):
        blind.initial()
    one = {"landmarks": np.ones((2, 1, 3)), "landmark_references": [[1, 1, 1]]}
    still = {"time_step": 0.1, "angular_velocity": np.zeros((2, 3)), "velocity": np.zeros((2, 3))}
    with pytest.raises(RecordingError, match=r"no vector.*FILE.csv.toml"):
        Recording.from_arrays(**still, **one).initial()
    moving = motion(start="rest")
    moving["phases"]["rest"] = ~moving["phases"]["rest"]
    with pytest.raises(RecordingError, match="begins in motion"):
        Recording.from_arrays(**moving).initial()
    with pytest.raises(RecordingError, match="first sample"):
        blind.window(0, 1).off(10) if blind.truth is None else Recording.from_arrays(
            **motion(truth_rotation=None, truth_position=None)
        ).off(10)


def test_off_the_truth_by_the_given_amounts() -> None:
    recording = Recording.from_arrays(**motion()).off(45.0, 2.0, seed=3)
    start, truth = recording.initial(), motion()
    angle = Rotation.from_matrix(start.rotation @ truth["truth_rotation"][0].T).magnitude()
    assert np.degrees(angle) == pytest.approx(45)
    assert np.linalg.norm(start.position - truth["truth_position"][0]) == pytest.approx(2)


def test_a_window_is_its_samples_and_starts_from_its_own() -> None:
    recording = Recording.from_arrays(
        **motion(start="rest"), sensors={"magnetometer": np.ones((400, 3))}
    )
    part = recording.window(1.5, 2.0)
    assert part.name == "recording[1.5:2]"
    assert part.samples == 50
    assert part.time[0] == 0
    assert part.sensors["magnetometer"].shape == (50, 3)
    for mine, whole in zip(part.measurements, recording.measurements, strict=True):
        np.testing.assert_array_equal(mine, whole[150:200])
    start = part.initial()
    np.testing.assert_array_equal(start.bias, recording.initial().bias)
    early = recording.window(0, 0.5)
    assert early.start == "rest"
    # The start uses the first 0.1 s of the window, in which the body turns by less than 0.1 rad.
    np.testing.assert_allclose(start.rotation, motion()["truth_rotation"][150], atol=0.1)
    for window in ((3, 3), (100, 200), (0, 0.005)):
        with pytest.raises(RecordingError, match="window"):
            recording.window(*window)


# Rotations -----------------------------------------------------------------------------------


def test_rotations_are_scipys() -> None:
    R = Rotation.random(50, rng=0)
    special = Rotation.from_rotvec(np.pi * np.eye(3))
    for some in (R, special, Rotation.identity(2)):
        q = quaternions(some.as_matrix())
        expected = some.as_quat(scalar_first=True, canonical=True)
        np.testing.assert_allclose(np.abs(np.sum(q * expected, axis=1)), 1, atol=1e-12)
        np.testing.assert_allclose(matrices(q), some.as_matrix(), atol=1e-12)
    p, q = R[:25].as_quat(scalar_first=True), R[25:].as_quat(scalar_first=True)
    together = (R[:25] * R[25:]).as_matrix()
    np.testing.assert_allclose(matrices(product(p, q)), together, atol=1e-12)
    axis = np.array([0.6, 0, 0.8])
    turned = Rotation.from_rotvec(0.7 * axis).as_matrix()
    np.testing.assert_allclose(about(axis, 0.7), turned, atol=1e-12)
