"""Reads trials of BROAD, the Berlin robust orientation estimation assessment data set.

D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - a benchmark for robust inertial orientation
estimation", Data 6(7):72, 2021. Everything is measured: gyroscope, accelerometer, magnetometer and
the reference by optical motion capture, whose z axis points up.
"""

from pathlib import Path
from typing import Any

import numpy as np

from posegsa.recordings.checked_files import file_of, reading
from posegsa.recordings.frames import GRAVITY

GYROSCOPE = "measured (BROAD's gyroscope)"
"""What a trial's `sources` say of its angular velocity."""


def read_broad(path: str | Path) -> dict[str, Any]:
    """Arguments of `Recording.from_arrays` from a trial's .mat file; see `Recording.from_broad`.

    Raises:
        RecordingError: it cannot be read, or is not a trial.
    """
    from scipy.io import loadmat  # not at the top: takes a while to load

    path = file_of(path)
    with reading(path):
        held = loadmat(path, variable_names=_FIELDS)
        gyr, acc, mag = (np.asarray(held[f"imu_{name}"], float) for name in ("gyr", "acc", "mag"))
        truth = np.asarray(held["opt_quat"], float)
        moving = np.ravel(held["movement"]).astype(bool)
        rate = float(np.ravel(held["sampling_rate"])[0])
    east = np.cross(mag, acc)
    first = slice(0, max(1, round(rate)))
    return {
        "name": path.stem,
        "time_step": 1 / rate,
        "angular_velocity": gyr,
        "vectors": np.stack([acc / GRAVITY, east / _length(east[first])], axis=1),
        "vector_references": [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        "truth_quaternion": truth,
        "judged": moving,
        "phases": {"rest": ~moving, "motion": moving},
        "start": "rest",
        "sensors": {"accelerometer": acc, "magnetometer": mag},
        "sources": {
            "angular velocity": GYROSCOPE,
            "vectors": "measured: a / 9.81 m/s^2 (up), and m x a (east), not normalised",
            "truth": "measured (optical motion capture)",
        },
    }


_FIELDS = "imu_gyr", "imu_acc", "imu_mag", "opt_quat", "movement", "sampling_rate"


def _length(vectors: np.ndarray) -> float:
    """Length of the mean of vectors (K, 3); 1 if none is finite."""
    mean = np.nanmean(vectors, axis=0) if np.isfinite(vectors).any() else np.zeros(3)
    return float(np.linalg.norm(mean)) or 1.0
