"""Candidates of a search: filters that differ in their gain schedule and in some numbers."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import DTypeLike

from posegsa.filters.base import Filter
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.filters.observer import ObserverGains
from posegsa.model.schedules import GainSchedule
from posegsa.optimisers import Box

FilterT = TypeVar("FilterT", bound=Filter)
Schedule = GainSchedule | NoiseGains | ObserverGains
"""What a search puts into a filter: an observer's gain schedule, alone or with those of belief, or
those of a Kalman filter's noises."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Candidate:
    """The schedule and numbers of one filter in a search; all filters share the rest.

    The leaves have no leading axis, or a leading axis of A candidates.
    """

    schedule: Schedule | None = None
    """The schedule; None if the filter has none."""
    values: tuple[Array, ...] = ()
    """Other tuned numbers, each in the unit of its key."""
    keys: tuple[str, ...] = field(default=(), metadata={"static": True})
    """Their keys in the configuration."""

    @property
    def gain(self) -> GainSchedule | None:
        """An observer's gain schedule, without belief; None of another filter."""
        if isinstance(self.schedule, NoiseGains):
            return None
        return self.schedule.gain if isinstance(self.schedule, ObserverGains) else self.schedule

    def values_by_key(self) -> dict[str, float]:
        """The other tuned numbers by key; only for one candidate."""
        return {key: float(value) for key, value in zip(self.keys, self.values, strict=True)}

    def applied(self, shared: FilterT) -> FilterT:
        """The filter with this candidate's schedule and numbers (pure, jittable)."""
        names = (key.removeprefix("filter.") for key in self.keys)
        own = shared.with_values(dict(zip(names, self.values, strict=True)))
        if self.schedule is None:
            return own
        return replace(cast(Any, own), schedule=self.schedule)


class ScheduleSpace(Protocol):
    """The search space of one kind of schedule: vectors (d,) and their bounds."""

    @property
    def lower(self) -> Array:
        """(d,)."""
        ...

    @property
    def upper(self) -> Array:
        """(d,)."""
        ...

    def schedule(self, vector: Array) -> Schedule | None:
        """The schedule of a vector (d,) (pure, jittable); None if the filter has none."""
        ...

    def valid(self, vector: Array) -> Array:
        """Whether a vector (d,) has a cost."""
        ...


Schedules = TypeVar("Schedules", bound=ScheduleSpace)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchSpace(Generic[Schedules]):
    """The space of candidates: the d numbers of a schedule, then n other numbers."""

    schedules: Schedules
    also_lower: Array
    """(n,) bounds of the other numbers, or of their logarithms where these are searched."""
    also_upper: Array
    """(n,)"""
    keys: tuple[str, ...] = field(metadata={"static": True})
    """Keys of the other numbers."""
    logarithmic: tuple[bool, ...] = field(metadata={"static": True})
    """Whether the logarithm of each is searched."""

    @property
    def box(self) -> Box:
        """The box of the search vectors (d + n,)."""
        return Box(
            jnp.concatenate([self.schedules.lower, self.also_lower], axis=-1),
            jnp.concatenate([self.schedules.upper, self.also_upper], axis=-1),
        )

    def candidate(self, vector: Array) -> Candidate:
        """The candidate of a search vector (d + n,) (pure, jittable)."""
        # Slicing a NumPy array compiles no program.
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
    """A space of schedules with a few numbers that need no repair."""

    lower: Array
    """(d,)"""
    upper: Array
    """(d,)"""
    make: Callable[[Array], GainSchedule | None] = field(
        default=lambda _: None, metadata={"static": True}
    )
    """Maps a vector (d,) to the schedule; by default there is none."""

    def schedule(self, vector: Array) -> GainSchedule | None:
        """The schedule of a vector (d,)."""
        return self.make(vector)

    def valid(self, vector: Array) -> Array:
        """True: every vector has a cost."""
        del vector
        return jnp.asarray(True)


def without_schedule(dtype: DTypeLike) -> SimpleSpace:
    """The space of a filter that has no schedule: only its own numbers are searched."""
    none = jnp.zeros(0, dtype)
    return SimpleSpace(none, none)
