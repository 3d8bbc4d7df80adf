"""What a search chooses between: filters that differ in their gain schedule and in some numbers."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from posegsa.model.filter import FilterSettings
from posegsa.model.schedules import GainSchedule
from posegsa.model.signal import SignalSettings
from posegsa.optimisers import Box


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Candidate:
    """A gain schedule, and what it needs of the filter and its signal that others need not share.

    Its leaves have no leading axis, or one of A candidates.
    """

    schedule: GainSchedule
    values: tuple[Array, ...] = ()
    """Further numbers that were tuned, each in the unit of its key."""
    keys: tuple[str, ...] = field(default=(), metadata={"static": True})
    """Their keys in the configuration (`config.tunable`)."""

    def values_by_key(self) -> dict[str, float]:
        """The further numbers by key, of one candidate."""
        return {key: float(value) for key, value in zip(self.keys, self.values, strict=True)}

    def applied(
        self, settings: FilterSettings, signal: SignalSettings
    ) -> tuple[FilterSettings, SignalSettings]:
        """The settings of filter and signal with its own numbers in them (pure, jittable)."""
        for key, value in zip(self.keys, self.values, strict=True):
            settings, signal = _with_value(settings, signal, key, value)
        return settings, signal


def _with_value(
    settings: FilterSettings, signal: SignalSettings, key: str, value: Array
) -> tuple[FilterSettings, SignalSettings]:
    """Settings with the number of one key of the configuration replaced."""
    match key.split("."):
        case ["gain", name]:
            return settings, replace(signal, **{name: value})
        case ["filter", "gamma"]:
            return replace(settings, gamma_angular=value, gamma_linear=value), signal
        case ["filter", "gamma", "0"]:
            return replace(settings, gamma_angular=value), signal
        case ["filter", "gamma", "1"]:
            return replace(settings, gamma_linear=value), signal
        case ["filter", "bias_bound", "0"]:
            return replace(settings, per_angular_bias_bound=1 / value**2), signal
        case ["filter", "bias_bound", "1"]:
            return replace(settings, per_linear_bias_bound=1 / value**2), signal
        case ["filter", "length"]:
            return replace(settings, length=value), signal
        case ["filter", "gain_limit"]:
            return replace(settings, gain_limit=value), signal
        case ["filter", "cross_vector_weight"]:
            return replace(settings, vectors=replace(settings.vectors, cross_weight=value)), signal
        case ["scenario", "vectors", index, "weight"]:
            weights = _with_weight(settings.vectors.weights, index, value)
            return replace(settings, vectors=replace(settings.vectors, weights=weights)), signal
        case ["scenario", "landmarks", index, "weight"]:
            weights = _with_weight(settings.landmark_weights, index, value)
            return replace(settings, landmark_weights=weights), signal
        case ["filter", name] if settings.vector_bias is not None:
            field, number = _OF_VECTOR_BIAS[name](value)
            learning = replace(settings.vector_bias, **{field: number})
            return replace(settings, vector_bias=learning), signal
    raise ValueError(f"{key}: is no tunable number of this filter")


_OF_VECTOR_BIAS: dict[str, Callable[[Array], tuple[str, Array]]] = {
    "vector_bias_gain": lambda gain: ("gain", gain),
    "vector_bias_leak": lambda leak: ("leak", leak),
    "vector_bias_bound": lambda bound: ("per_bound", 1 / bound**2),
    "excitation": lambda turning: ("per_turning", 1 / turning**4),
    "excitation_time": lambda time: ("excitation_time", time),
}
"""The field of `model.filter.VectorBias` that a key of [filter] sets, and to what."""


def _with_weight(
    weights: tuple[Array, ...] | None, index: str, value: Array
) -> tuple[Array, ...] | None:
    assert weights is not None  # settings that come from a configuration have them all
    return tuple(value if i == int(index) else weight for i, weight in enumerate(weights))


class ScheduleSpace(Protocol):
    """The vectors (d,) of one kind of schedule, and where they are searched."""

    @property
    def lower(self) -> Array:
        """(d,)."""
        ...

    @property
    def upper(self) -> Array:
        """(d,)."""
        ...

    def schedule(self, vector: Array) -> GainSchedule:
        """The schedule of a vector (d,) (pure, jittable)."""
        ...

    def valid(self, vector: Array) -> Array:
        """Whether a vector (d,) has a cost."""
        ...


Schedules = TypeVar("Schedules", bound=ScheduleSpace)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchSpace(Generic[Schedules]):
    """Where a search looks for candidates: a schedule's own numbers, then n further ones."""

    schedules: Schedules
    also_lower: Array
    """(n,) bounds of the further numbers, of their logarithms where these are searched."""
    also_upper: Array
    """(n,)"""
    keys: tuple[str, ...] = field(metadata={"static": True})
    """Of the further numbers."""
    logarithmic: tuple[bool, ...] = field(metadata={"static": True})
    """Whether the logarithm of each is searched."""

    @property
    def box(self) -> Box:
        """Of search vectors (d + n,)."""
        return Box(
            jnp.concatenate([self.schedules.lower, self.also_lower], axis=-1),
            jnp.concatenate([self.schedules.upper, self.also_upper], axis=-1),
        )

    def candidate(self, vector: Array) -> Candidate:
        """The candidate of a search vector (d + n,) (pure, jittable)."""
        # Of NumPy's, parts are taken without a program for each.
        numbers: Any = vector if isinstance(vector, Tracer) else np.asarray(vector)
        own = self.schedules.lower.shape[0]
        found = [numbers[own + i] for i in range(len(self.keys))]
        values = tuple(
            jnp.exp(value) if by_logarithm else value
            for value, by_logarithm in zip(found, self.logarithmic, strict=True)
        )
        return Candidate(self.schedules.schedule(numbers[:own]), values, self.keys)

    def valid(self, vector: Array) -> Array:
        """Whether a search vector (d + n,) has a cost."""
        return self.schedules.valid(vector[: self.schedules.lower.shape[0]])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SimpleSpace:
    """A kind of schedule with a few numbers, none of which needs a repair."""

    lower: Array
    """(d,)"""
    upper: Array
    """(d,)"""
    make: Callable[[Array], GainSchedule] = field(metadata={"static": True})
    """Maps a vector (d,) to the schedule."""

    def schedule(self, vector: Array) -> GainSchedule:
        """The schedule of a vector (d,)."""
        return self.make(vector)

    def valid(self, vector: Array) -> Array:
        """All are."""
        del vector
        return jnp.asarray(True)
