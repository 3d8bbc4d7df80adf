"""Gain schedules: rules for the observer's gain.

A schedule is any pytree with the two methods of `GainSchedule`. Its inputs are the scaled error and
rate, the time and its own last gain; it does not depend on the filter.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from posegsa.errors import ArgumentError
from posegsa.model.elementwise import maximum, minimum
from posegsa.model.fuzzy import (
    FuzzyController,
    PreparedController,
    membership,
    searched_heights,
)


class ScheduleInputs(NamedTuple):
    """The inputs of a schedule at a sample."""

    error: Array
    """Error signal divided by the error scale, clipped to [0, 1]."""
    rate: Array
    """Change of the error signal since the last sample times the rate scale, clipped to [0, 1]."""
    time: Array
    """Time since the first sample [s]."""
    last: Array
    """The schedule's gain at the last sample [1/s]."""


class Gains(NamedTuple):
    """The outputs of a schedule at a sample."""

    gain: Array
    """K [1/s]."""
    learning: Array | float = 1.0
    """Factor on the gain of the vectors' bias law, in [0, 1]."""


class PreparedSchedule(Protocol):
    """A schedule prepared for a loop."""

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """The gains at a sample."""
        ...


class GainSchedule(Protocol):
    """A rule for the gain."""

    def initial_gain(self) -> Array:
        """The value of `ScheduleInputs.last` at the first sample [1/s]."""
        ...

    def prepare(self) -> PreparedSchedule:
        """The schedule, with everything precomputed that is the same at every sample."""
        ...


class _Prepared:
    """A schedule of which there is nothing to precompute."""

    def prepare(self) -> Self:
        """The schedule itself."""
        return self


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ConstantGain(_Prepared):
    """A constant gain K [1/s]: the baseline."""

    formula: ClassVar[str] = "K = gain [1/s]"
    gain: Array

    def initial_gain(self) -> Array:
        """K."""
        return self.gain

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """K, in the shape of the inputs."""
        gain = jnp.asarray(self.gain, inputs.error.dtype)
        return Gains(jnp.broadcast_to(gain, inputs.error.shape))


