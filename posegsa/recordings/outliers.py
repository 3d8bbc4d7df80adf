"""Detection of outliers among the measurements of landmarks.

Landmarks do not move. In the frame that results from integrating the velocities a landmark is
constant, except for measurement noise and the errors of the velocities; a measurement that jumps
there is an outlier. This needs no estimate of the pose. The filter's own residual would not do: it
is also large while the estimate is wrong, as at every start, and then a large residual may be just
what corrects the estimate.

A measurement is an outlier if its distance is above a limit both from the last measurement that is
not an outlier and from the measurement before it. So after a permanent jump (the landmark was
moved, or its first measurement was wrong) only one measurement is lost.

The limit is `factor` times the median step of the landmark from one measurement to the next, but at
least MIN_JUMP times its distance. After a longer interval than usual it grows with the square root
of that interval. An outlier spoils two steps, so the median is reliable while less than a quarter
of the measurements are outliers.
"""

import math
from numbers import Real
from typing import Literal

import numpy as np

from posegsa.errors import RecordingError
from posegsa.recordings.inertial_frame import strapdown
from posegsa.words import counted

MIN_JUMP = 0.05
"""Smallest jump of an outlier, as a share of the landmark's distance. With little or no noise the
median is small, and the errors of the velocities alone would exceed it."""


def without_outliers(
    values: dict[str, np.ndarray], time: np.ndarray, factor: float | Literal["off"]
) -> list[str]:
    """Set the weights of outliers among landmarks to 0, in place; what was done, in words.

    Args:
        values: the arrays of a recording by name, `Recording.measurements`' own names.
        time: (K,) since the first sample [s].
        factor: `landmark_outlier` of `Recording.from_arrays`.

    Raises:
        RecordingError: The factor is neither a number from 1 on nor "off".
    """
    number = isinstance(factor, Real) and not isinstance(factor, bool)
    if not (factor == "off" if isinstance(factor, str) else number and 1 <= factor < math.inf):
        raise RecordingError(
            f'landmark_outlier = {factor!r}; allowed: a number from 1 on, or "off"'
        )
    seen, time_step = values["landmark_weights"] > 0, values["time_step"]
    if isinstance(factor, str) or not seen.any():
        return []
    R = strapdown(values["angular_velocity"], time_step)
    middle = np.concatenate([0.5 * (R[1:] + R[:-1]), R[-1:]])
    moved = np.einsum("kij,kj->ki", middle, values["velocity"]) * time_step[:, None]
    P = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)[:-1]])
    elapsed = np.concatenate([[0.0], np.cumsum(time_step)[:-1]])
    outliers = np.zeros(seen.shape, bool)
    for i, there in enumerate(seen.T):
        at = np.flatnonzero(there)
        if at.size > 1:
            y = values["landmarks"][at, i]
            place = np.einsum("kij,kj->ki", R[at], y) + P[at]
            distance = np.linalg.norm(y, axis=1)
            outliers[at, i] = _jumps(place, distance, elapsed[at], factor)
    if not outliers.any():
        return []
    values["landmark_weights"] = np.where(outliers, 0.0, values["landmark_weights"])
    first = float(time[np.argmax(outliers.any(axis=1))])
    each = ", ".join(f"{n} of landmark {i}" for i, n in enumerate(outliers.sum(axis=0)) if n)
    return [
        f"{counted(int(outliers.sum()), 'sighting')} ignored: more than {factor:g} times the usual "
        f"distance from the position that the velocities predict; {each}, the first at {first:.6g} "
        "s"
    ]


def _jumps(place: np.ndarray, distance: np.ndarray, time: np.ndarray, factor: float) -> np.ndarray:
    """Which of J measurements of one landmark are outliers; all places (J, 3) should be equal."""
    interval = np.diff(time)
    usual = np.median(interval)
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
    median = float(np.median(steps))

    def agree(j: np.ndarray | int, k: np.ndarray | int) -> np.ndarray:
        """Whether measurement j agrees with the earlier measurement k."""
        least = MIN_JUMP * np.minimum(distance[j], distance[k])
        limit = np.maximum(factor * median, least)
        limit = limit * np.sqrt(np.maximum((time[j] - time[k]) / usual, 1.0))
        return np.linalg.norm(place[j] - place[k], axis=-1) <= limit

    each = np.arange(len(place))
    kept = np.concatenate([[True], agree(each[1:], each[:-1])])
    latest, regained = np.maximum.accumulate(np.where(kept, each, 0)), 0
    for j in np.flatnonzero(~kept).tolist():
        k = max(int(latest[j]), regained)  # the last measurement before j that is kept
        if k < j - 1 and agree(j, k):
            kept[j], regained = True, j
    return ~kept
