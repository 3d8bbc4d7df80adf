"""The reference of a recording: its true pose, where that is known."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array
from posegsa.recordings.rotations import check_rotations, matrices


class RecordedTruth(NamedTuple):
    """The reference at K samples; NaN where it is unknown."""

    rotation: np.ndarray
    """(K, 3, 3) R, body to inertial."""
    position: np.ndarray | None
    """(K, 3) P [m], inertial frame; None if the position is not judged."""

    @property
    def known(self) -> np.ndarray:
        """(K,) True where rotation and position are known."""
        return all_finite(*(a for a in self if a is not None))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> "RecordedTruth":
        """The reference with a function applied to both arrays."""
        position = None if self.position is None else change(self.position)
        return RecordedTruth(change(self.rotation), position)


def all_finite(*arrays: np.ndarray) -> np.ndarray:
    """Whether all numbers of arrays (K, ...) are finite, (K,)."""
    each = [np.isfinite(a).all(axis=tuple(range(1, a.ndim))) for a in arrays]
    return np.all(each, axis=0)


def checked_truth(
    samples: int,
    rotation: ArrayLike | None,
    quaternion: ArrayLike | None,
    position: ArrayLike | None,
    attitude_only: bool,
) -> RecordedTruth | None:
    """The checked reference, without a position if that is not estimated."""
    if quaternion is not None:
        q = finite_array("truth_quaternion", quaternion, (samples, 4), finite=False)
        length = np.linalg.norm(q, axis=1, keepdims=True)
        off = np.abs(length - 1) > 0.05  # False for NaN
        if off.any():
            k = int(np.argmax(off))
            raise RecordingError(
                f"truth_quaternion: must have the length 1, got {length[k, 0]:.4g} at sample {k}"
            )
        R = matrices(q / length)
    elif rotation is not None:
        R = finite_array("truth_rotation", rotation, (samples, 3, 3), finite=False)
        check_rotations("truth_rotation", R)
    elif position is not None:
        raise RecordingError("truth_position: given without a truth_rotation or truth_quaternion")
    else:
        return None
    if position is None or attitude_only:
        return RecordedTruth(R, None)
    return RecordedTruth(R, finite_array("truth_position", position, (samples, 3), finite=False))
