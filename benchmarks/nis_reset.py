"""A Kalman filter that is reset when a test of its innovations fails, as a filter of a user's own.

The usual remedy where a body is moved, without any schedule. If the normalised innovation squared
of a sample, or its low-passed sum, is much larger than the covariance says, the covariance of the
pose is widened (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking
and Navigation, 2001, section 5.4).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.filters.base import Record, Samples, Sensors
from posegsa.filters.kalman import KalmanFilter, KalmanNoise, KalmanState, update
from posegsa.filters.noise_levels import NoiseLevels, at_levels
from posegsa.filters.uncertainty import PoseCovariance
from posegsa.model.elementwise import choose, maximum
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample

RESET_ALSO = [
    {"key": f"filter.{name}", "lower": lower, "upper": upper, "scale": "logarithmic"}
    for name, lower, upper in (
        ("single", 2.0, 100.0),
        ("several", 2.0, 100.0),
        ("smoothing", 0.02, 3.0),
        ("attitude", 0.1, 3.0),
        ("position", 0.1, 10.0),
    )
]
"""The numbers of the test, as they are searched."""
RESET = {"single": 10.0, "several": 8.0, "smoothing": 0.3, "attitude": 0.5, "position": 1.0}
"""The same before a search."""


class ResetState(NamedTuple):
    """The state of the Kalman filter, and what the test remembers."""

    kalman: KalmanState
    nis: Array
    """Sum of the normalised innovations squared, with a fading memory."""
    scalars: Array
    """Sum of their degrees of freedom, with the same."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NisReset:
    """A Kalman filter whose covariance is widened when the test fails."""

    kalman: KalmanFilter
    single: Array
    """Largest NIS of one sample that passes, in its standard deviations above its expectation."""
    several: Array
    """The same of the sum."""
    smoothing: Array
    """Memory of the sum [s]."""
    attitude: Array
    """Its square is added to the variance of the attitude about each axis [rad]."""
    position: Array
    """Its square is added to the variance of the position along each axis [m]."""
    elementwise: ClassVar[bool] = True

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with other numbers."""
        own = {name: value for name, value in values.items() if name in RESET}
        of_kalman = {name: value for name, value in values.items() if name not in RESET}
        return replace(self, kalman=self.kalman.with_values(of_kalman), **own)

    def prepare(self, measurements: Measurements) -> Sample:
        """As the Kalman filter."""
        return self.kalman.prepare(measurements)

    def start(self, initial: FilterState, sensors: Sensors) -> ResetState:
        """As the Kalman filter, with nothing remembered."""
        zero = jnp.zeros_like(initial.place[0])
        return ResetState(self.kalman.start(initial, sensors), zero, zero)

    def ready(self) -> Self:
        """Nothing to compute before the loop."""
        return self

    def step(self, state: ResetState, now: Samples) -> tuple[ResetState, Record]:
        """The test at the estimate before the sample, and a step of the Kalman filter."""
        sample, levels = now.sample, state.kalman.levels
        if isinstance(levels, NoiseLevels):
            sample = at_levels(sample, levels)
        found = update(state.kalman, sample, self.kalman.noise)[1]
        fading = jnp.exp(-sample.time_step / self.smoothing)
        nis, scalars = fading * state.nis + found.nis, fading * state.scalars + found.scalars
        # A chi-squared number with m degrees of freedom has the variance 2 m. The faded sum of many
        # has about half of 2 times the faded sum of m; more, up to twice, in the first samples.
        single = (found.nis - found.scalars) / jnp.sqrt(2 * maximum(found.scalars, 1.0))
        several = (nis - scalars) / jnp.sqrt(maximum(scalars, 1.0))
        moved = (single > self.single) | (several > self.several)
        rows = [list(row) for row in state.kalman.covariance]
        for i, deviation in enumerate((self.attitude,) * 3 + (self.position,) * 3):
            rows[i][0] = rows[i][0] + choose(moved, deviation * deviation, 0.0)
        wider = state.kalman._replace(covariance=tuple(map(tuple, rows)))
        kalman, record = self.kalman.step(wider, now)
        return ResetState(kalman, *(choose(moved, 0.0, one) for one in (nis, scalars))), record

    def estimate(self, state: ResetState) -> FilterState:
        """As the Kalman filter."""
        return self.kalman.estimate(state.kalman)

    def pose_covariance(self, state: ResetState) -> PoseCovariance:
        """As the Kalman filter."""
        return self.kalman.pose_covariance(state.kalman)


def nis_reset(**numbers: Array) -> NisReset:
    """The filter of the numbers of [filter]: those of `RESET`, and those of the Kalman filter."""
    noise = KalmanNoise(**{name: numbers[name] for name in KalmanNoise._fields})
    adaptation = numbers.get("noise_adaptation")
    kalman = KalmanFilter(noise, iterations=10, noise_adaptation=adaptation)
    return NisReset(kalman, **{name: numbers[name] for name in RESET})
