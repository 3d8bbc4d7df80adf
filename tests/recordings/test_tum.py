"""TUM files, also as read by evo."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import motion
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.errors import RecordingError

pytestmark = pytest.mark.quick


def test_a_line_is_time_position_and_quaternion_scalar_last() -> None:
    R = Rotation.random(3, rng=0)
    P = np.arange(9.0).reshape(3, 3)
    matrices = R.as_matrix()
    matrices[1] = np.nan
    lines = posegsa.tum_text([0, 0.5, 1.0000000012], matrices, P).splitlines()
    assert len(lines) == 2  # unknown samples are omitted
    numbers = np.array([line.split(" ") for line in lines], float)
    np.testing.assert_array_equal(numbers[:, 0], [0, 1.000000001])
    np.testing.assert_allclose(numbers[:, 1:4], P[[0, 2]])
    read = Rotation.from_quat(numbers[:, 4:])
    np.testing.assert_allclose(read.as_matrix(), matrices[[0, 2]], atol=1e-9)
    assert posegsa.tum_text([0], matrices[:1]).split()[1:4] == ["0", "0", "0"]


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    R, P = Rotation.random(3, rng=0), np.arange(9.0).reshape(3, 3)
    path = tmp_path / "a.tum"
    path.write_text("# time x y z\n\n" + posegsa.tum_text([0, 0.5, 1], R.as_matrix(), P))
    found = posegsa.read_tum(path)
    np.testing.assert_array_equal(found["truth_position"][0], [0, 0.5, 1])
    np.testing.assert_array_equal(found["truth_position"][1], P)
    read = Rotation.from_quat(np.asarray(found["truth_quaternion"][1]), scalar_first=True)
    np.testing.assert_allclose(read.as_matrix(), R.as_matrix(), atol=1e-9)


def test_a_csv_file_has_its_truth_from_a_tum_file(tmp_path: Path) -> None:
    given = motion()
    time = 100 + np.arange(400) / 100
    rows = np.column_stack([time, given["angular_velocity"], given["vectors"][:, 0]])
    head = "time,wx,wy,wz,v0_x,v0_y,v0_z"
    path = tmp_path / "a.csv"
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    truth = given["truth_rotation"][::4], given["truth_position"][::4]
    (tmp_path / "a.tum").write_text(posegsa.tum_text(time[::4], *truth))
    beside = tmp_path / "a.csv.toml"
    beside.write_text('truth = "a.tum"\nvector_references = [[0, 0, 1]]')
    recording = posegsa.Recording.read(path)
    assert np.flatnonzero(recording.judged).tolist() == list(range(0, 400, 4))
    assert_states(recording.describe(), "truth_quaternion", "100 samples", "25 Hz")
    between = {"truth": "interpolate"}
    recording = posegsa.Recording.from_csv(path, truth=tmp_path / "a.tum", between=between)
    assert recording.judged.sum() == 397
    assert recording.truth is not None
    np.testing.assert_allclose(
        recording.truth.rotation[:397], given["truth_rotation"][:397], atol=1e-3
    )


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        ("1 2 3\n", ("line 1", "3", "qw")),
        ("# head\n1 2 3 4 0 0 0 x\n", ("line 2", "x")),
        ("1 2 3 4 0 0 0 2\n", ("line 1", "qx", "2")),
        ("# nothing\n", ("no pose", "qw")),
    ],
)
def test_a_file_that_is_none_is_refused(text: str, facts: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(RecordingError) as caught:
        posegsa.read_tum(path)
    assert_states(str(caught.value), "a.tum", *facts)


@pytest.mark.parametrize(("relation", "ours"), [("trans_part", "position"), ("angle_deg", "total")])
def test_evo_finds_the_same_rmse(tmp_path: Path, relation: str, ours: str) -> None:
    evo = shutil.which("evo_ape")
    if evo is None:
        pytest.skip("evo is not installed (pip install posegsa[trajectories])")
    rng = np.random.default_rng(0)
    time = 0.005 * np.arange(500)
    true = Rotation.from_rotvec(np.stack([time, 0.3 * time, 0.1 + 0 * time], axis=1))
    estimated = Rotation.from_rotvec(0.05 * rng.normal(size=(500, 3))) * true
    P = np.stack([np.sin(time), np.cos(time), time], axis=1)
    P_est = P + 0.1 * rng.normal(size=P.shape)
    paths = tmp_path / "true.tum", tmp_path / "estimated.tum"
    paths[0].write_text(posegsa.tum_text(time, true.as_matrix(), P))
    paths[1].write_text(posegsa.tum_text(time, estimated.as_matrix(), P_est))
    said = subprocess.run(
        [evo, "tum", *map(str, paths), "-r", relation],
        capture_output=True,
        text=True,
        check=True,
        env={"HOME": str(tmp_path), "PATH": str(Path(evo).parent)},
    ).stdout
    theirs = float(re.search(r"rmse\s+([\d.]+)", said)[1])  # type: ignore[index]  # None fails the test too
    mine = {
        "position": posegsa.rmse(posegsa.position_errors(P_est, P)),
        "total": posegsa.rmse(
            posegsa.attitude_errors(estimated.as_matrix(), true.as_matrix()).total
        ),
    }[ours]
    assert mine == pytest.approx(theirs, abs=1e-6)
