"""How good a filter is on each of many scenarios: cost, settling, steady state, bias."""

from typing import NamedTuple

import jax
import numpy as np

from posegsa.filter import FilterState
from posegsa.gain import GainSchedule
from posegsa.population import Problem
from posegsa.rollout import ErrorTrack, Track, simulate_errors

SETTLED_ATTITUDE = 20.0
"""Attitude error under which the filter has settled if it stays there [deg]; the paper's noise
alone makes errors of 8 deg RMS."""
SETTLED_POSITION = 0.5
"""Position error under which the filter has settled if it stays there [m]."""
DIVERGED_ATTITUDE = 90.0
"""Mean attitude error over the last second above which a run counts as diverged [deg]."""
DIVERGED_POSITION = 5.0
"""Mean position error over the last second above which a run counts as diverged [m]."""
BATCH = 250
"""Scenarios simulated at once, to bound the memory of their error tracks."""


class Metrics(NamedTuple):
    """Each (S,), one entry for each scenario."""

    cost: np.ndarray
    """C; infinite where it is not finite."""
    transient: np.ndarray
    """Its weighted transient part."""
    steady: np.ndarray
    """Its weighted steady-state part."""
    settling_attitude: np.ndarray
    """Time after which the attitude error stays under SETTLED_ATTITUDE [s]; infinite if never."""
    settling_position: np.ndarray
    """Time after which the position error stays under SETTLED_POSITION [s]; infinite if never."""
    rms_attitude: np.ndarray
    """Root mean square attitude error in the steady-state window [deg]."""
    rms_position: np.ndarray
    """Root mean square position error in the steady-state window [m]."""
    bias_angular: np.ndarray
    """Length of the last angular velocity bias error [rad/s]."""
    bias_linear: np.ndarray
    """Length of the last linear velocity bias error [m/s]."""
    diverged: np.ndarray
    """Whether the cost is not finite, or the last second's mean errors exceed DIVERGED_..."""
    initial_angle: np.ndarray
    """Attitude error at the start [deg]."""


class Bands(NamedTuple):
    """Quantiles over scenarios of the errors over time, each (3, N): 5 %, median, 95 %."""

    attitude: np.ndarray
    """[deg]"""
    position: np.ndarray
    """[m]"""
    gain: np.ndarray
    """[1/s]"""


QUANTILES = (0.05, 0.5, 0.95)


class Tracks(NamedTuple):
    """What a filter did over N samples on each of S scenarios, on the host."""

    attitude: np.ndarray
    """(S, N) ||R_err||_I in [0, 1]."""
    position: np.ndarray
    """(S, N) ||P_err|| [m]."""
    gain: np.ndarray
    """(S, N) the gain that was used, after the limit [1/s]."""
    bias: np.ndarray
    """(S, 6) the last bias estimate [rad/s, m/s]."""

    def part(self, scenarios: slice) -> "Tracks":
        """The same of some of the scenarios."""
        return Tracks(*(field[scenarios] for field in self))


@jax.jit
def _errors(schedule: GainSchedule, problem: Problem) -> ErrorTrack:
    def one(tracks: Track, initial: FilterState) -> ErrorTrack:
        return simulate_errors(schedule, tracks, initial, problem.settings, problem.signal)

    return jax.vmap(one)(problem.tracks, problem.initial)


def run(schedule: GainSchedule, problem: Problem) -> Tracks:
    """Run a schedule on all of a problem's scenarios."""
    count = problem.bias.shape[0]
    if count <= BATCH:
        return Tracks(*(np.asarray(field) for field in _errors(schedule, problem)))
    batches = []
    for first in range(0, count, BATCH):
        # The last batch wraps round, so that all have one shape and are compiled once.
        index = np.arange(first, first + BATCH) % count
        batches.append(Tracks(*map(np.asarray, _errors(schedule, take(problem, index)))))
    return Tracks(*(np.concatenate(field)[:count] for field in zip(*batches, strict=True)))


def take(problem: Problem, index: np.ndarray | slice) -> Problem:
    """Some of a problem's scenarios."""
    scenarios = (problem.tracks, problem.initial, problem.bias)
    tracks, initial, bias = jax.tree.map(lambda a: a[index], scenarios)
    return problem._replace(tracks=tracks, initial=initial, bias=bias)


@np.errstate(invalid="ignore", over="ignore")  # runs that diverge are told as such
def metrics_of(tracks: Tracks, problem: Problem) -> tuple[Metrics, Bands]:
    """Metrics on each of a problem's scenarios, and the bands of its errors over time."""
    time = np.asarray(problem.tracks.time[0], np.float64)
    squared_sine = np.clip(tracks.attitude.astype(np.float64), 0, 1)  # NaN stays
    angle = np.degrees(2 * np.arcsin(np.sqrt(squared_sine)))
    position = tracks.position.astype(np.float64)
    error = tracks.attitude + float(problem.weights.position) * position
    transient, steady = (
        np.sum(np.asarray(weight, np.float64) * error, axis=1)
        for weight in (problem.weights.transient, problem.weights.steady)
    )
    total = transient + steady
    finite = np.isfinite(total)
    window = np.asarray(problem.weights.window)
    bias_error = tracks.bias.astype(np.float64) - np.asarray(problem.bias, np.float64)
    last = time > time[-1] - 1
    lost = (np.mean(angle[:, last], axis=1) > DIVERGED_ATTITUDE) | (
        np.mean(position[:, last], axis=1) > DIVERGED_POSITION
    )
    metrics = Metrics(
        cost=np.where(finite, total, np.inf),
        transient=transient,
        steady=steady,
        settling_attitude=_settling(time, angle, SETTLED_ATTITUDE),
        settling_position=_settling(time, position, SETTLED_POSITION),
        rms_attitude=np.sqrt(np.mean(angle[:, window] ** 2, axis=1)),
        rms_position=np.sqrt(np.mean(position[:, window] ** 2, axis=1)),
        bias_angular=np.linalg.norm(bias_error[:, :3], axis=1),
        bias_linear=np.linalg.norm(bias_error[:, 3:], axis=1),
        diverged=lost | ~finite,
        initial_angle=angle[:, 0],
    )

    def band(values: np.ndarray) -> np.ndarray:
        if not finite.any():
            return np.full((len(QUANTILES), len(time)), np.nan)
        return np.quantile(values[finite].astype(np.float64), QUANTILES, axis=0)

    return metrics, Bands(band(angle), band(position), band(tracks.gain))


def _settling(time: np.ndarray, error: np.ndarray, threshold: float) -> np.ndarray:
    """First time (S,) from which on the errors (S, N) stay under a threshold; infinite if never."""
    outside = ~(error < threshold)  # NaN is outside
    last = error.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
    never, always = outside[:, -1], ~outside.any(axis=1)
    after = time[np.minimum(last + 1, len(time) - 1)]
    return np.where(never, np.inf, np.where(always, time[0], after))
