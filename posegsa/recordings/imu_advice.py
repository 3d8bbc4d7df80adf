"""What an inertial sensor's own signals say against it: advice before its recording is used.

The samples are divided into parts of PART_TIME seconds. In a part the sensor rests if gyroscope and
accelerometer stay near their means, by the thresholds of the attitude filter (`filters.attitude`).
What the gyroscope shows there is a bias if gravity and field do not turn as it says. Where neither
would turn, as gravity does not about the vertical, it is one up to the largest that the filter
takes for a bias.
"""

from collections.abc import Iterator

import numpy as np

from posegsa.filters.attitude import LARGEST_BIAS, REST_SHAKING, REST_TURNING
from posegsa.model.measurements import known_means
from posegsa.recordings.frames import GRAVITY

PART_TIME = 0.5
"""Length of a part [s]."""
MIN_PARTS = 4
"""Parts of rest, or of motion, that are enough to say something."""
COMPARED_AFTER, MIN_SIDEWAYS_SHARE, MIN_SEEN_SHARE = 1.5, 0.3, 0.3
"""Time between the directions that are compared at rest [s]; smallest share of a turn that must be
perpendicular to a direction for it to show the turn; and smallest part of that share that must be
seen for the turn to be real."""
FIELD_OFF, FORCE_OFF, BIAS_OFF = 0.1, 0.02, float(np.deg2rad(1.0))
"""Change of the field's length, and error of the acceleration's at rest, as shares, and bias of the
gyroscope [rad/s], from which on there is advice. Of the 17 trials of BROAD that were looked at,
only two with a magnet at 1 and 2 cm exceed one of them."""


def advice(gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray | None, time_step: float) -> list[str]:
    """Sentences about what is wrong with an inertial sensor by its signals; none if all is well.

    Args:
        gyr: (K, 3) angular velocity [rad/s].
        acc: (K, 3) specific force [m/s^2]; NaN where missing.
        mag: (K, 3) magnetic field in any unit, NaN where missing; None without a magnetometer.
        time_step: median time between samples [s].
    """
    return list(_advice(gyr, acc, mag, max(1, round(PART_TIME / time_step))))


def _advice(gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray | None, length: int) -> Iterator[str]:
    turning, force = _parts(gyr, length), _parts(acc, length)
    bias, pull = known_means(turning), known_means(force)
    still = (_spread(turning, bias) < REST_TURNING) & (_spread(force, pull) < REST_SHAKING)
    # A field of 0 is missing, as it is for the filter.
    known = None if mag is None else np.where(mag.any(axis=1, keepdims=True), mag, np.nan)
    field = None if known is None else _parts(known, length)
    if np.count_nonzero(still) >= MIN_PARTS:
        shown = np.median(bias[still], axis=0)
        speed = float(_length(shown))
        seen = [
            _turned(one, still, shown)
            for one in (pull, None if field is None else known_means(field))
        ]
        told = [share for share in seen if share is not None]
        if speed >= BIAS_OFF and (max(told) < MIN_SEEN_SHARE if told else speed <= LARGEST_BIAS):
            yield (
                f"the gyroscope shows {np.degrees(speed):.1f} deg/s at rest: subtract it, or have "
                f"the filter expect it (filter.initial_bias = {2 * speed:.2g}, in a file from "
                "`posegsa config show imu`)"
            )
        g = float(np.median(_length(pull[still])))
        if abs(g / GRAVITY - 1) >= FORCE_OFF:
            yield (
                f"the accelerometer shows {g:.2f} m/s^2 at rest, {100 * abs(g / GRAVITY - 1):.0f} "
                f"% {'more' if g > GRAVITY else 'less'} than gravity: calibrate it"
            )
    if field is None:
        return
    size = known_means(_length(field)[..., None])[:, 0]
    resting, moving = (size[np.isfinite(size) & which] for which in (still, ~still))
    cure = "calibrate the magnetometer in its place, or remove the magnet that is attached"
    if min(len(resting), len(moving)) >= MIN_PARTS:
        ratio = float(np.median(moving) / np.median(resting))
        if abs(ratio - 1) >= FIELD_OFF:
            share = 100 * abs(ratio - 1)
            yield f"the field differs by {share:.0f} % between rest and motion: {cure}"
            return
    if len(moving) >= MIN_PARTS:
        low, middle, high = np.quantile(moving, (0.05, 0.5, 0.95))
        if (high - low) / (2 * middle) >= FIELD_OFF:
            share = 100 * (high - low) / (2 * middle)
            yield f"the field's length varies by {share:.0f} % while the body moves: {cure}"


def _turned(seen: np.ndarray | None, still: np.ndarray, shown: np.ndarray) -> float | None:
    """How far a direction (parts, 3) turns at rest, as a share of what the gyroscope shows.

    `shown` (3,) is that [rad/s]. None if the direction, or a gap between its samples, says nothing.
    """
    speed = float(_length(shown))
    if seen is None or not speed:
        return None
    at = np.flatnonzero(still & np.isfinite(seen).all(axis=1) & (_length(seen) > 0))
    apart = max(1, round(min(COMPARED_AFTER, 0.5 * np.pi / speed) / PART_TIME))
    later = np.searchsorted(at, at + apart)
    first, last = at[later < len(at)], at[later[later < len(at)]]
    moved = np.cumsum(~still)
    turn = speed * PART_TIME * (last - first)
    u, v = (seen[k] / _length(seen[k])[:, None] for k in (first, last))
    sideways = _length(np.cross(shown / speed, u))
    tells = (moved[first] == moved[last]) & (sideways > MIN_SIDEWAYS_SHARE) & (turn < np.pi)
    if not tells.any():
        return None
    angle = np.arctan2(_length(np.cross(u, v)), np.sum(u * v, axis=1))
    expected = 2 * np.arcsin(sideways * np.sin(0.5 * np.minimum(turn, np.pi)))
    return float(np.median(angle[tells] / expected[tells]))


def _spread(parts: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Largest distance (parts,) from the mean, of what is finite; infinite where nothing is."""
    off = _length(parts - mean[:, None])
    return np.where(np.isnan(mean[:, 0]), np.inf, np.fmax.reduce(off, axis=1))


def _parts(signal: np.ndarray, length: int) -> np.ndarray:
    """A signal (K, 3) in whole parts (parts, length, 3)."""
    count = len(signal) // length
    return np.asarray(signal)[: count * length].reshape(count, length, 3)


def _length(a: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a, axis=-1)
