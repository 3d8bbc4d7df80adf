"""Recordings from files: small files in the published formats, written by these tests."""

import csv
import inspect
import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.messages import assert_states
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from posegsa.errors import MeasurementError, RecordingError
from posegsa.recordings.readers import READERS
from posegsa.recordings.recording import Recording
from posegsa.recordings.start import Start

pytestmark = pytest.mark.quick


def write_csv(path: Path, head: list[str], rows: object) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows)  # type: ignore[arg-type]  # csv writes any objects
    return path


@pytest.mark.parametrize("method", sorted(set(READERS.values())))
def test_each_reader_takes_arguments_that_replace_what_a_file_says(method: str) -> None:
    path, *_, more = inspect.signature(getattr(Recording, method)).parameters.values()
    assert path.name == "path"
    assert more.kind == inspect.Parameter.VAR_KEYWORD


# CSV -----------------------------------------------------------------------------------------


def test_columns_of_the_usual_names_need_no_mapping(tmp_path: Path) -> None:
    head = ["time_ns", "wx", "wy", "wz", "ax", "ay", "az", "qw", "qx", "qy", "qz", "judged"]
    first = 1_403_715_523_912_143_104
    rows = [
        [first + 1, 0.1, 0.2, 0.3, 0, 0, 9.81, 1, 0, 0, 0, 1],
        [first + 10_000_002, 0.1, 0.2, 0.3, 0, 0, 9.81, 1, 0, 0, 0, 0],
        [first + 20_000_005, 0.1, 0.2, 0.3, "", "", "", "", "", "", "", 1],
    ]
    recording = Recording.from_csv(write_csv(tmp_path / "flight.csv", head, rows))
    assert recording.name == "flight"
    np.testing.assert_array_equal(recording.time, [0, 0.010000001, 0.020000004])
    np.testing.assert_array_equal(recording.measurements.angular_velocity[1], [0.1, 0.2, 0.3])
    assert recording.attitude_only
    assert recording.judged.tolist() == [True, False, False]
    assert np.isnan(recording.sensors["accelerometer"][2]).all()


def test_a_mapping_names_the_columns(tmp_path: Path) -> None:
    head = ["t", "gx", "gy", "gz", "u", "v", "w", "mx", "my", "mz"]
    rows = [[1000 * k, 1, 2, 3, 4, 5, 6, 0, 1, k] for k in range(3)]
    path = write_csv(tmp_path / "a.csv", head, rows)
    columns = {
        "time": "t",
        "angular_velocity": ["gx", "gy", "gz"],
        "velocity": ["u", "v", "w"],
        "vectors": [["mx", "my", "mz"]],
    }
    recording = Recording.from_csv(
        path, columns, time_unit="us", vector_references=[[0, 1, 0]], name="b", vector_weights=0.5
    )
    np.testing.assert_array_equal(recording.time, [0, 0.001, 0.002])
    np.testing.assert_array_equal(recording.measurements.vectors[2], [[0, 1, 2]])
    np.testing.assert_array_equal(recording.measurements.vector_weights, 0.5)
    assert recording.name == "b"
    with pytest.raises(RecordingError, match=r"no column 'gyro', for angular_velocity.*t"):
        Recording.from_csv(path, columns | {"angular_velocity": ["gyro", "gy", "gz"]})
    with pytest.raises(RecordingError, match=r"time_unit = 'h'.*s, ms, us, ns"):
        Recording.from_csv(path, columns, time_unit="h")


