"""Adam: gradient descent with momentum and a step for each coordinate, from many starts at once.

Source: D. P. Kingma, J. Ba, "Adam: A Method for Stochastic Optimization", ICLR 2015, Algorithm 1,
as optax implements it. Steps are taken in the unit box and projected onto it; their length falls
along a half cosine (I. Loshchilov, F. Hutter, "SGDR", ICLR 2017, Eq. 5, without restarts), because
a constant step keeps circling a minimum with kinks.
"""

from dataclasses import dataclass
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from jax import Array, random
from jax.typing import DTypeLike

from posegsa.optimisers.base import uniform
from posegsa.optimisers.checks import SMALLEST_EPSILON, check_count, check_number

LARGEST_BETA = 0.999999
"""A running mean that decays by nothing has a bias correction of 0 / 0; float32 rounds."""


class AdamState(NamedTuple):
    """State of all descents between two iterations."""

    position: Array  # (agents, dimensions) in the unit box
    moments: optax.ScaleByAdamState  # m and v of the source, (agents, dimensions) each
    iteration: Array  # () int32, iterations done
    key: Array  # random key of what is still to be drawn


@dataclass(frozen=True)
class Adam:
    """Settings of the descents.

    Attributes:
        agents: Number of starts, drawn uniformly over the box, that descend side by side.
        iterations: Steps of each.
        learning_rate: Length of the first step of each coordinate, in widths of the box.
        beta1: Decay of the gradient's running mean, below 1.
        beta2: Decay of the squared gradient's running mean, below 1.
        epsilon: Added to its root, against division by zero; above 0.
        spread: Where the descents begin at a given position: all but the first are moved away
            from it by up to this in each coordinate, in widths of the box.
        gradient_price: How many evaluations a cost with its gradient counts as.

    Raises:
        ArgumentError: If a setting is out of its range.
    """

    agents: int = 8
    iterations: int = 135
    learning_rate: float = 0.03
    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8
    spread: float = 0.05
    gradient_price: int = 23

    def __post_init__(self) -> None:
        """Check the settings."""
        check_count("Adam: agents", self.agents)
        check_count("Adam: iterations", self.iterations)
        check_number("Adam: learning_rate", self.learning_rate)
        check_number("Adam: beta1", self.beta1, most=LARGEST_BETA)
        check_number("Adam: beta2", self.beta2, most=LARGEST_BETA)
        check_number("Adam: epsilon", self.epsilon, least=SMALLEST_EPSILON)
        check_number("Adam: spread", self.spread, most=1)
        check_count("Adam: gradient_price", self.gradient_price)

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> AdamState:
        """Draw the starts uniformly over the unit box."""
        key, key_position = random.split(key)
        return self._at(uniform(key_position, (self.agents, dimensions), dtype), key)

    def begin_at(self, state: AdamState, position: Array) -> AdamState:
        """Begin at a position (dimensions,) in the unit box, and around it."""
        key, key_move = random.split(state.key)
        moves = 2 * uniform(key_move, state.position.shape, position.dtype) - 1
        moves = self.spread * moves.at[0].set(0)
        return self._at(jnp.clip(position[None, :] + moves, 0, 1), key)

    def _at(self, position: Array, key: Array) -> AdamState:
        return AdamState(position, self._moments(position), jnp.asarray(0, jnp.int32), key)

    def _moments(self, position: Array) -> optax.ScaleByAdamState:
        return cast(optax.ScaleByAdamState, self._adam().init(position))

    def _adam(self) -> optax.GradientTransformation:
        return optax.scale_by_adam(self.beta1, self.beta2, self.epsilon)

    def ask(self, state: AdamState) -> Array:
        """Return the descents' positions (agents, dimensions) in the unit box."""
        return state.position

    def tell(self, state: AdamState, costs: Array, gradients: Array) -> AdamState:
        """Take one step down each gradient (agents, dimensions), and back onto the box."""
        del costs
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
            direction, moments = self._adam().update(gradients, state.moments)
        share = jnp.minimum(state.iteration, self.iterations).astype(gradients.dtype)
        rate = 0.5 * self.learning_rate * (1 + jnp.cos(jnp.pi * share / self.iterations))
        position = jnp.clip(state.position - rate * jnp.asarray(direction), 0, 1)
        moments = cast(optax.ScaleByAdamState, moments)
        return AdamState(position, moments, state.iteration + 1, state.key)
