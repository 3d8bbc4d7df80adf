"""Metrics of a filter on each of many scenarios: cost, settling, steady state, bias."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from posegsa.filters.base import Filter, Sensors, sensors_in
from posegsa.filters.calls import started
from posegsa.filters.rollout import ErrorTrack, Estimates, simulate_errors_together
from posegsa.model.estimate import FilterState
from posegsa.search.candidates import Candidate
from posegsa.search.groups import LENGTH, SCENARIOS, group_size, in_groups, padded
from posegsa.search.population import ScenarioBatch, TrackCost
from posegsa.settings.arrays import Numbers

SETTLED_ATTITUDE, SETTLED_POSITION = 20.0, 0.5
"""Errors [deg], [m] below which the filter counts as settled if it stays there. The paper's noise
alone causes errors of 8 deg RMS."""
DIVERGED_ATTITUDE, DIVERGED_POSITION = 90.0, 5.0
"""Mean errors [deg], [m] over the last second above which a run counts as diverged."""
POSITION_WORDS = (
    "P_err is the cost's position error, |P_est - R_err P|; distance is |P_est - P|, how far the "
    "estimate is from the body."
)
"""Explains the two position errors below a table that shows both."""
CONSISTENT_NEES = 12.591587243743977
"""The NEES of a pose that a consistent filter does not exceed at 95 % of the samples: the quantile
of chi-squared with 6 degrees of freedom."""
QUANTILES = (0.05, 0.5, 0.95)
"""Quantiles over scenarios in the error bands."""

CostPerScenario = Annotated[np.ndarray, Numbers("scenarios", allow="infinite")]
PerScenario = Annotated[np.ndarray, Numbers("scenarios", allow="any")]
Band = Annotated[np.ndarray, Numbers(len(QUANTILES), "times", allow="any")]


class Metrics(NamedTuple):
    """Metrics by scenario, each (S,); not finite where the run diverged."""

    cost: CostPerScenario
    """The cost C; infinite where it is not finite."""
    transient: PerScenario
    """Its weighted transient part."""
    steady: PerScenario
    """Its weighted steady-state part."""
    settling_attitude: PerScenario
    """Time after which the attitude error stays under SETTLED_ATTITUDE [s]; infinite if never."""
    settling_position: PerScenario
    """Time after which the cost's position error stays under SETTLED_POSITION [s]; likewise."""
    rms_attitude: PerScenario
    """Root mean square attitude error in the steady-state window [deg]."""
    rms_position: PerScenario
    """Root mean square of the cost's position error, |P_est - R_err P|, in that window [m]."""
    rms_distance: PerScenario
    """Root mean square distance |P_est - P| in that window [m]."""
    bias_angular: PerScenario
    """Length of the last angular velocity bias error [rad/s]."""
    bias_linear: PerScenario
    """Length of the last linear velocity bias error [m/s]."""
    diverged: Annotated[np.ndarray, Numbers("scenarios", dtype=bool)]
    """True if the cost is not finite, or mean errors over the last second exceed DIVERGED_..."""
    initial_angle: PerScenario
    """Attitude error at the start [deg]."""
    waited: PerScenario
    """Time before the start [s], until the sensors had fixed a pose; 0 from a given one."""
    nees: PerScenario
    """Mean normalised estimation error squared of the pose in the steady-state window, no unit: 6
    if the filter's covariance is right, more if it is too small. NaN for a filter without one."""
    nees_inside: PerScenario
    """Share of that window in which it is up to CONSISTENT_NEES: 0.95 if the covariance is
    right."""
    nis: PerScenario
    """Mean normalised innovation squared over its degrees of freedom in that window, no unit: 1 if
    the filter's covariance and its sensors' noise are right."""


class Bands(NamedTuple):
    """Quantiles over scenarios of errors [deg], [m] and gain [1/s] over time, each (3, N)."""

    attitude: Band
    position: Band
    gain: Band


