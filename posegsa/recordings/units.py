"""Detection of signals in wrong units, which would otherwise just give a wrong estimate.

Two sensors measure how far the body turns: the gyroscope, and the accelerometer, whose direction u
changes by du = -(omega dt) x u in the body frame if the body hardly accelerates. So a least squares
fit of du by -(omega dt) x u gives the gyroscope's unit: 1 for rad/s, pi/180 for deg/s.
"""

import math

import numpy as np

from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_rows, known_means

DEGREE = math.pi / 180
WINDOW = 0.1
"""Averaging time of the signals before they are compared [s]."""
MIN_TURN = 0.1
"""Minimum sum of squared turns by the accelerometer [rad^2] for determining the unit: 18 deg in
one turn."""
MIN_CORRELATION = 0.1
"""Minimum correlation of both turns for determining the unit. Below it the body's accelerations
turn the direction: a slope near 0 is then no unit. In windows of 5 s and more of BROAD it is above
that wherever the slope is that of rad/s to a factor of two, but for one in 500."""
GRAVITIES = 0.5, 2.0
"""Range of the median length of accelerations in multiples of g."""
ACCELERATIONS = 5.0, 40.0
"""Allowed range of the median length, which includes gravity [m/s^2]."""


FASTEST, FAST_SHARE = 75.0, 0.01
"""Angular velocity [rad/s] above the range of gyroscopes (4000 deg/s), and the share of samples
that may be beyond it as outliers."""


def check_units(gyr: np.ndarray, acc: np.ndarray, time_step: float) -> None:
    """Raise a RecordingError if angular velocity or acceleration seem to be in a wrong unit.

    Args:
        gyr: (K, 3), expected in rad/s.
        acc: (K, 3), expected in m/s^2; NaN where missing.
        time_step: of all samples [s].
    """
    lengths = np.linalg.norm(acc[finite_rows(acc)], axis=1)
    if not lengths.size:
        raise RecordingError("acc: holds no finite sample; allowed: specific force [m/s^2]")
    median = float(np.median(lengths))
    if GRAVITIES[0] < median < GRAVITIES[1]:
        raise RecordingError(
            f"acc: has a median length of {median:.3g}, which looks like multiples of g; allowed: "
            "m/s^2 (multiply by 9.80665)"
        )
    if not ACCELERATIONS[0] < median < ACCELERATIONS[1]:
        raise RecordingError(
            f"acc: has a median length of {median:.3g} m/s^2; allowed: specific force with gravity "
            "in it, about 9.8 m/s^2 at rest"
        )
    fast = float(np.mean(np.abs(gyr[finite_rows(gyr)]).max(axis=1) > FASTEST))
    if fast > FAST_SHARE:
        raise RecordingError(
            f"gyr: is above {FASTEST:g} in {100 * fast:.2g} % of the samples, which no gyroscope "
            "measures in rad/s, so it looks like deg/s; allowed: rad/s (np.deg2rad makes them)"
        )
    unit = gyroscope_unit(gyr, acc, time_step)
    if unit is not None and DEGREE / 2 < unit < DEGREE * 2:
        raise RecordingError(
            f"gyr: turns {1 / unit:.3g} times as far as the direction of acc, so it looks like "
            "deg/s; allowed: rad/s (np.deg2rad makes them)"
        )


def gyroscope_unit(gyr: np.ndarray, acc: np.ndarray, time_step: float) -> float | None:
    """The factor on gyr (K, 3) that fits acc (K, 3).

    None if the body hardly turns, or if acc does not follow its turns. Means over WINDOW of what is
    not missing are compared, so it is inaccurate if the body turns fast or shakes.
    """
    size = max(1, round(WINDOW / time_step))
    blocks = len(gyr) // size
    if blocks < 2:
        return None
    turned = gyr[: blocks * size].reshape(blocks, size, 3).mean(axis=1) * (size * time_step)
    u = known_means(acc[: blocks * size].reshape(blocks, size, 3))
    u = u / np.maximum(np.linalg.norm(u, axis=1, keepdims=True), np.finfo(float).tiny)
    moved = u[1:] - u[:-1]
    expected = -np.cross(0.5 * (turned[1:] + turned[:-1]), 0.5 * (u[1:] + u[:-1]))
    known = finite_rows(moved)
    moved, expected = moved[known], expected[known]
    if np.sum(moved**2) < MIN_TURN:
        return None
    square, both = float(np.sum(expected**2)), float(np.sum(expected * moved))
    if both <= MIN_CORRELATION * math.sqrt(square * float(np.sum(moved**2))):
        return None
    return both / square
