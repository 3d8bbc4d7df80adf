"""TUM files, also as read by evo."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import posegsa

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