def error_tracks(
    candidate: Candidate, batch: ScenarioBatch, *, optimised: bool = True
) -> ErrorTrack:
    """A candidate's errors on all S scenarios of a batch; on the host, leaves (S, ...).

    On a CPU a program that is not `optimised` takes half as long to compile, and twice as long to
    run; elsewhere the argument changes nothing.
    """
    count, samples = batch.samples.time.shape
    plain = not optimised and jax.default_backend() == "cpu"
    run = _in_parts(candidate, batch, _tracks_unoptimised if plain else _tracks)

    def some(index: np.ndarray) -> ErrorTrack:
        each = [jax.device_get(track).until(given) for given, track, _ in run(index)]
        return ErrorTrack.joined(each)

    # Groups keep their full size for long scenarios too, as only errors are held over the length.
    return in_groups(some, count, padded(samples) // SCENARIOS)


def estimates_on(candidate: Candidate, batch: ScenarioBatch, scenario: int) -> Estimates:
    """A candidate's estimates on one scenario of a batch, by the program of `error_tracks`."""
    samples = batch.samples.time.shape[1]
    size = group_size(padded(samples) // SCENARIOS)
    each = [
        jax.tree.map(lambda a, n=given: a[:n], jax.device_get(estimates))
        for given, _, estimates in _in_parts(candidate, batch, _tracks)(np.full(size, scenario))
    ]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *each)


def _in_parts(
    candidate: Candidate, batch: ScenarioBatch, tracks: Any
) -> Callable[[np.ndarray], Iterator[tuple[int, ErrorTrack, Estimates]]]:
    """Run a candidate on scenarios by number, LENGTH samples at a time.

    So scenarios of any duration share one program. Of each part: how many of its samples are the
    scenarios' own, the errors, and the estimates on the first scenario.
    """
    # All on the host: JAX compiles a program again for arrays on another device.
    batch = jax.tree.map(np.asarray, batch)
    # Applied here: filters of one kind share a program, whichever numbers were tuned.
    filter = jax.tree.map(np.asarray, candidate.applied(batch.filter))
    sensors = sensors_in(batch.samples)

    def parts(index: np.ndarray) -> Iterator[tuple[int, ErrorTrack, Estimates]]:
        chosen = batch.select(index)
        state = _started(filter, chosen.initial, sensors)
        for first in range(0, chosen.samples.time.shape[1], LENGTH):
            part = jax.tree.map(lambda a, i=first: a[:, i : i + LENGTH], chosen.samples)
            lacking = LENGTH - part.time.shape[1]
            part = jax.tree.map(lambda a, n=lacking: np.pad(a, [(0, 0), (0, n)], mode="edge"), part)
            state, track, estimates = tracks(filter, part, state, np.int32(LENGTH - lacking))
            yield LENGTH - lacking, track, estimates

    return parts


@partial(jax.jit, static_argnames="sensors")
def _started(filter: Filter, initial: FilterState, sensors: Sensors) -> Any:
    """States (S, ...) before the first sample."""
    return jax.vmap(lambda one: started(filter, one, sensors))(initial)


_tracks = jax.jit(simulate_errors_together)
_tracks_unoptimised = jax.jit(
    simulate_errors_together, compiler_options={"xla_backend_optimization_level": 0}
)


@np.errstate(invalid="ignore", over="ignore")
def cost_parts(tracks: ErrorTrack, batch: ScenarioBatch) -> tuple[np.ndarray, np.ndarray]:
    """The transient and the steady-state part (S,) of the configured cost."""
    attitude, position = (np.asarray(a, np.float64) for a in (tracks.attitude, tracks.position))
    error = np.where(_counted(batch)[1], attitude + float(batch.weights.position) * position, 0)
    transient, steady = (
        np.sum(np.asarray(weight, np.float64) * error, axis=1)
        for weight in (batch.weights.transient, batch.weights.steady)
    )
    return transient, steady


def _counted(batch: ScenarioBatch) -> tuple[np.ndarray | float, np.ndarray]:
    """The end (S, 1) of each scenario [s], and which samples (S, N) count."""
    time = np.asarray(batch.samples.time[0], np.float64)
    begin = 0.0 if batch.begin is None else np.asarray(batch.begin, np.float64)[:, None]
    end = np.inf if batch.end is None else np.asarray(batch.end, np.float64)[:, None]
    count = len(batch.samples.time)
    return end, np.broadcast_to((time >= begin) & (time < end), (count, len(time)))


@np.errstate(invalid="ignore", over="ignore")  # runs may diverge; `diverged` says so
def metrics_of(
    tracks: ErrorTrack, batch: ScenarioBatch, cost: TrackCost | None = None
) -> tuple[Metrics, Bands]:
    """Metrics on each scenario of a batch, and bands of the errors over time.

    `cost` is a user's own cost. It replaces the total; the transient and steady-state parts stay
    those of the configured cost.
    """
    time = np.asarray(batch.samples.time[0], np.float64)
    attitude, position, gain, distance, bias = (
        np.asarray(leaf, np.float64) for leaf in tracks[: ErrorTrack._fields.index("vector_bias")]
    )
    nees, nis = (
        np.full_like(attitude, np.nan) if leaf is None else np.asarray(leaf, np.float64)
        for leaf in (tracks.nees, tracks.nis)
    )
    angle = np.degrees(2 * np.arcsin(np.sqrt(attitude)))
    begin = np.zeros(len(angle)) if batch.begin is None else np.asarray(batch.begin, np.float64)
    end, counts = _counted(batch)
    transient, steady = cost_parts(tracks, batch)
    total = transient + steady
    if cost is not None:
        given = jax.tree.map(jnp.asarray, (tracks, batch.samples.time, batch.begin))
        own = jax.vmap(lambda track, t, begin: cost(track.waiting(t, begin), t))(*given)
        total = np.asarray(own, np.float64)
    finite = np.isfinite(total)
    window = np.asarray(batch.weights.window) & counts
    bias_error = bias - np.asarray(batch.bias, np.float64)
    last = counts & (time > np.minimum(end - time[1] + time[0], time[-1]) - 1)
    lost = (_mean(angle, last) > DIVERGED_ATTITUDE) | (_mean(position, last) > DIVERGED_POSITION)
    metrics = Metrics(
        cost=np.where(finite, total, np.inf),
        transient=transient,
        steady=steady,
        settling_attitude=_settling(time, angle, SETTLED_ATTITUDE, counts),
        settling_position=_settling(time, position, SETTLED_POSITION, counts),
        rms_attitude=np.sqrt(_mean(angle**2, window)),
        rms_position=np.sqrt(_mean(position**2, window)),
        rms_distance=np.sqrt(_mean(distance**2, window)),
        bias_angular=np.linalg.norm(bias_error[:, :3], axis=1),
        bias_linear=np.linalg.norm(bias_error[:, 3:], axis=1),
        diverged=lost | ~finite,
        initial_angle=angle[:, 0] if batch.begin is None else _at(angle, time, begin),
        waited=begin,
        nees=_mean(nees, window),
        nees_inside=np.where(np.isnan(nees).all(), np.nan, _mean(nees <= CONSISTENT_NEES, window)),
        nis=_mean(nis, window & (np.isfinite(nis) | ~np.isfinite(attitude))),
    )

    def band(values: np.ndarray) -> np.ndarray:
        if not finite.any():
            return np.full((len(QUANTILES), len(time)), np.nan)
        return np.quantile(values[finite], QUANTILES, axis=0)

    return metrics, Bands(attitude=band(angle), position=band(position), gain=band(gain))


def _at(values: np.ndarray, time: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Values (S, N) at times (S,) [s]."""
    index = np.minimum(np.searchsorted(time, begin), len(time) - 1)
    return values[np.arange(len(values)), index]


def _mean(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Means (S,) of values (S, N) over a mask (S, N); NaN if the mask is empty."""
    return np.sum(values, axis=1, where=where) / np.sum(where, axis=1)


def _settling(
    time: np.ndarray, error: np.ndarray, threshold: float, counts: np.ndarray
) -> np.ndarray:
    """First time (S,) after which errors (S, N) stay below a threshold; infinite if never."""
    outside = ~(error < threshold) & counts  # NaN is outside
    after_last = len(time) - np.argmax(outside[:, ::-1], axis=1)
    return np.append(time, np.inf)[np.where(outside.any(axis=1), after_last, 0)]
