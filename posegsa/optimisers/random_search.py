"""Random search: the baseline that any optimiser has to beat."""

from typing import ClassVar, Literal, NamedTuple

from jax import Array, random
from jax.typing import DTypeLike

from posegsa.optimisers.base import Optimiser, uniform


class RandomSearchState(NamedTuple):
    """State of a random search."""

    position: Array  # (agents, dimensions) in the unit box
    key: Array  # random key of what is still to be drawn


class RandomSearch(Optimiser):
    """Positions drawn anew in each iteration, uniformly and independently."""

    optimiser: Literal["random_search"] = "random_search"
    """Name of the optimiser."""

    title: ClassVar[str] = "Random search"

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> RandomSearchState:
        """Draw the first positions."""
        key, key_position = random.split(key)
        position = uniform(key_position, (self.agents, dimensions), dtype)
        return RandomSearchState(position, key)

    def tell(self, state: RandomSearchState, costs: Array) -> RandomSearchState:
        """Draw the next positions, whatever the costs (agents,) were."""
        del costs
        return self.init(state.key, state.position.shape[1], state.position.dtype)