class _PreparedFuzzyGain(NamedTuple):
    controller: FuzzyController
    prepared: PreparedController
    targets: tuple[tuple[Array, ...], ...] | None = None

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        if self.targets is None:
            heights = self.controller.heights(inputs.error, inputs.rate, self.prepared)
        else:
            terms = self.prepared.inputs
            error, rate = (
                tuple(membership(x, term) for term in terms) for x in (inputs.error, inputs.rate)
            )
            heights = searched_heights(error, rate, self.targets)
        return Gains(self.controller.defuzzify(heights, self.prepared, inputs.last))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FuzzyGain:
    """The paper's schedule: a fuzzy controller with the inputs error and rate."""

    formula: ClassVar[str] = (
        "K = offset + centroid [1/s] by Mamdani inference: min for AND and implication, max for "
        "aggregation."
    )
    controller: FuzzyController

    def initial_gain(self) -> Array:
        """Mid-range of the controller's output [1/s]."""
        return self.controller.initial_gain()

    def prepare(self) -> _PreparedFuzzyGain:
        """Slopes and overlaps of the terms."""
        return _PreparedFuzzyGain(self.controller, self.controller.prepare())


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchedRulesGain(FuzzyGain):
    """`FuzzyGain` while its rule table is searched: the table is traced instead of static.

    The controller's own rules are ignored. With the same table both give the same gains, bit for
    bit; this one is slower.
    """

    targets: Array
    """(5, 5) [rate, error], from small to large: the output term of each rule, 0 to 4."""

    def prepare(self) -> _PreparedFuzzyGain:
        """Slopes and overlaps of the terms, and the table rule by rule."""
        n = range(self.targets.shape[-1])
        targets = tuple(tuple(self.targets[..., r, e] for e in n) for r in n)
        return _PreparedFuzzyGain(self.controller, self.controller.prepare(), targets)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SmoothGain(_Prepared):
    """K(e) = low + (high - low) e^2 / (e^2 + half^2), a smooth schedule with three parameters."""

    formula: ClassVar[str] = (
        "K = low + (high - low) e^2 / (e^2 + half^2) [1/s], e: the scaled error in [0, 1]"
    )
    low: Array
    """K at small errors [1/s]."""
    high: Array
    """K at large errors [1/s]."""
    half: Array
    """The scaled error at which K is half-way between them."""

    def initial_gain(self) -> Array:
        """K at large errors [1/s]."""
        return self.high

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """K at the scaled error."""
        e2 = inputs.error * inputs.error
        return Gains(self.low + (self.high - self.low) * e2 / (e2 + self.half * self.half))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RampGain(_Prepared):
    """K(e) = 1 + 100 slope (e - start), within the controller's range of 1 to 101.

    In a Kalman filter's belief (`filters.noise_schedules`), where errors and factors are
    logarithms, this is a power of the residual above a threshold.
    """

    formula: ClassVar[str] = (
        "K = 1 + 100 slope (e - start) [1/s], from 1 to 101, e: the scaled error in [0, 1]"
    )
    start: Array
    """The scaled error up to which K is 1."""
    slope: Array
    """The share of the range by which K grows for an error of 1."""

    def initial_gain(self) -> Array:
        """1, as for a small error."""
        return jnp.ones_like(self.start)

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """K at the scaled error."""
        share = minimum(maximum(self.slope * (inputs.error - self.start), 0.0), 1.0)
        return Gains(1 + 100 * share)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KnotGain(_Prepared):
    """K(t): an open-loop gain sequence, piecewise exponential between knots."""

    formula: ClassVar[str] = "K = exp of log_gain [log 1/s] interpolated linearly over time [s]"
    time: Array
    """(n,) times of the knots [s], ascending."""
    log_gain: Array
    """(n,) log of K there."""

    def initial_gain(self) -> Array:
        """K at the first knot [1/s]."""
        return jnp.exp(self.log_gain[..., 0])

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """K at the time of the sample."""
        time = jnp.broadcast_to(inputs.time, jnp.shape(inputs.error))
        # Knots (A, n) are those of A agents.
        axes = [0 if jnp.ndim(knots) > 1 else None for knots in (self.time, self.log_gain)]
        interpolated = jax.vmap(jnp.interp, (0, *axes)) if 0 in axes else jnp.interp
        return Gains(jnp.exp(interpolated(time, self.time, self.log_gain)))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SwitchGain(_Prepared):
    """One gain before a time and another after it; a second time starts the vectors' bias law."""

    formula: ClassVar[str] = "K = before [1/s] until time [s], then K = after [1/s]"
    before: Array
    """K before `time` [1/s]."""
    after: Array
    """K from `time` on [1/s]."""
    time: Array
    """When the gain changes [s]."""
    learning_time: Array
    """When the vectors' bias law starts [s]."""

    def initial_gain(self) -> Array:
        """K at the start [1/s]."""
        return self.before

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """K and the factor on the vectors' bias law at the time of the sample."""
        shape = jnp.shape(inputs.error)
        dtype = inputs.error.dtype
        before, after = (jnp.asarray(gain, dtype) for gain in (self.before, self.after))
        gain = jnp.where(inputs.time < self.time, before, after)
        learning = jnp.where(inputs.time < self.learning_time, 0.0, 1.0).astype(dtype)
        return Gains(jnp.broadcast_to(gain, shape), jnp.broadcast_to(learning, shape))


SCHEDULES = {
    "fuzzy": FuzzyGain,
    "constant": ConstantGain,
    "switch": SwitchGain,
    "smooth": SmoothGain,
    "ramp": RampGain,
    "open loop": KnotGain,
}
"""The schedules that posegsa searches, stores and exports, by kind. The fields of one other than a
controller or knots are single numbers; `formula` is what it computes from them."""


def prepared(schedules: Iterable[GainSchedule | None]) -> list[Any]:
    """The schedules prepared for a loop; None stays None."""
    return [None if one is None else one.prepare() for one in schedules]


def all_elementwise(schedules: Iterable[Any]) -> bool:
    """Whether all schedules are posegsa's, which work on numbers and inputs of any common shape.

    A user's may not: one that decides by `lax.cond` needs scalars.
    """
    return all(one is None or type(one) in _ELEMENTWISE for one in schedules)


_ELEMENTWISE = (*SCHEDULES.values(), SearchedRulesGain)


def check_gain(name: str, gain: ArrayLike) -> None:
    """Raise an ArgumentError if a gain is negative; traced gains cannot be checked."""
    if not isinstance(gain, Tracer) and np.any(np.less(gain, 0)):
        raise ArgumentError(f"{name} = {np.min(gain)}; allowed: at least 0 [1/s]")


def check_schedule(schedule: GainSchedule) -> None:
    """Raise an ArgumentError unless this is a schedule whose initial gain is at least 0."""
    if not (hasattr(schedule, "prepare") and hasattr(schedule, "initial_gain")):
        what = type(schedule).__name__
        raise ArgumentError(f"schedule: a {what}; allowed: ConstantGain, FuzzyGain or the like")
    # On-line this runs at every step, so the gain of a controller is computed on the host.
    fuzzy = isinstance(schedule, FuzzyGain)
    gain = schedule.controller.middle_gain if fuzzy else schedule.initial_gain()
    check_gain("schedule: its gain", gain)
