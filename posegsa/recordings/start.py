"""Initial estimates: a given pose, or a pose from the measurements."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.first_pose import LIKE_A_DIRECTION
from posegsa.model.measurements import Measurements, finite_array
from posegsa.recordings.rotations import check_rotations

AVERAGING_TIME = 0.1
"""Averaging time of measurements for a start in motion [s]."""
ASSUMED_REST = 1.0
"""Assumed time at rest if the recording does not state it [s]."""


class Start(NamedTuple):
    """The estimate at the first sample."""

    rotation: np.ndarray
    """(3, 3) R_est, body to inertial."""
    position: np.ndarray
    """(3,) P_est [m], inertial frame; zeros if the position is not estimated."""
    bias: np.ndarray
    """(6,) b_est, body frame [rad/s, m/s], angular first."""


StartRule: TypeAlias = Start | Literal["rest", "sensors"]


def checked_start(start: Any) -> StartRule:
    """A checked start from a user."""
    if isinstance(start, str):
        if start not in ("rest", "sensors"):
            raise RecordingError(f'start = {start!r}; allowed: "rest", "sensors" or a pose')
        return start
    if not isinstance(start, Sequence) or len(start) not in (2, 3):
        raise RecordingError(
            'start: must be "rest", "sensors" or a pose, (rotation (3, 3), position (3,)) or with '
            "the bias (6,)"
        )
    rotation = finite_array("start rotation", start[0], (3, 3))
    check_rotations("start rotation", rotation[None])
    bias = np.zeros(6) if len(start) == 2 else finite_array("start bias", start[2], (6,))
    return Start(rotation, finite_array("start position", start[1], (3,)), bias)


def aligned(measurements: Measurements, samples: slice, bias: np.ndarray | None) -> Start:
    """The pose that fits the mean vectors and landmarks over some samples.

    The attitude solves Wahba's problem for the vectors' directions and the landmarks about their
    centroid, a landmark off by LIKE_A_DIRECTION counting as a direction off by a radian, by
    singular value decomposition (F. L. Markley, "Attitude determination using vector
    observations and the singular value decomposition", 1988). With a single direction it is the
    smallest rotation that fits, which leaves the heading arbitrary. The position follows from the
    landmarks; without any it is 0. A body that moves sees each sample from elsewhere: its
    measurements are carried to where the body was at the first of them, by its measured velocities.

    Args:
        measurements: of NumPy arrays.
        samples: the samples to average over.
        bias: (6,) of the velocities; None for their means, as at rest.

    Raises:
        RecordingError: neither a vector nor two landmarks are measured there.
    """
    m = measurements.at(samples)
    if bias is not None:
        m = _carried_to_the_first(m, bias)
    u, v = _means(m.vectors, m.vector_references, m.vector_weights)
    y, p = _means(m.landmarks, m.landmark_references, m.landmark_weights)
    body, inertial = _unit(u), _unit(v)
    if len(p):
        body, inertial = (
            np.concatenate([directions, (places - places.mean(axis=0)) / LIKE_A_DIRECTION])
            for directions, places in ((body, y), (inertial, p))
        )
    R = _wahba(body, inertial)
    position = np.mean(p - y @ R.T, axis=0) if len(p) else np.zeros(3)
    if bias is None:
        bias = np.concatenate([np.mean(a, axis=0) for a in (m.angular_velocity, m.velocity)])
    return Start(R, position, np.asarray(bias, np.float64))


def _carried_to_the_first(m: Measurements, bias: ArrayLike) -> Measurements:
    """Vectors and landmarks as the body at the first sample would have seen them."""
    from scipy.spatial.transform import Rotation  # slow to load

    turn, way = Rotation.identity(), np.zeros(3)  # from the first sample to sample k
    turns, ways = [], []
    angular, linear = np.split(np.asarray(bias, np.float64), 2)
    for dt, omega, v in zip(m.time_step, m.angular_velocity, m.velocity, strict=True):
        turns.append(turn.as_matrix())
        ways.append(way)
        half = Rotation.from_rotvec(0.5 * dt * (omega - angular))
        way = way + dt * (turn * half).apply(v - linear)
        turn = turn * half * half
    R, p = np.array(turns), np.array(ways)
    vectors = np.einsum("kij,knj->kni", R, m.vectors)
    landmarks = np.einsum("kij,knj->kni", R, m.landmarks) + p[:, None]
    return m._replace(vectors=vectors, landmarks=landmarks)


def _means(
    body: ArrayLike, inertial: ArrayLike, weights: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    """Means (n, 3) of all measured vectors or landmarks, in the body and the inertial frame."""
    seen = np.asarray(weights) > 0
    some = seen.any(axis=0)
    count = np.maximum(seen.sum(axis=0), 1)[:, None]
    means = [np.sum(np.where(seen[..., None], a, 0.0), axis=0) / count for a in (body, inertial)]
    return means[0][some], means[1][some]


def _wahba(body: np.ndarray, inertial: np.ndarray) -> np.ndarray:
    """R (3, 3) that best maps vectors (n, 3) of the body frame to those of the inertial one."""
    usable = body.any(axis=1) & inertial.any(axis=1)
    if not usable.any():
        raise RecordingError(
            "start: no vector and no two landmarks are seen at the first samples; allowed: a pose "
            "to begin with, start = [rotation by rows, position] in FILE.csv.toml beside FILE.csv, "
            'or in Python Recording.read(FILE, start=(R, P)).save("a.npz")'
        )
    body, inertial = body[usable], inertial[usable]
    u, v = _unit(body), _unit(inertial)
    apart = np.linalg.norm(np.cross(u[0], u), axis=1).max()
    if apart < 1e-3:
        return _smallest_rotation(u[0], v[0])
    left, _, right = np.linalg.svd(inertial.T @ body)
    flip = np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)])
    return left @ flip @ right


def _unit(a: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(a, axis=-1, keepdims=True)
    return np.divide(a, length, out=np.zeros_like(a), where=length > 0)


def _smallest_rotation(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) by the smallest angle that maps u to v, both of length one."""
    cosine = float(u @ v)
    if cosine < -1 + 1e-12:  # half a turn, about any axis perpendicular to u
        across = _unit(np.cross(u, np.eye(3)[np.argmin(np.abs(u))]))
        return 2 * np.outer(across, across) - np.eye(3)
    x, y, z = np.cross(u, v)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + K + K @ K / (1 + cosine)
