"""Bags of ROS 1 and ROS 2, written by these tests."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import FIRST, KINDS, Messages, flight, write_bag
from helpers.messages import assert_told
from helpers.recordings import LANDMARKS, motion

import posegsa
from posegsa.cli import main
from posegsa.errors import MeasurementError, RecordingError
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick

TOPICS: dict[str, Any] = {
    "angular_velocity": "/imu",
    "velocity": "/odom",
    "vectors": ["/imu", "/mag"],
    "landmarks": ["/tag_0", "/tag_1"],
    "truth": "/mocap",
}
KNOWN: dict[str, Any] = {
    "vector_references": [[0, 0, 9.81], [5e-5, 0, 0]],
    "landmark_references": LANDMARKS[:2],
}
BESIDE = """
vector_references = [[0, 0, 9.81], [5e-5, 0, 0]]
landmark_references = [[3.0, 1.0, 2.0], [-2.0, 4.0, 1.0]]
[topics]
angular_velocity = "/imu"
velocity = "/odom"
vectors = ["/imu", "/mag"]
landmarks = ["/tag_0", "/tag_1"]
truth = "/mocap"
"""


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    return {kind: write_bag(folder, kind, flight(kind)) for kind in KINDS}


def refusal(path: Path, topics: Any, **more: Any) -> str:
    with pytest.raises(RecordingError) as caught:
        Recording.from_rosbag(path, topics, **KNOWN | more)
    return str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_bag_has_the_motion_that_was_written(kind: str, bags: dict[str, Path]) -> None:
    given = motion()
    recording = Recording.from_rosbag(bags[kind], TOPICS, **KNOWN)
    m = recording.measurements
    assert recording.samples == 400
    np.testing.assert_allclose(m.angular_velocity, given["angular_velocity"], atol=1e-12)
    np.testing.assert_allclose(m.velocity[::2], given["velocity"][::2], atol=1e-12)
    np.testing.assert_array_equal(m.velocity[1::2], m.velocity[::2])  # held
    np.testing.assert_allclose(m.vectors[::5], given["vectors"][::5], atol=1e-12)
    seen = np.asarray(m.landmark_weights) > 0
    assert np.flatnonzero(seen[:, 0]).tolist() == list(range(0, 400, 10))
    np.testing.assert_allclose(m.landmarks[::10], given["landmarks"][::10, :2], atol=1e-12)
    assert recording.truth is not None
    np.testing.assert_allclose(
        recording.truth.rotation[::2], given["truth_rotation"][::2], atol=1e-9
    )
    np.testing.assert_allclose(recording.truth.position[::2], given["truth_position"][::2])
    assert np.isnan(recording.truth.rotation[1]).all()
    assert_told(recording.describe(), "/odom", "nav_msgs/Odometry", "landmarks[1]", "2")


@pytest.mark.parametrize("quantity", ["twist", "mocap_pose", "odom"])
def test_other_types_have_the_same(quantity: str, bags: dict[str, Path]) -> None:
    topics = (
        TOPICS
        | {
            "twist": {"velocity": "/twist"},
            "mocap_pose": {"truth": "/mocap_pose"},
            "odom": {"truth": "/odom", "angular_velocity": "/odom"},
        }[quantity]
    )
    expected = Recording.from_rosbag(bags["ros1"], TOPICS, **KNOWN)
    found = Recording.from_rosbag(bags["ros1"], topics, **KNOWN)
    every = 1 if quantity != "odom" else 2
    np.testing.assert_array_equal(
        found.measurements.velocity, expected.measurements.velocity[::every]
    )
    assert found.truth is not None
    assert expected.truth is not None
    np.testing.assert_array_equal(found.truth.position, expected.truth.position[::every])


def test_a_lone_imu_needs_no_topics(tmp_path: Path) -> None:
    held = flight("mcap")
    path = write_bag(tmp_path, "mcap", {name: held[name] for name in ("/imu", "/mag", "/tag_0")})
    recording = Recording.read(path)
    assert recording.attitude_only
    (note,) = (one for one in recording.notes if "topics" in one)
    assert_told(note, "/imu, /mag", "not /tag_0", f"{path.name}.toml", 'velocity = "')
    given = motion()["vectors"]
    np.testing.assert_allclose(recording.sensors["accelerometer"], 9.81 * given[:, 0], atol=1e-12)
    assert np.isfinite(recording.sensors["magnetometer"]).all(axis=1).sum() == 80


def test_stamps_are_those_of_the_headers_or_of_the_bag(tmp_path: Path) -> None:
    make = Messages("ros1")
    zero = [make.imu(0, np.ones(3), np.ones(3)) for _ in range(3)]
    path = write_bag(tmp_path, "ros1", {"/imu": zero}, [FIRST + k * 10_000_000 for k in range(3)])
    topics = {"angular_velocity": "/imu"}
    assert_told(refusal(path, topics), "/imu", "0", "bag")
    recording = Recording.from_rosbag(path, topics, stamps="bag")
    np.testing.assert_array_equal(recording.time, [0, 0.01, 0.02])


def test_a_toml_file_beside_the_bag_names_its_topics(
    bags: dict[str, Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = bags["sqlite3"]
    path.with_name(f"{path.name}.toml").write_text(BESIDE)
    found = Recording.read(path)
    expected = Recording.from_rosbag(path, TOPICS, **KNOWN)
    np.testing.assert_array_equal(found.measurements.landmarks, expected.measurements.landmarks)
    assert not any("topics" in note for note in found.notes)
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: None)  # JAX has started
    assert main(["replay", "kalman", str(path), "--window", ":1"]) == 0
    assert_told(capsys.readouterr().out, "flight_sqlite3[0:1]", "judged")


def test_the_truth_can_be_a_tum_file(bags: dict[str, Path], tmp_path: Path) -> None:
    given = motion()
    time = FIRST / 1e9 + np.arange(400) / 100
    file = tmp_path / "mocap.tum"
    file.write_text(posegsa.tum_text(time, given["truth_rotation"], given["truth_position"]))
    topics = {name: topic for name, topic in TOPICS.items() if name != "truth"}
    recording = Recording.from_rosbag(bags["mcap"], topics, truth=file, **KNOWN)
    assert recording.truth is not None
    np.testing.assert_allclose(recording.truth.rotation, given["truth_rotation"], atol=1e-6)
    assert_told(refusal(bags["mcap"], TOPICS, truth=file), "truth", "mocap.tum")


def test_an_error_names_what_the_bag_has(bags: dict[str, Path], tmp_path: Path) -> None:
    path = bags["ros1"]
    said = refusal(path, TOPICS | {"velocity": "/wheel"})
    assert_told(said, "/wheel", "velocity", "/odom", "nav_msgs/Odometry", "sensor_msgs/Imu")
    said = refusal(path, TOPICS | {"velocity": "/imu"})
    assert_told(said, "/imu", "sensor_msgs/Imu", "velocity", "geometry_msgs/TwistStamped")
    assert_told(refusal(path, TOPICS | {"wheel": "/odom"}), "wheel", "velocity")
    assert_told(refusal(path, TOPICS | {"vectors": "/imu"}), "vectors", "a list of topics")
    assert_told(refusal(path, TOPICS | {"velocity": ["/odom"]}), "velocity", "a topic")
    assert_told(refusal(path, {"velocity": "/odom"}), "angular_velocity", "/imu")
    assert_told(refusal(path, TOPICS, landmark_references=None), "landmark_references", "2")
    without = {name: topic for name, topic in TOPICS.items() if name != "landmarks"}
    said = refusal(path, without)
    assert_told(said, "landmark_references", "no topic for landmarks", f"{path.name}.toml")
    with pytest.raises(MeasurementError) as told:
        Recording.from_rosbag(path, TOPICS, **KNOWN | {"vector_references": [[0, 0, 1]]})
    assert_told(str(told.value), "vector_references", "(2, 3)")
    assert_told(refusal(path, TOPICS, stamps="bagged"), "stamps", "bagged", "header")
    assert_told(refusal(tmp_path / "no.bag", TOPICS), "no.bag")
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(40))
    assert_told(refusal(tmp_path / "broken.bag", TOPICS), "broken.bag", "cannot be read")
    several = {"/a": [Messages("ros1").imu(FIRST, np.ones(3), np.ones(3))]}
    two = write_bag(tmp_path, "ros1", several | {"/b": several["/a"]})
    with pytest.raises(RecordingError) as caught:
        Recording.read(two)
    assert_told(str(caught.value), "topics", "/a", "/b", f"{two.name}.toml")


def test_messages_that_say_they_are_another_thing_are_refused(
    bags: dict[str, Path], tmp_path: Path
) -> None:
    said = refusal(bags["ros1"], TOPICS | {"velocity": "/world_twist"})
    assert_told(said, "/world_twist", "map", "base_link")
    make = Messages("ros1")
    none = [make.imu(FIRST + k, np.zeros(3), np.ones(3), covariance=-1.0) for k in range(3)]
    tags = [make.stamped(FIRST + k, np.ones(3), np.eye(3), f"camera_{k}") for k in range(3)]
    path = write_bag(tmp_path, "ros1", {"/imu": none, "/tag": tags})
    assert_told(refusal(path, {"angular_velocity": "/imu"}), "angular_velocity_covariance", "-1")
    topics = {"angular_velocity": "/imu", "landmarks": ["/tag"]}
    path.unlink()
    good = [make.imu(FIRST + k, np.zeros(3), np.ones(3)) for k in range(3)]
    path = write_bag(tmp_path, "ros1", {"/imu": good, "/tag": tags})
    assert_told(refusal(path, topics), "/tag", "camera_0", "camera_1")


def test_without_the_library_the_error_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch, bags: dict[str, Path]
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert_told(refusal(bags["ros1"], TOPICS), "rosbags", "pip install '.[ros]'")