def test_columns_may_have_the_names_of_the_arrays_and_what_is_left_out_is_noted(
    tmp_path: Path,
) -> None:
    head = ["t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "qw", "qx", "qy", "qz"]
    rows = [[0.01 * k, 1, 2, 3, 0, 0, 9.81, 0, 1, k, 1, 0, 0, 0] for k in range(3)]
    path = write_csv(tmp_path / "a.csv", head, rows)
    columns = {"time": "t"}
    columns |= {name: [f"{name[0]}{axis}" for axis in "xyz"] for name in ("gyr", "acc", "mag")}
    text = "\n".join(f"{name} = {json.dumps(names)}" for name, names in columns.items())
    path.with_name("a.csv.toml").write_text(f"[columns]\n{text}\n")
    for recording in (Recording.read(path), Recording.from_csv(path, columns)):
        np.testing.assert_array_equal(recording.measurements.angular_velocity[1], [1, 2, 3])
        np.testing.assert_array_equal(recording.sensors["accelerometer"][1], [0, 0, 9.81])
        np.testing.assert_array_equal(recording.sensors["magnetometer"][1], [0, 1, 1])
        assert recording.truth is None
        assert "columns that are not used: qw, qx, qy, qz" in recording.describe()
    both = columns | {"accelerometer": columns["acc"]}
    with pytest.raises(RecordingError, match="columns: acc and accelerometer; allowed: one"):
        Recording.from_csv(path, both)


def sighted(folder: Path, *, more: str = "", head: str = "l3_x,l3_y,l3_z") -> Path:
    """A CSV file with a vector and a landmark under the usual names."""
    path = folder / "flight.csv"
    path.write_text(
        f"time,wx,wy,wz,vx,vy,vz,v0_x,v0_y,v0_z,{head},pressure\n"
        "0,0,0,0,1,0,0,0,0,1,2,3,4,9\n"
        "0.1,0,0,0,1,0,0,0,0,1,,,,9\n"
    )
    if more:
        path.with_name("flight.csv.toml").write_text(more)
    return path


REFERENCES = "vector_references = [[0, 0, 1]]\nlandmark_references = [[5, 6, 7]]\n"


def test_vectors_and_landmarks_have_usual_names_and_references_beside_the_file(
    tmp_path: Path,
) -> None:
    recording = Recording.read(sighted(tmp_path, more=REFERENCES))
    m = recording.measurements
    np.testing.assert_array_equal(m.vectors[:, 0], [[0, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal(m.vector_references[0], [[0, 0, 1]])
    np.testing.assert_array_equal(m.landmarks[0, 0], [2, 3, 4])
    np.testing.assert_array_equal(m.landmark_references[0], [[5, 6, 7]])
    assert m.landmark_weights[1, 0] == 0  # an empty cell is a missing measurement
    (note,) = recording.notes
    assert_states(note, "pressure")
    # Arguments in Python override the TOML file.
    other = Recording.from_csv(tmp_path / "flight.csv", landmark_references=[[1, 1, 1]])
    np.testing.assert_array_equal(other.measurements.landmark_references[0], [[1, 1, 1]])


def test_the_file_beside_it_may_name_the_columns_and_the_start(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t;gx;gy;gz;mx;my;mz\n0;1;2;3;0;1;0\n1000;1;2;3;0;1;0\n")
    path.with_name("a.csv.toml").write_text(
        'time_unit = "ms"\ndelimiter = ";"\nvector_references = [[0, 1, 0]]\n'
        "start = [[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0]]\n"
        '[columns]\ntime = "t"\nangular_velocity = ["gx", "gy", "gz"]\n'
        'vectors = [["mx", "my", "mz"]]\n'
    )
    recording = Recording.read(path)
    np.testing.assert_array_equal(recording.time, [0, 1])
    np.testing.assert_array_equal(recording.measurements.vectors[1], [[0, 1, 0]])
    assert isinstance(recording.start, Start)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            "",
            r"vector_references = \[\[x, y, z\]\]",
        ),
        ("vector_references = [[0, 0, 1]]", r"landmark_references"),
        ("references = 1", r"'references'.*columns, time_unit"),
        ("time_unit = 1", r"time_unit = 1.*text"),
        ("columns = 1", r"columns = 1.*table"),
        ("[columns]\nlandmark = 'a'", r"columns.landmark.*time, "),
        ("[columns]\ntime = [3]", r"columns.time = \[3\].*names of columns"),
        ("[columns]\ntime = 'time'", "columns: lacks angular_velocity"),
        ("columns = [", "not valid TOML"),
        (REFERENCES.replace("[[5, 6, 7]]", "[[5, 6]]"), "landmark_references"),
    ],
)
def test_missing_or_forbidden_settings_of_the_file_beside_it(
    tmp_path: Path, more: str, words: str
) -> None:
    with pytest.raises(MeasurementError, match=words):
        Recording.read(sighted(tmp_path, more=more))


def test_a_landmark_has_three_columns(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match="lacks l0_y, l0_z, l1_x; landmarks have three columns each"
    ):
        Recording.read(sighted(tmp_path, head="l0_x,l1_y,l1_z", more=REFERENCES))


def test_without_vectors_and_landmarks_it_says_how_to_name_them(tmp_path: Path) -> None:
    path = tmp_path / "drone.csv"
    path.write_text("time,wx,wy,wz,vx,vy,vz,beacon_x\n0,0,0,0,1,0,0,0\n0.1,0,0,0,1,0,0,0\n")
    recording = Recording.read(path)
    words = r"drone.*beacon_x.*v0_x.*drone.csv.toml"
    with pytest.raises(RecordingError, match=words):
        recording.initial()
    with pytest.raises(RecordingError, match=words):
        recording.check_seen()


def test_decimal_commas_are_read_where_commas_separate_no_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.with_suffix(".csv.toml").write_text('delimiter = ";"\n')
    path.write_text('time;wx;wy;wz\n0;1,5;2;-3,25\n0,5;1e-1;2,0;"3"\n')
    recording = Recording.read(path)
    np.testing.assert_array_equal(recording.time, [0, 0.5])
    expected = [[1.5, 2, -3.25], [0.1, 2, 3]]
    np.testing.assert_array_equal(recording.measurements.angular_velocity, expected)
    for cell in ("1.5", "1,5,0"):  # another mark than the column of the time has; two marks
        path.write_text(f"time;wx;wy;wz\n0,0;{cell};2;3\n0,5;1;2;3\n")
        with pytest.raises(RecordingError, match=rf"'{cell}' in column 'wx' of sample 0"):
            Recording.read(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("time,wx,wy,wz\n", "holds no sample"),
        ("time,wx,wy\n1,2,3\n", r"lacks wz \(angular_velocity\); it has: time, wx, wy"),
        ("time_ns,wx,wy,wz,vx,qw\n0,1,2,3,4,5\n", r"lacks vy vz \(velocity\), qx qy qz \(truth_q"),
        ("t;wx;wy;wz\n0;1,5;2;3\n", r"separated by semicolons.*delimiter = \";\" in bad.csv.toml"),
        ("# flight of Monday\ntime,wx,wy,wz\n", r"first line is a comment, 'flight of Monday'"),
        ("time\twx\twy\twz\n", r"separated by tabs.*delimiter = \"\\t\" in"),
        ("time,wx,wy,wz\n0,1,2,3\n1,2\n", "sample 1 .*2 .*4"),
        ("time,wx,wy,wz\n0,1,2,3\n1,2,x,3\n", "'x'.*'wy'.*sample 1"),
        ("time,wx,wy,wz\n0,1,2,3\n", "1 sample"),
        ("time,wx,wy,wz,judged\n0,1,2,3,1\n1,1,2,3,0.5\n", r"^\S*bad.csv: judged:.*mask"),
    ],
)
def test_an_impossible_csv_file_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=words):
        Recording.read(path)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    for name, words in (("no.csv", "no such file"), ("a.txt", "no such file or folder")):
        with pytest.raises(RecordingError, match=words):
            Recording.read(tmp_path / name)
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.read(tmp_path / "bytes.csv")


