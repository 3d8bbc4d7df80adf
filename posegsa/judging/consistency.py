"""Whether a Kalman filter's covariance is right: NEES of its pose over drawn scenarios."""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.arguments import refuse
from posegsa.filters.base import Filter, Samples, sensors_in
from posegsa.filters.kalman import KalmanFilter, nees
from posegsa.filters.rollout import run
from posegsa.model.estimate import FilterState
from posegsa.model.signal import known_pose
from posegsa.search.candidates import Candidate
from posegsa.search.groups import in_groups
from posegsa.search.population import ScenarioBatch

TIMES = (10.0, 30.0, 60.0)
"""Times at which the covariance is judged [s]."""
DEGREES_OF_FREEDOM = 6
"""Of a pose."""
SHARE = 0.95
"""Share of a consistent filter's NEES that is up to the bound."""


class Consistency(NamedTuple):
    """NEES of the pose of a filter, which is chi-squared with 6 degrees of freedom if it is right.

    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
    Navigation", 2001, section 5.4.
    """

    time: np.ndarray
    """(t,) [s]."""
    nees: np.ndarray
    """(S, t) in each scenario; infinite where the filter diverged, NaN where it had not started or
    the scenario was over."""

    @property
    def mean(self) -> np.ndarray:
        """(t,) mean over scenarios: 6 if the covariance is right, more if it is too small.

        NaN where no scenario counts.
        """
        return _means(self.nees, ~np.isnan(self.nees))

    @property
    def inside(self) -> np.ndarray:
        """(t,) share of the scenarios within the 95 % bound, 0.95 if the covariance is right."""
        return _means(self.nees <= bound(), ~np.isnan(self.nees))


def bound() -> float:
    """The NEES that 95 % of a consistent filter's do not exceed, 12.6."""
    from scipy.special import chdtri  # imported here: it takes a moment to load

    return float(chdtri(DEGREES_OF_FREEDOM, 1 - SHARE))


def consistency(
    candidate: Candidate, batch: ScenarioBatch, times: Sequence[float] = TIMES
) -> Consistency:
    """NEES of a Kalman filter's pose on all S scenarios of a batch (on the host).

    Args:
        candidate: a Kalman filter's numbers that replace those of the batch.
        batch: drawn scenarios, with the truth.
        times: times [s], ascending; those after the end of the scenarios are left out. At the end
            itself it is the estimate of the last sample, one before it.

    Raises:
        ArgumentError: The filter is not a Kalman filter, or the times do not ascend from 0.
    """
    if not isinstance(batch.filter, KalmanFilter):
        refuse(f"filter: {type(batch.filter).__name__}", "a KalmanFilter, which has a covariance")
    if not times or not times[0] >= 0 or not all(a < b for a, b in pairwise(times)):
        refuse(f"times: {list(times)}", "at least one, ascending, from 0 on")
    count, samples = batch.samples.time.shape
    step = float(batch.samples.time[0, 1] - batch.samples.time[0, 0])
    at = np.array([t for t in times if round(t / step) <= samples])
    index = tuple(min(round(t / step), samples - 1) for t in at)
    if not index:
        return Consistency(at, np.zeros((count, 0)))
    # All on the host: JAX compiles a program again for arrays on another device.
    candidate, batch = jax.tree.map(np.asarray, (candidate, batch))

    def some(which: np.ndarray) -> Array:
        chosen = batch.select(which)
        return _nees(candidate, batch.filter, chosen.samples, chosen.initial, index)

    found = np.asarray(in_groups(some, count, samples), np.float64)
    found = np.where(np.isfinite(found), found, np.inf)
    begin = 0.0 if batch.begin is None else np.asarray(batch.begin, np.float64)[:, None]
    end = np.inf if batch.end is None else np.asarray(batch.end, np.float64)[:, None]
    counts = (at >= begin) & (at < end)
    return Consistency(at, np.where(counts, found, np.nan))


def _means(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Means (t,) of values (S, t) over those that count; NaN where none does."""
    number = np.sum(counts, axis=0)
    total = np.sum(values, axis=0, where=counts)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


@partial(jax.jit, static_argnames="index")
def _nees(
    candidate: Candidate,
    shared: Filter,
    samples: Samples,
    initial: FilterState,
    index: tuple[int, ...],
) -> Array:
    """NEES (S, t) before the samples with these indices, of leaves (S, ...)."""
    filter = candidate.applied(shared)

    def nothing(total: tuple[()], *_: Any) -> tuple[tuple[()], None]:
        return total, None

    def one(samples: Samples, initial: FilterState) -> Array:
        state, found = filter.start(initial, sensors_in(samples)), []
        for begin, end in pairwise((0, *index)):
            if end > begin:
                part = jax.tree.map(lambda a, begin=begin, end=end: a[begin:end], samples)
                state, _, _ = run(nothing, filter, part, state)
            truth = jax.tree.map(lambda a, end=end: a[end], known_pose(samples.truth))
            found.append(nees(state, truth))
        return jnp.stack(found)

    return jax.vmap(one)(samples, initial)
