"""What a search chooses between: filters that differ in their gain schedule and in some numbers."""

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
from posegsa.model.schedules import GainSchedule
from posegsa.optimisers import Box

FilterT = TypeVar("FilterT", bound=Filter)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Candidate:
    """What one filter of a search has of its own; all else it shares with the others.

    Its leaves have no leading axis, or one of A candidates.
    """

    schedule: GainSchedule | None = None
    """Of the gain; None where the filter has none."""
    values: tuple[Array, ...] = ()
    """Further numbers that were tuned, each in the unit of its key."""
    keys: tuple[str, ...] = field(default=(), metadata={"static": True})
    """Their keys (`Filter.with_values`)."""

    def values_by_key(self) -> dict[str, float]:
        """The further numbers by key, of one candidate."""
        return {key: float(value) for key, value in zip(self.keys, self.values, strict=True)}

    def applied(self, shared: FilterT) -> FilterT:
        """The filter with this candidate's schedule and numbers (pure, jittable)."""
        own = shared.with_values(dict(zip(self.keys, self.values, strict=True)))
        if self.schedule is None:
            return own
        return replace(cast(Any, own), schedule=self.schedule)


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

    def schedule(self, vector: Array) -> GainSchedule | None:
        """The schedule of a vector (d,) (pure, jittable); None of a filter without one."""
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
    make: Callable[[Array], GainSchedule | None] = field(metadata={"static": True})
    """Maps a vector (d,) to the schedule."""

    def schedule(self, vector: Array) -> GainSchedule | None:
        """The schedule of a vector (d,)."""
        return self.make(vector)

    def valid(self, vector: Array) -> Array:
        """All are."""
        del vector
        return jnp.asarray(True)


def without_schedule(dtype: DTypeLike) -> SimpleSpace:
    """The space of a filter that has no schedule: only its own numbers are searched."""
    none = jnp.zeros(0, dtype)
    return SimpleSpace(none, none, _no_schedule)


def _no_schedule(vector: Array) -> None:
    del vector
