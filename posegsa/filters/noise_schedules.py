"""Schedules that change a Kalman filter's noises while it runs, and so its belief in sensors.

In two roles, each of which can be absent:

- *unknown*: one schedule for the whole filter. It sees the filter's measured error, the root mean
  square of this sample's residuals in standard deviations of their sensors' noise, and multiplies
  the densities of the velocities' noise and of the random walk of the vectors' biases. So the
  covariance grows where the estimate is worse than the covariance says: after a wrong start, or
  when the body has been moved.
- *belief*: one schedule for all vectors and one for all landmarks. For each sensor it sees that
  sensor's normalised squared residual, |z - y|^2 over its expectation, and multiplies the variance
  of that sensor's noise. So a sensor that disagrees with the rest is not believed while it does.

Both inputs are logarithms, because both outputs are:

    e      = ln(q) / ln(scale), clipped to [0, 1], q the low-passed input
    rate   = rate_scale |de/dt|, clipped to [0, 1]
    factor = largest^((K - 1) / 100), at least 1, K the output of the schedule

K = 1 + centroid, as in the paper: its controller of five terms, 25 rules and k1 to k22 (Eqs. 18 and
19) stands here unchanged, and so does any other schedule of `model.schedules`. K = 1 changes
nothing, K = 101 multiplies by `largest`, of belief less what all sensors share (`filters.belief`).
"""

from collections.abc import Mapping
from typing import NamedTuple, Self

import jax.numpy as jnp
from jax import Array

from posegsa.arguments import refuse
from posegsa.model.elementwise import choose, maximum, minimum
from posegsa.model.schedules import GainSchedule, PreparedSchedule, ScheduleInputs
from posegsa.model.se3 import Vec3


class NoiseSignal(NamedTuple):
    """How an input of a schedule is made, and how far its output reaches; all traced."""

    smoothing: Array
    """Time constant of the low-pass filter of the input [s]; 0 means none."""
    scale: Array
    """The input at which the scaled error is 1, above 1, no unit."""
    rate_scale: Array
    """Factor on the change of the scaled error [s]."""
    largest: Array
    """The largest factor, at least 1, no unit."""

    def with_value(self, key: str, value: Array) -> Self:
        """The same with one number replaced, by its name after its role: "belief_smoothing".

        Raises:
            ArgumentError: There is no number with this name.
        """
        role, _, name = key.partition("_")
        if name not in self._fields:
            allowed = ", ".join(f"{role}_{field}" for field in self._fields)
            refuse(f"{key}: not a number of this filter", allowed)
        return self._replace(**{name: value})


class ResidualMean(NamedTuple):
    """The low-passed residual of a sensor."""

    value: Vec3
    """In the sensor's unit."""
    share: Array
    """The variance of its white noise, as a share of that of one residual."""


class NoiseMemory(NamedTuple):
    """What a schedule remembers of one input, from sample to sample."""

    value: Array
    """The low-passed input; ignored before the first input."""
    error: Array
    """The last scaled error before it was clipped."""
    gain: Array
    """The last output of the schedule."""
    age: Array
    """Time since the last input [s]; infinite before the first one."""
    mean: ResidualMean | tuple[()] = ()
    """For the belief input "mean", else ()."""


class NoiseSignals(NamedTuple):
    """The signals of both roles."""

    unknown: NoiseSignal
    belief: NoiseSignal
    """One signal for all vectors and landmarks."""

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same with some numbers replaced, by names such as "belief_smoothing"."""
        signals = self._asdict()
        for key, value in values.items():
            role = key.partition("_")[0]
            signals[role] = signals[role].with_value(key, value)
        return type(self)(**signals)


SIGNAL_KEYS = tuple(f"{r}_{n}" for r in NoiseSignals._fields for n in NoiseSignal._fields)
"""The names of the numbers of `NoiseSignals`."""


class NoiseGains(NamedTuple):
    """The schedules by role; None for a role that the filter does not have."""

    unknown: GainSchedule | None = None
    """On the velocities' noise and the walk of the vectors' biases: their standard deviations."""
    vectors: GainSchedule | None = None
    """Belief in each vector: its variance."""
    landmarks: GainSchedule | None = None
    """Belief in each landmark: its variance."""


NO_NOISE_GAINS = NoiseGains()


def initial_noise_memory(schedule: GainSchedule, like: Array) -> NoiseMemory:
    """The memory before the first sample, in the shape and dtype of `like`."""
    zero = jnp.zeros_like(like)
    gain = jnp.full_like(like, schedule.initial_gain())
    return NoiseMemory(zero, zero, gain, zero + jnp.inf)


def noise_factor(
    schedule: PreparedSchedule,
    signal: NoiseSignal,
    memory: NoiseMemory,
    now: Array,
    seen: Array,
    time: Array,
    time_step: Array,
) -> tuple[Array, NoiseMemory, ScheduleInputs]:
    """The factor on a noise at a sample, the memory after it, and the inputs of the schedule.

    Args:
        schedule: The schedule of this role.
        signal: The signal of this role.
        memory: The memory after the last sample.
        now: The input at this sample; if its low-passed value is below 0 it counts as 0.
        seen: Whether there is an input; without one only the age of the memory changes.
        time: Since the first sample [s].
        time_step: To the next sample [s].
    """
    first = jnp.isinf(memory.age)
    before = choose(first, now, memory.value)
    old = signal.smoothing / (signal.smoothing + memory.age)
    value = choose(seen, now + old * (before - now), memory.value)
    smallest = float(jnp.finfo(value.dtype).tiny)
    error = jnp.log(maximum(value, smallest)) / jnp.log(signal.scale)
    change = jnp.abs(error - choose(first, error, memory.error)) / memory.age
    inputs = ScheduleInputs(
        error=minimum(maximum(error, 0.0), 1.0),
        rate=minimum(change * signal.rate_scale, 1.0),
        time=time,
        last=memory.gain,
    )
    gain = schedule(inputs).gain
    factor = jnp.exp(maximum(0.01 * (gain - 1), 0.0) * jnp.log(signal.largest))
    after = memory._replace(
        value=value,
        error=choose(seen, error, memory.error),
        gain=choose(seen, gain, memory.gain),
        age=choose(seen, time_step, memory.age + time_step),
    )
    return factor, after, inputs
