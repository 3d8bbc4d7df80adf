"""Landmarks that are seen where they cannot be.

A landmark does not move. In the frame that the velocities, integrated, give, it stays where it is,
but for their errors and for the noise of its own sightings; so one that jumps there is an outlier.
That frame needs no estimate of the pose: the residual of the filter itself is large too where the
estimate is wrong, as it is at every start, and what it calls an outlier then may be what would
correct it.

A sighting is passed over if it is farther than a limit both from the last one that was not passed
over and from the one just before it. So after a jump that lasts (the landmark was moved, or its
first sighting was the wrong one) one sighting is lost, and the next is believed.

The limit is `factor` medians of how far the landmark moves there from one sighting to the next, but
at least LEAST of its distance; after a longer time than usual between two sightings it grows with
the root of that time. An outlier spoils two such steps, so the median holds while less than a
quarter of the sightings are outliers.
"""

import numpy as np

from posegsa.recordings.inertial_frame import strapdown
from posegsa.words import counted

LEAST = 0.05
"""A jump of less than this share of a landmark's distance makes no outlier: where little noise, or
none, makes the median small, the errors of the velocities must not count."""


def landmark_outliers(
    landmarks: np.ndarray,
    seen: np.ndarray,
    angular_velocity: np.ndarray,
    velocity: np.ndarray,
    time_step: np.ndarray,
    factor: float,
) -> np.ndarray:
    """Which sightings (K, m) are outliers.

    Args:
        landmarks: (K, m, 3) their positions in the body frame [m].
        seen: (K, m) whether each was seen.
        angular_velocity: (K, 3) body frame [rad/s], from each sample to the next.
        velocity: (K, 3) likewise [m/s].
        time_step: (K,) to the next sample [s].
        factor: how many medians of a landmark's own jumps are out of all proportion.
    """
    outliers = np.zeros(seen.shape, bool)
    if not seen.any():
        return outliers
    R = strapdown(angular_velocity, time_step)
    middle = np.concatenate([0.5 * (R[1:] + R[:-1]), R[-1:]])
    moved = np.einsum("kij,kj->ki", middle, velocity) * time_step[:, None]
    P = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)[:-1]])
    time = np.concatenate([[0.0], np.cumsum(time_step)[:-1]])
    for i, there in enumerate(seen.T):
        at = np.flatnonzero(there)
        if at.size > 1:
            y = landmarks[at, i]
            place = np.einsum("kij,kj->ki", R[at], y) + P[at]
            distance = np.linalg.norm(y, axis=1)
            outliers[at, i] = _jumps(place, distance, time[at], factor)
    return outliers


def outliers_in_words(outliers: np.ndarray, time: np.ndarray, factor: float) -> str:
    """How many sightings (K, m) at times (K,) were passed over, and why, for a person."""
    count = int(outliers.sum())
    first = float(time[np.argmax(outliers.any(axis=1))])
    each = ", ".join(f"{n} of landmark {i}" for i, n in enumerate(outliers.sum(axis=0)) if n)
    return (
        f"{counted(count, 'sighting')} passed over: more than {factor:g} times as far as usual "
        f"from where the velocities put the landmark; {each}, the first at {first:.6g} s"
    )


def _jumps(place: np.ndarray, distance: np.ndarray, time: np.ndarray, factor: float) -> np.ndarray:
    """Which of J sightings of one landmark, at places (J, 3) that should be one, are outliers."""
    interval = np.diff(time)
    usual = np.median(interval)
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
    median = float(np.median(steps))

    def agree(j: np.ndarray | int, k: np.ndarray | int) -> np.ndarray:
        """Whether sighting j is where sighting k, before it, was."""
        least = LEAST * np.minimum(distance[j], distance[k])
        limit = np.maximum(factor * median, least)
        limit = limit * np.sqrt(np.maximum((time[j] - time[k]) / usual, 1.0))
        return np.linalg.norm(place[j] - place[k], axis=-1) <= limit

    each = np.arange(len(place))
    kept = np.concatenate([[True], agree(each[1:], each[:-1])])
    latest, regained = np.maximum.accumulate(np.where(kept, each, 0)), 0
    for j in np.flatnonzero(~kept).tolist():
        k = max(int(latest[j]), regained)  # the last one before j that is kept
        if k < j - 1 and agree(j, k):
            kept[j], regained = True, j
    return ~kept
