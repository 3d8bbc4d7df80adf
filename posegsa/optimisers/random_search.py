"""Random search: the baseline that any optimiser has to beat."""

from dataclasses import dataclass
from typing import NamedTuple

from jax import Array, random
from jax.typing import DTypeLike

from posegsa.optimisers.base import uniform
from posegsa.optimisers.checks import check_count


class RandomSearchState(NamedTuple):
    """State of a random search."""

    position: Array  # (agents, dimensions) in the unit box
    key: Array  # random key of what is still to be drawn


@dataclass(frozen=True)
class RandomSearch:
    """Positions drawn anew in each iteration, uniformly and independently.

    Attributes:
        agents: Positions per iteration.
        iterations: Iterations of a whole search.

    Raises:
        ArgumentError: If a setting is not a positive integer.
    """

    agents: int = 100
    iterations: int = 250

    def __post_init__(self) -> None:
        """Check the settings."""
        check_count("RandomSearch: agents", self.agents)
        check_count("RandomSearch: iterations", self.iterations)

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> RandomSearchState:
        """Draw the first positions."""
        key, key_position = random.split(key)
        position = uniform(key_position, (self.agents, dimensions), dtype)
        return RandomSearchState(position, key)

    def ask(self, state: RandomSearchState) -> Array:
        """Return the positions (agents, dimensions) to evaluate."""
        return state.position

    def tell(self, state: RandomSearchState, costs: Array) -> RandomSearchState:
        """Draw the next positions, whatever the costs (agents,) were."""
        del costs
        return self.init(state.key, state.position.shape[1], state.position.dtype)
