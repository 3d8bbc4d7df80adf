"""Random search: the baseline that every optimiser should beat."""

from typing import ClassVar, Literal, NamedTuple

from jax import Array, random
from jax.typing import DTypeLike

from posegsa.optimisers.ask_tell import Optimiser, uniform


class RandomSearchState(NamedTuple):
    """State of a random search."""

    position: Array  # (agents, dimensions) in the unit box
    key: Array  # random key for the next draws


class RandomSearch(Optimiser):
    """Positions drawn in each iteration, uniformly and independently."""

    optimiser: Literal["random_search"] = "random_search"
    """Name of the optimiser."""

    title: ClassVar[str] = "Random search"

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> RandomSearchState:
        """Draw the first positions."""
        key, key_position = random.split(key)
        position = uniform(key_position, (self.agents, dimensions), dtype)
        return RandomSearchState(position, key)

    def tell(self, state: RandomSearchState, costs: Array) -> RandomSearchState:
        """Draw the next positions; the costs (agents,) are ignored."""
        del costs
        return self.init(state.key, state.position.shape[1], state.position.dtype)
