"""The noise of a recording's sensors, by the Allan variances of their errors against the truth.

The error of a velocity, summed up to E_k, has the Allan variance

    A(tau) = mean |E_k+2m - 2 E_k+m + E_k|^2 / (6 tau^2) = q^2 / tau + w^2 tau / 3 + 3 s^2 / tau^2,

tau = m dt, by component: q is the density of its noise, w the random walk of its bias, s the noise
of the truth, which would look like noise of the velocity in differences of neighbouring poses. They
are fitted to A over octaves of tau (IEEE Std 952; N. El-Sheimy, H. Hou, X. Niu, "Analysis and
modeling of inertial sensors using Allan variance", IEEE Transactions on Instrumentation and
Measurement 57(1), 2008). Medians of the squares keep outliers out.

Before that, the part of a velocity's error that is proportional to the change of the true velocity
is removed. Its factor is the lead (`filters.leads`): half a step for one measured at its time
stamp.

A vector's or a landmark's noise need not be white: accelerations, for instance, come and go. A
filter that takes it for white should assume what remains of it in means over times up to
LONGEST_AVERAGE: its noise is the largest sqrt(A(tau) tau / dt), with dt the time between
measurements.
"""

import math
from typing import NamedTuple

import numpy as np

from posegsa.recordings.held import held
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import inverse, log, product, quaternions

LONGEST_AVERAGE = 2.0
"""Longest time over which the noise of vectors and landmarks is averaged [s]."""
LONGEST_TAU_SHARE = 1 / 8
"""Longest tau, as a share of a recording; fewer intervals would not be enough."""
LEAD_HORIZON, LEAD_SMOOTHING = 0.5, 0.05
"""Time over which a lead is fitted, and over which the true velocity is averaged for it [s]."""
MIN_LEAD_BENEFIT = 0.1
"""What a lead must explain of the error over LEAD_HORIZON, as a share of what it leaves."""
MIN_LEAD = 0.05
"""A smaller lead is not worth its states in the filter, in time steps."""
MIN_WALK_RATIO = 4.0
"""A walk counts if its variance is this many times that of the white noise, at the longest tau."""
MIN_MEASUREMENTS = 40
"""Minimum number of measurements for estimating a noise."""
MIN_NOISE_SHARE = 0.5
"""Minimum noise of a velocity, as a share of the noise between its neighbouring samples."""
_NORMAL = 1.4826
"""Standard deviation of normal numbers over the median of their size."""


class VelocityNoise(NamedTuple):
    """The errors of a velocity, by comparison with the truth."""

    density: float
    """Density of white noise [unit sqrt(s)]."""
    walk: float
    """Random walk of the bias [unit / sqrt(s)]; 0 if none is clear."""
    lead: float
    """Delay in time steps (`filters.leads`)."""
    bias: np.ndarray
    """(3,) mean error."""


def velocity_noises(recording: Recording) -> dict[str, VelocityNoise]:
    """The errors of "angular_velocity" and "velocity", if there is a truth."""
    truth = recording.truth
    if truth is None:
        return {}
    time, m = recording.time, recording.measurements
    known = truth.known
    dt = np.diff(time)[:, None]
    usual = known[:-1] & known[1:] & (dt[:, 0] < 3 * np.median(dt))
    if usual.sum() < MIN_MEASUREMENTS:
        return {}
    R = np.where(known[:, None, None], truth.rotation, np.eye(3))
    q = quaternions(R)
    turns = log(product(inverse(q[:-1]), q[1:]))
    true = {"angular_velocity": turns / dt}
    if truth.position is not None and not recording.attitude_only:
        moved = np.diff(np.where(known[:, None], truth.position, 0.0), axis=0)
        body = 0.5 * np.einsum("nji,nj->ni", R[:-1] + R[1:], moved)  # of the middle attitude
        true["velocity"] = body / np.cos(0.5 * np.linalg.norm(turns, axis=1))[:, None] ** 2 / dt
    each = {}
    for name, rate in true.items():
        sensed = np.asarray(getattr(m, name), np.float64)[:-1]
        each[name] = _velocity_noise(np.where(usual[:, None], rate, sensed), sensed, dt, usual)
    return each


