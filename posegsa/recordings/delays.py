"""The delay of each sensor of a recording, by comparison with the truth.

The prediction from the truth is shifted in time until it differs least from the measurement. The
shift is a delay if it explains much of the difference; or if the residual is white, as the noise of
a sensor is, and it explains more than chance does. The effects of a body's other motion, above all
its accelerations, are not white, and correlate with its turns. A truth has noise too, which makes
one shift better than the others where a body hardly moves: the shift must be the same whichever
parts of a recording are taken (a bootstrap over BLOCKS).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from posegsa.recordings.relations import MIN_INTERVALS, Quantities
from posegsa.recordings.rotations import inverse, log, product, quaternions

NAMED_DELAY = 0.025
"""Delay above which a sensor is named [s]."""
MAX_DELAY = 0.2
"""Largest delay that is tried [s]."""
MIN_EXPLAINED = 0.22
"""Minimum share of the squares that a named delay explains, if the residual is not white."""
MIN_TIMES_CHANCE = 64.0
"""The same if it is white, as a multiple of the share that chance alone explains."""
WHITE_CORRELATION = 0.4
"""Correlation of neighbouring samples up to which the residual counts as white."""
BLOCKS, DRAWS = 20, 400
"""Number of blocks of a recording, and of bootstrap draws of as many blocks."""
MAX_DISAGREEMENT = 0.01
"""Share of the draws that may show another delay, by more than half of NAMED_DELAY."""
DIFFERENTIATION_TIME = 0.05
"""Time over which the truth is differentiated [s]."""
OUTLIER_MEDIANS = 4.0
"""Differences of more than this many medians are left out."""


class Delay(NamedTuple):
    """The delay of a sensor."""

    sensor: str
    delay: float
    """Delay [s]; below 0 if the sensor is early."""
    explained: float
    """Share of the squared differences that the delay explains."""
    chance: float
    """The same share as a multiple of what chance explains."""
    correlation: float
    """Correlation of neighbouring samples of the residual."""
    astray: float
    """Share of the draws of parts of the recording that show another delay."""
    widest: bool = False
    """Whether it is the largest that was tried."""

    @property
    def clear(self) -> bool:
        """Whether the sensor is clearly late or early."""
        white = self.correlation < WHITE_CORRELATION and self.chance > MIN_TIMES_CHANCE
        white = white and not self.widest  # a trend is best explained at an end too
        told = self.astray <= MAX_DISAGREEMENT and (white or self.explained > MIN_EXPLAINED)
        return abs(self.delay) > NAMED_DELAY and told

    def __str__(self) -> str:
        word = "late" if self.delay > 0 else "early"
        more = " or more" if self.widest else ""
        return f"{self.sensor} looks {1000 * abs(self.delay):.0f} ms{more} {word}, by the truth"


def late_sensors(q: Quantities) -> list[str]:
    """The sensors that are late or early, in words; one line if all have the same delay."""
    every = [one for each in predicted(q) if (one := _delay(each, q.time)) is not None]
    clear = [one for one in every if one.clear]
    if len(clear) > 2 and len(clear) == len(every):
        shifts = [one.delay for one in clear]
        middle = float(np.median(shifts))
        if max(abs(shift - middle) for shift in shifts) < NAMED_DELAY / 2:
            return [str(clear[0]._replace(sensor="each sensor", delay=middle))]
    return [str(one) for one in clear]


class Predicted(NamedTuple):
    """The measurements of a sensor, and their prediction from the truth."""

    sensor: str
    measured: np.ndarray
    """(K, 3); NaN where missing."""
    expected: np.ndarray
    """(K, 3); NaN where unknown."""


def predicted(q: Quantities) -> list[Predicted]:
    """All sensors whose measurements the truth predicts; none without a truth."""
    if q.rotation is None:
        return []
    reach = max(1, round(0.5 * DIFFERENTIATION_TIME / float(np.median(np.diff(q.time)))))

    def new(name: str, values: np.ndarray) -> np.ndarray:
        """The values without the repetitions of a held velocity."""
        repeated = q.repeated.get(name)
        return values if repeated is None else np.where(repeated[:, None], np.nan, values)

    R, P = q.rotation, q.position
    attitude = quaternions(np.where(np.isfinite(R), R, np.nan))
    rate = _slope(attitude, q.time, reach, lambda a, b: log(product(inverse(a), b)))
    found = [Predicted("angular_velocity", new("angular_velocity", q.gyroscope), rate)]
    if q.velocity is not None and P is not None:
        moving = np.einsum("kji,kj->ki", R, _slope(P, q.time, reach))
        found.append(Predicted("velocity", new("velocity", q.velocity), moving))
    for vector in q.vectors:
        there = np.einsum("kij,kj->ki", R, vector.body)
        reference = vector.reference
        if reference is None:
            reference = np.nanmedian(there, axis=0)
        expected = np.einsum("kji,kj->ki", R, np.broadcast_to(reference, there.shape))
        found.append(Predicted(vector.name, vector.body, expected))
    if P is not None:
        for j, (y, place) in enumerate(zip(q.landmarks, q.places, strict=True)):
            expected = np.einsum("kji,kj->ki", R, place - P)
            found.append(Predicted(f"landmark {j}", y, expected))
    return found


def _delay(of: Predicted, time: np.ndarray) -> Delay | None:
    """The delay of measurements behind their prediction; None if it can't be estimated."""
    measured, expected = of.measured, of.expected
    step = float(np.median(np.diff(time)))
    widest = max(1, round(MAX_DELAY / step))
    at = np.flatnonzero(np.isfinite(measured).all(axis=1))
    at = at[(at >= widest) & (at < len(time) - widest)]
    near = np.abs(time[at + widest] - time[at - widest] - 2 * widest * step) < step
    shifts = np.arange(-widest, widest + 1)
    rows = at[near][:, None] - shifts
    there = np.asarray(np.isfinite(expected).all(axis=1))[rows].all(axis=1)
    rows = rows[there]
    if len(rows) < MIN_INTERVALS:
        return None
    seen = measured[at[near][there]]
    off = seen - expected[rows[:, widest]]
    size = np.linalg.norm(off - np.median(off, axis=0), axis=1)
    usual = size <= OUTLIER_MEDIANS * np.median(size)
    rows, seen = rows[usual], seen[usual]
    parts = np.linspace(0, len(rows), min(BLOCKS, len(rows)), endpoint=False).astype(int)
    by_part = np.empty((len(parts), len(shifts)))
    for k in range(len(shifts)):
        off = seen - expected[rows[:, k]]
        by_part[:, k] = np.add.reduceat(np.sum((off - off.mean(axis=0)) ** 2, axis=1), parts)
    squares = by_part.sum(axis=0)
    best = int(np.argmin(squares))
    if squares[widest] == 0:
        return None
    explained = 1 - squares[best] / squares[widest]
    rest = seen - expected[rows[:, best]]
    rest = rest - rest.mean(axis=0)
    correlation = float(np.sum(rest[1:] * rest[:-1]) / max(squares[best], 1e-300))
    chance = explained * 3 * len(rows)
    drawn = np.random.default_rng(0).multinomial(len(parts), [1 / len(parts)] * len(parts), DRAWS)
    away = np.abs(np.argmin(drawn @ by_part, axis=1) - best) * step
    astray = float(np.mean(away > NAMED_DELAY / 2))
    ends = best in (0, len(shifts) - 1)
    delay = float(shifts[best] * step)
    return Delay(of.sensor, delay, explained, chance, correlation, astray, ends)


def _slope(
    a: np.ndarray,
    time: np.ndarray,
    reach: int,
    change: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda a, b: b - a,
) -> np.ndarray:
    """Derivative (K, 3) of a (K, d) over `reach` samples on both sides; NaN at gaps and ends.

    `change` maps d numbers before and after to the change, 3 numbers.
    """
    found = np.full((len(a), 3), np.nan)
    if len(a) > 2 * reach:
        span = time[2 * reach :] - time[: -2 * reach]
        whole = span < 3 * np.median(span)
        inner = change(a[: -2 * reach], a[2 * reach :]) / span[:, None]
        found[reach:-reach] = np.where(whole[:, None], inner, np.nan)
    return found
