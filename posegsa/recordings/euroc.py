"""Reads sequences of the EuRoC MAV data set and simulates the sensors that it lacks.

M. Burri et al., "The EuRoC micro aerial vehicle datasets", International Journal of Robotics
Research 35(10), 2016. The gyroscope (with its bias) and the reference are measured. The velocity in
the body frame and the landmarks are simulated from the reference; `sources` states their noise.
"""

from pathlib import Path
from typing import Any

import numpy as np

from posegsa.arguments import check_number
from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array
from posegsa.recordings.checked_files import as_path, reading
from posegsa.recordings.rotations import matrices

IMU = "mav0/imu0/data.csv", "imu0/data.csv", "*imu0.csv"
TRUTH = (
    "mav0/state_groundtruth_estimate0/data.csv",
    "state_groundtruth_estimate0/data.csv",
    "*groundtruth.csv",
)
"""Patterns of the files of a sequence, in the order in which they are tried."""
LANDMARKS = ((-4.0, -3.0, 0.5), (4.0, -3.0, 2.5), (4.0, 3.0, 0.5), (-4.0, 3.0, 2.5))
"""Corners of a room as large as the Vicon rooms [m]."""
MAX_STAMP_DIFFERENCE = 0.1
"""Maximum difference of matching time stamps of IMU and reference, as a share of a step."""


def read_euroc(
    folder: str | Path,
    landmarks: Any,
    landmark_noise: float,
    landmark_rate: float,
    velocity_noise: float,
    velocity_bias: Any,
    seed: int,
) -> dict[str, Any]:
    """Arguments of `Recording.from_arrays` from a sequence; see `Recording.from_euroc`.

    Raises:
        RecordingError: there is no sequence, or its files cannot be read or do not fit together.
    """
    folder = as_path(folder)
    imu_stamps, imu = _table(_find(folder, IMU), 6)
    stamps, truth = _table(_find(folder, TRUTH), 16)
    points = finite_array("landmarks", landmarks, (None, 3))
    bias = finite_array("velocity_bias", velocity_bias, (3,))
    for name, value in (("landmark_noise", landmark_noise), ("velocity_noise", velocity_noise)):
        check_number(name, value, 0.0, 1e3)
    check_number("landmark_rate", landmark_rate, 1e-3, 1e6)

    nearest = np.clip(np.searchsorted(stamps, imu_stamps), 1, len(stamps) - 1)
    nearest -= imu_stamps - stamps[nearest - 1] < stamps[nearest] - imu_stamps
    step = np.median(np.diff(imu_stamps))
    both = np.abs(stamps[nearest] - imu_stamps) <= MAX_STAMP_DIFFERENCE * step
    if both.sum() < 2:
        raise RecordingError(f"{folder}: no time stamps of the IMU and the reference match")
    first, last = np.flatnonzero(both)[[0, -1]]
    used = slice(int(first), int(last) + 1)
    known, row = both[used], nearest[used]
    P, q, v = (np.where(known[:, None], truth[row, part], np.nan) for part in _PARTS)
    R = matrices(q / np.linalg.norm(q, axis=1, keepdims=True))

    count, rng = len(known), np.random.default_rng(seed)
    body_velocity = np.einsum("kji,kj->ki", R, v) + bias
    body_velocity += velocity_noise * rng.normal(size=(count, 3))
    seen = np.einsum("kji,knj->kni", R, points - P[:, None])
    seen += landmark_noise * rng.normal(size=seen.shape)
    period = max(1, round(1e9 / (landmark_rate * step)))
    seen[np.arange(count) % period != 0] = np.nan
    rate = 1e9 / (period * step)
    left_out = len(imu_stamps) - count
    return {
        "name": folder.name,
        "time": imu_stamps[used],
        "angular_velocity": imu[used, :3],
        "velocity": body_velocity,
        "landmarks": seen,
        "landmark_references": points,
        "landmark_weights": 1 / np.maximum(np.sum(points**2, axis=1), 1.0),
        "truth_rotation": R,
        "truth_position": P,
        "sensors": {"accelerometer": imu[used, 3:]},
        "sources": {
            "angular velocity": "measured (EuRoC's gyroscope, with its bias)",
            "velocity": f"synthetic: R^T v of the reference + bias {bias.tolist()} m/s + white "
            f"noise of {velocity_noise:g} m/s per axis, seed {seed}",
            "landmarks": f"synthetic: {len(points)} points at {rate:.4g} Hz, R^T (p - P) of the "
            f"reference + white noise of {landmark_noise:g} m per axis, seed {seed}",
            "truth": "measured (motion capture and IMU, EuRoC's reference)",
        },
        "notes": (f"{left_out} IMU samples before and after the reference left out",)
        if left_out
        else (),
    }


_PARTS = slice(0, 3), slice(3, 7), slice(7, 10)
"""Columns of position [m], quaternion (w, x, y, z) and velocity [m/s, inertial frame]."""


def _find(folder: Path, names: tuple[str, ...]) -> Path:
    if not folder.is_dir():
        raise RecordingError(f"{folder}: there is no such folder")
    found = [path for name in names for path in sorted(folder.glob(name))]
    if not found:
        raise RecordingError(
            f"{folder}: is no EuRoC sequence: it holds none of {', '.join(names)}; allowed: the "
            "folder of a sequence, or a .csv, .npz or .mat file"
        )
    return found[0]


def _table(path: Path, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Time stamps (K,) [ns] as integers, and the other columns (K, columns) of a file."""
    with reading(path):
        stamps = np.loadtxt(path, np.int64, delimiter=",", usecols=0, ndmin=1)
        values = np.loadtxt(path, delimiter=",", usecols=range(1, columns + 1), ndmin=2)
    if len(stamps) < 2 or not (np.diff(stamps) > 0).all():
        raise RecordingError(f"{path}: stamps must ascend, two or more")
    return stamps, values
