"""Two optimisers in turn: one that searches widely, then one that descends from what it found."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
from jax import Array, random
from jax.typing import DTypeLike

from posegsa.optimisers.base import GradientOptimiser, Optimiser


class Descent(GradientOptimiser, Protocol):
    """A gradient optimiser that can begin where it is told to."""

    def begin_at(self, state: Any, position: Array) -> Any:
        """Return the state with its starts at, and around, a position (dimensions,)."""
        ...


class PolishState(NamedTuple):
    """The states of both."""

    first: Any
    second: Any


@dataclass(frozen=True)
class Polish:
    """A search, and then a descent from the best position that it found.

    Attributes:
        first: What searches.
        second: What descends.
    """

    first: Optimiser
    second: Descent

    @property
    def iterations(self) -> int:
        """Iterations of both together."""
        return self.first.iterations + self.second.iterations

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> PolishState:
        """Return the states of both before they begin."""
        return PolishState(
            self.first.init(key, dimensions, dtype),
            self.second.init(random.fold_in(key, 1), dimensions, dtype),
        )

    def hand_over(self, state: PolishState, unit_position: Array) -> PolishState:
        """Let the second begin at the best position (dimensions,) of the first."""
        return state._replace(
            second=self.second.begin_at(state.second, jnp.clip(unit_position, 0, 1))
        )
