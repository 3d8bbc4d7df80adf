"""The search spaces of gain schedules with a few numbers, none of which needs a repair."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa import config
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.filters.observer import ObserverGains
from posegsa.model.schedules import (
    ConstantGain,
    GainSchedule,
    KnotGain,
    RampGain,
    SmoothGain,
    SwitchGain,
)
from posegsa.search.candidates import ScheduleSpace, SimpleSpace

GAINS = (0.5, 200.0)
"""Range of a baseline's gain [1/s]; it is extended to the controller's maximum."""
LOWEST_GAIN = 1e-3
"""Lowest gain that is searched [1/s]: of a baseline if the controller's range starts at 0, and on
recordings, whose sensors' rates vary."""
KNOTS = 16
"""Number of knots of the open-loop gains."""


def _constant(vector: Array) -> GainSchedule:
    return ConstantGain(jnp.exp(vector[0]))


def _switch(vector: Array) -> GainSchedule:
    before, after, time = jnp.exp(vector[:3])
    return SwitchGain(before, after, time, learning_time=vector[3])


def _smooth(vector: Array) -> GainSchedule:
    low, high, half = jnp.exp(vector)
    return SmoothGain(low, high, half)


def _open_loop(end: float, log_gain: Array) -> GainSchedule:
    return KnotGain(jnp.asarray(knot_times(end), log_gain.dtype), log_gain)


@cache
def _at(end: float) -> Callable[[Array], GainSchedule]:
    """`_open_loop` up to a time; always the same function, so that JAX reuses its program."""
    return partial(_open_loop, end)


def knot_times(end: float) -> np.ndarray:
    """Times (KNOTS,) of the open-loop gains' knots [s]: dense in the transient, then even."""
    dense, turn = KNOTS // 2, min(2.0, 0.5 * end)
    early = np.geomspace(0.03 * turn, turn, dense)
    return np.concatenate([[0.0], early, np.linspace(turn, end, KNOTS - dense)[1:]])


def _ramp(vector: Array) -> GainSchedule:
    return RampGain(vector[0], jnp.exp(vector[1]))


Ends = tuple[float, float]


def schedule_space(
    kind: str, experiment: config.Experiment, lowest: float | None = None
) -> SimpleSpace:
    """The search space of one kind of schedule for an observer.

    Gains are searched by their logarithm, over GAINS and the controller's range.

    Args:
        kind: One of `posegsa.model.schedules.SCHEDULES`, but "fuzzy".
        experiment: Its controller's range and its duration are used.
        lowest: Lowest gain [1/s], if it is not to be the default.
    """
    offset, (low, high) = experiment.fuzzy.offset, experiment.parameters.gain_range
    least = lowest or min(GAINS[0], max(offset + low, LOWEST_GAIN))
    gains = math.log(least), math.log(max(GAINS[1], offset + high))
    # Without estimated biases there is nothing to switch on later.
    learns = getattr(experiment.filter, "vector_bias", "off") == "estimated"
    return _space(kind, experiment, gains, learns=learns)


def noise_space(kind: str, experiment: config.Experiment) -> SimpleSpace:
    """The search space of a schedule of a Kalman filter's noise, whose output is in [1, 101].

    Args:
        kind: "constant", "smooth", "ramp", "switch" or "clock".
        experiment: Its duration is used.
    """
    return _space(kind, experiment, (0.0, math.log(101.0)), learns=False)


def _space(kind: str, experiment: config.Experiment, gain: Ends, *, learns: bool) -> SimpleSpace:
    """The search space of a kind of schedule with gains between these logarithms.

    Times of a switch go up to half of a scenario, that of the vectors' bias law only if it `learns`
    later than from the start. The scaled error at half gain goes from 0.003 to 1.
    """
    end = experiment.scenario.duration
    half = (math.log(0.003), 0.0)
    switch = (math.log(0.05), math.log(max(0.5 * end, 0.05)))
    learning = (0.0, 0.5 * end if learns else 0.0)
    boxes: dict[str, tuple[list[Ends], Callable[[Array], GainSchedule]]] = {
        "constant": ([gain], _constant),
        "switch": ([gain, gain, switch, learning], _switch),
        "smooth": ([gain, gain, half], _smooth),
        "open loop": ([gain] * KNOTS, _at(end)),
        "ramp": ([(0.0, 1.0), (math.log(0.1), math.log(1000.0))], _ramp),
        "clock": ([gain] * KNOTS, _at(end)),
    }
    bounds, make = boxes[kind]
    lower, upper = (jnp.asarray(ends, experiment.run.dtype) for ends in zip(*bounds, strict=True))
    return SimpleSpace(lower, upper, make)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NoiseSpaces:
    """The numbers of all schedules of a filter, one after another."""

    each: tuple[ScheduleSpace, ...]
    roles: tuple[str, ...] = field(metadata={"static": True})
    """The role of each in `joined`."""
    joined: type[NoiseGains | ObserverGains] = field(default=NoiseGains, metadata={"static": True})
    """What the schedules are joined in: those of a Kalman filter, or of an observer."""

    @property
    def lower(self) -> Array:
        """(d,)."""
        return jnp.concatenate([space.lower for space in self.each])

    @property
    def upper(self) -> Array:
        """(d,)."""
        return jnp.concatenate([space.upper for space in self.each])

    def schedule(self, vector: Array) -> NoiseGains | ObserverGains:
        """The schedules of a vector (d,)."""
        pairs = zip(self.roles, self.each, self._parts(vector), strict=True)
        made: dict[str, Any] = {role: space.schedule(part) for role, space, part in pairs}
        return self.joined(**made)

    def valid(self, vector: Array) -> Array:
        """Whether a vector (d,) has a cost."""
        pairs = zip(self.each, self._parts(vector), strict=True)
        return jnp.all(jnp.stack([space.valid(part) for space, part in pairs]))

    def _parts(self, vector: Array) -> list[Array]:
        """The vector of each schedule."""
        parts, first = [], 0
        for space in self.each:
            parts.append(vector[first : first + space.lower.shape[0]])
            first += space.lower.shape[0]
        return parts