def _velocity_noise(
    true: np.ndarray, sensed: np.ndarray, dt: np.ndarray, usual: np.ndarray
) -> VelocityNoise:
    """The errors of a velocity (n, 3) whose true means over steps dt (n, 1) are known."""
    step = float(np.median(dt))
    holding = held(sensed)  # its noise is white only in means over whole measurements
    late = np.where(usual[:, None], true - sensed, 0.0) * dt
    bias = -np.sum(late, axis=0) / np.sum(dt[usual])
    late += np.where(usual[:, None], bias, 0.0) * dt
    change = _change(true, max(1, round(0.5 * LEAD_SMOOTHING / step))) * dt
    lead = _lead(
        np.cumsum(late, axis=0), np.cumsum(change, axis=0), max(1, round(LEAD_HORIZON / step))
    )
    tau, variance = allan_variance(np.cumsum(late - lead * change, axis=0), step)
    if holding.samples > 1:
        long = tau >= 2 * holding.samples * step
        tau, variance = tau[long], variance[long]
    root = math.sqrt(holding.samples * step)
    own = MIN_NOISE_SHARE * neighbours(sensed[holding.fresh]) * root
    if len(tau) < 4:
        off = (true - sensed)[holding.fresh]
        return VelocityNoise(max(own, neighbours(off) * root), 0.0, 0.0, bias)
    from scipy.optimize import nnls  # imported here because it loads slowly

    terms = np.stack([1 / tau, tau / 3, 3 / tau**2], axis=1)
    (white, walk, _), _ = nnls(terms / variance[:, None], np.ones(len(tau)))
    clear = walk * tau[-1] ** 2 / 3 > MIN_WALK_RATIO * white
    return VelocityNoise(max(own, math.sqrt(white)), math.sqrt(walk) if clear else 0.0, lead, bias)


def _change(true: np.ndarray, reach: int) -> np.ndarray:
    """Change (n, 3) of a smoothed velocity from one step to the next; 0 near the ends."""
    count, window = len(true), 2 * reach + 1
    if count <= 2 * window:
        return np.zeros_like(true)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(true, axis=0)])
    means = (sums[window:] - sums[:-window]) / window
    change = np.zeros_like(true)
    change[reach + 1 : count - reach - 1] = 0.5 * (means[2:] - means[:-2])
    return change


def _lead(late: np.ndarray, change: np.ndarray, span: int) -> float:
    """The share of summed changes (n, 3) in summed errors (n, 3), over intervals of `span` steps.

    It is 0 if it explains little, and a multiple of one half if the data agree with that.
    """
    y, x = late[span:] - late[:-span], change[span:] - change[:-span]
    if len(y) < MIN_MEASUREMENTS or not np.any(x):
        return 0.0
    y, x = y - np.median(y, axis=0), x - np.median(x, axis=0)
    size = float(np.sum(x * x))
    lead = float(np.sum(x * y)) / size
    least = MIN_LEAD_BENEFIT * math.sqrt(float(np.sum((y - lead * x) ** 2)) / size)
    half = 0.5 * round(2 * lead)
    lead = half if abs(lead - half) < least else lead
    return lead if lead > max(least, MIN_LEAD) else 0.0


def allan_variance(sums: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """The Allan variance of summed errors (n, 3) at octaves of tau: (t,) [s], (t,).

    Args:
        sums: Cumulative sums of errors times time steps.
        step: Time from one sum to the next [s].
    """
    taus, found, m = [], [], 1
    while m <= max(2, LONGEST_TAU_SHARE * len(sums)) and len(sums) - 2 * m >= MIN_MEASUREMENTS:
        second = sums[2 * m :] - 2 * sums[m:-m] + sums[: -2 * m]
        size = _NORMAL * float(np.median(np.abs(second)))
        if size > 0:
            taus.append(m * step)
            found.append(size * size / (2 * taus[-1] ** 2))
        m *= 2
    return np.array(taus), np.array(found)


def noise_of(errors: np.ndarray, period: float) -> float:
    """Standard deviation of each component of errors (n, 3), if they are to be taken for white.

    Args:
        errors: The errors of one sensor, in order of time.
        period: Time from one error to the next [s].
    """
    off = errors - np.median(errors, axis=0)
    tau, variance = allan_variance(np.cumsum(off, axis=0) * period, period)
    short = tau <= max(LONGEST_AVERAGE, period)
    if not short.any():
        return neighbours(errors)
    return math.sqrt(float(np.max((tau * variance)[short])) / period)


def neighbours(values: np.ndarray) -> float:
    """Standard deviation of white noise in values (n, 3), by their second differences."""
    if len(values) < 3:
        return math.nan
    second = values[2:] - 2 * values[1:-1] + values[:-2]
    spread = np.median(np.abs(second - np.median(second, axis=0)))
    return float(_NORMAL * spread / math.sqrt(6))
