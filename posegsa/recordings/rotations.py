"""Rotations on the host, in float64: quaternions (w, x, y, z), matrices, and those of frames."""

import numpy as np

from posegsa.errors import RecordingError
from posegsa.recordings.frames import NORTH, UP, Frame


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), scalar first; NaN stays NaN."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternions(matrices: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3); NaN stays NaN.

    Each component can serve as the divisor; the largest is used for accuracy (S. W. Shepperd,
    "Quaternion from rotation matrix", 1978).
    """
    R = np.asarray(matrices, np.float64)
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    x_of = R[..., 2, 1] - R[..., 1, 2], R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0]
    y_of = R[..., 0, 2] - R[..., 2, 0], R[..., 2, 1] + R[..., 1, 2]
    z_of = R[..., 1, 0] - R[..., 0, 1]
    squares = np.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], -1)
    each = np.stack(
        [
            np.stack([squares[..., 0], x_of[0], y_of[0], z_of], -1),
            np.stack([x_of[0], squares[..., 1], x_of[1], x_of[2]], -1),
            np.stack([y_of[0], x_of[1], squares[..., 2], y_of[1]], -1),
            np.stack([z_of, x_of[2], y_of[1], squares[..., 3]], -1),
        ],
        axis=-2,
    )
    largest = np.argmax(squares, axis=-1)[..., None, None]
    q = np.take_along_axis(each, largest, axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton product p q (..., 4)."""
    a, b, c, d = np.moveaxis(p, -1, 0)
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def inverse(q: np.ndarray) -> np.ndarray:
    """The inverse of unit quaternions (..., 4)."""
    return q * [1, -1, -1, -1]


def log(q: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of unit quaternions (..., 4)."""
    q = np.where(q[..., :1] < 0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., :1])
    return np.where(length > 0, angle / np.where(length > 0, length, 1), 2.0) * q[..., 1:]


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) by an angle [rad] about an axis (3,) of length one."""
    half = 0.5 * angle
    return matrices(np.concatenate([[np.cos(half)], np.sin(half) * np.asarray(axis)]))


def to_east_north_up(frame: Frame) -> np.ndarray:
    """The rotation (3, 3) that takes coordinates in a frame to east, north, up."""
    return np.array([np.cross(NORTH[frame], UP[frame]), NORTH[frame], UP[frame]], float)


def check_rotations(name: str, R: np.ndarray) -> None:
    """Raise a RecordingError unless the finite matrices of R (K, 3, 3) are rotations."""
    known = np.isfinite(R).all(axis=(1, 2))
    some = R[known]
    off = np.abs(some @ some.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0) > 1e-3
    off |= np.linalg.det(some) < 0
    if off.any():
        k = int(np.flatnonzero(known)[np.argmax(off)])
        raise RecordingError(f"{name}: must be rotations, got {R[k].tolist()} at sample {k}")