# npz -----------------------------------------------------------------------------------------


def recorded(samples: int = 30) -> Recording:
    rng = np.random.default_rng(1)
    landmarks = rng.normal(size=(samples, 2, 3))
    landmarks[np.arange(samples) % 5 != 0, 1] = np.nan
    R = Rotation.random(samples, rng=2).as_matrix()
    R[4] = np.nan
    return Recording.from_arrays(
        name="some",
        time=np.cumsum(rng.uniform(0.008, 0.012, samples)),
        angular_velocity=rng.normal(size=(samples, 3)),
        velocity=rng.normal(size=(samples, 3)),
        vectors=rng.normal(size=(samples, 1, 3)),
        vector_references=[[0, 0, 1.0]],
        landmarks=landmarks,
        landmark_references=[[1.0, 2, 3], [4, 5, 6]],
        landmark_weights=[0.3, 0.6],
        truth_rotation=R,
        truth_position=rng.normal(size=(samples, 3)),
        phases={"rest": np.arange(samples) < 5},
        start="rest",
        sources={"velocity": "synthetic"},
        sensors={"accelerometer": rng.normal(size=(samples, 3))},
        notes=["one note"],
    )


@pytest.mark.parametrize("start", ["rest", "pose"])
def test_a_saved_recording_is_read_back(tmp_path: Path, start: str) -> None:
    before = recorded() if start == "rest" else recorded().off(20, 1)
    before.save(tmp_path / "a.npz")
    after = Recording.read(tmp_path / "a.npz")
    for mine, theirs in zip(after.measurements, before.measurements, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(after.time, before.time, atol=1e-14)
    assert after.truth is not None
    assert before.truth is not None
    np.testing.assert_array_equal(after.truth.rotation, before.truth.rotation)
    np.testing.assert_array_equal(after.landmark_interval, [1, 5])
    for name in ("name", "sources", "notes", "attitude_only"):
        assert getattr(after, name) == getattr(before, name)
    for name in ("judged", "phases", "sensors"):
        np.testing.assert_equal(getattr(after, name), getattr(before, name))
    assert isinstance(after.start, Start) == (start == "pose")
    for mine, theirs in zip(after.initial(), before.initial(), strict=True):
        np.testing.assert_allclose(mine, theirs)


def test_an_npz_file_holds_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    for arrays, words in (
        ({"gyro": np.zeros((3, 3))}, r"holds 'gyro'.*time"),
        ({"time": np.zeros(3)}, "holds no angular_velocity"),
        ({"angular_velocity": np.zeros((3, 3)), "start_rotation": np.eye(3)}, "a start needs"),
        ({"angular_velocity": np.array([{}])}, "cannot be read"),
    ):
        np.savez(path, **arrays)
        with pytest.raises(RecordingError, match=words):
            Recording.from_npz(path)
    with pytest.raises(RecordingError, match="cannot be written"):
        recorded().save(tmp_path / "no" / "a.npz")


# EuRoC ---------------------------------------------------------------------------------------


def euroc(folder: Path, samples: int = 400) -> tuple[Rotation, np.ndarray]:
    """A sequence of 2 s at 200 Hz; the reference is 64 ns later and 10 samples shorter."""
    stamps = 1_403_715_523_912_143_104 + 5_000_000 * np.arange(samples)
    time = np.arange(samples) * 0.005
    R = Rotation.from_rotvec(np.stack([0.5 * time, 0 * time, 0.2 * time], axis=1))
    P = np.stack([np.sin(time), 0 * time, 1 + 0 * time], axis=1)
    v = np.stack([np.cos(time), 0 * time, 0 * time], axis=1)
    imu = folder / "mav0" / "imu0"
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    imu.mkdir(parents=True)
    truth.mkdir(parents=True)
    gyro = np.tile([0.5, 0.02, 0.2], (samples, 1))
    rows = [[t, *g, 0, 0, 9.81] for t, g in zip(stamps, gyro.tolist(), strict=True)]
    write_csv(imu / "data.csv", ["#timestamp [ns]", *"abcdef"], rows)
    q = R.as_quat(scalar_first=True)
    table = np.concatenate([P, q, v, np.zeros((samples, 6))], axis=1)[10:]
    rows = [[t + 64, *row] for t, row in zip(stamps[10:], table.tolist(), strict=True)]
    write_csv(truth / "data.csv", ["#timestamp", *map(str, range(16))], rows)
    return R[10:], P[10:]


def test_euroc_is_read_and_says_what_was_made_of_the_truth(tmp_path: Path) -> None:
    R, P = euroc(tmp_path)
    quiet = {"landmark_noise": 0.0, "velocity_noise": 0.0, "velocity_bias": (0, 0, 0)}
    recording = Recording.from_euroc(tmp_path, **quiet)
    assert recording.samples == 390
    (note,) = recording.notes
    assert_states(note, "10 IMU samples", "left out")
    m = recording.measurements
    assert recording.truth is not None
    np.testing.assert_allclose(recording.truth.rotation, R.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(recording.truth.position, P, atol=1e-9)
    seen = np.flatnonzero(np.asarray(m.landmark_weights)[:, 0])
    np.testing.assert_array_equal(seen, np.arange(0, 390, 10))
    np.testing.assert_array_equal(recording.landmark_interval, 10)
    known = np.asarray(m.landmark_references)[0, 2]
    np.testing.assert_allclose(m.landmarks[20, 2], R[20].inv().apply(known - P[20]), atol=1e-9)
    moved = R[50].apply(m.velocity[50])
    np.testing.assert_allclose(moved, [math.cos(0.3), 0, 0], atol=1e-9)
    start = recording.initial()
    np.testing.assert_allclose(start.rotation, R[0].as_matrix(), atol=0.05)
    noisy = Recording.from_euroc(tmp_path, seed=1, landmark_rate=200)
    assert noisy.sources["angular velocity"].startswith("measured")
    assert "synthetic" in noisy.sources["landmarks"]
    assert_states(noisy.sources["landmarks"], "0.05 m", "seed 1")
    assert "synthetic" in noisy.describe()
    errors = np.asarray(noisy.measurements.landmarks) - np.einsum(
        "kji,knj->kni",
        R.as_matrix(),
        np.asarray(noisy.measurements.landmark_references) - P[:, None],
    )
    assert errors.std() == pytest.approx(0.05, rel=0.1)
    again = Recording.from_euroc(tmp_path, seed=1, landmark_rate=200)
    np.testing.assert_array_equal(again.measurements.landmarks, noisy.measurements.landmarks)


def test_euroc_files_that_do_not_fit(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="mav0/imu0"):
        Recording.read(tmp_path)
    with pytest.raises(RecordingError, match="no such folder"):
        Recording.from_euroc(tmp_path / "no")
    euroc(tmp_path)
    path = tmp_path / "mav0" / "imu0" / "data.csv"
    with pytest.raises(MeasurementError, match="landmarks: must have the shape"):
        Recording.from_euroc(tmp_path, landmarks=np.zeros(3))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *reversed(lines[1:])]))
    with pytest.raises(RecordingError, match="stamps must ascend"):
        Recording.from_euroc(tmp_path)
    path.write_text("\n".join([lines[0], *("2" + line[1:] for line in lines[1:])]))
    with pytest.raises(RecordingError, match=r"no time stamps .* match"):
        Recording.from_euroc(tmp_path)


# BROAD ---------------------------------------------------------------------------------------


def test_broad_is_read(tmp_path: Path) -> None:
    rate, samples = 285.71, 600
    time = np.arange(samples) / rate
    moving = time > 1
    R = Rotation.from_rotvec([[0, 0, 0.3 + max(t - 1, 0)] for t in time])
    quaternion = R.as_quat(scalar_first=True)
    quaternion[-5:] = np.nan
    trial = {
        "imu_gyr": np.where(moving[:, None], [0.003, 0, 1], [0.003, 0, 0]),
        "imu_acc": np.tile([0, 0, 9.81], (samples, 1)),
        "imu_mag": R.inv().apply([0, 15.0, -41.0]),
        "opt_quat": quaternion,
        "opt_pos": np.zeros((samples, 3)),
        "movement": moving[:, None].astype(np.uint8),
        "sampling_rate": rate,
    }
    savemat(tmp_path / "trial.mat", trial)
    recording = Recording.read(tmp_path / "trial.mat")
    assert recording.attitude_only
    assert recording.name == "trial"
    np.testing.assert_array_equal(np.flatnonzero(recording.judged)[[0, -1]], [286, 594])
    assert {name: mask.sum() for name, mask in recording.masks().items()} == {
        "judged": 309,
        "rest": 286,
        "motion": 309,
    }
    start = recording.initial()
    np.testing.assert_allclose(start.rotation, R[0].as_matrix(), atol=1e-6)
    np.testing.assert_allclose(start.bias, [0.003, 0, 0, 0, 0, 0], atol=1e-9)
    # In the inertial frame, the vectors are east and up for every attitude.
    inertial = np.einsum("kij,knj->kni", R.as_matrix(), recording.measurements.vectors)
    np.testing.assert_allclose(inertial, recording.measurements.vector_references, atol=2e-2)
    del trial["imu_mag"]
    savemat(tmp_path / "less.mat", trial)
    with pytest.raises(RecordingError, match="imu_mag"):
        Recording.read(tmp_path / "less.mat")
