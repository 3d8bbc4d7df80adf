"""Adam: gradient descent with momentum and a step size per coordinate, from many starts at once.

Source: D. P. Kingma, J. Ba, "Adam: A Method for Stochastic Optimization", ICLR 2015, Algorithm 1,
as optax implements it. Steps are taken in the unit box and projected onto it. Their length falls
along a half cosine (I. Loshchilov, F. Hutter, "SGDR", ICLR 2017, Eq. 5, without restarts), because
a constant step does not settle in a minimum with kinks.
"""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, random
from jax.typing import DTypeLike
from pydantic import Field

from posegsa.optimisers.ask_tell import Optimiser, uniform
from posegsa.settings.fields import Count, Epsilon, Positive, Section, Share

if TYPE_CHECKING:
    import optax

MAX_BETA = 0.999999
"""Just below 1, in float32 too; at 1 the bias correction of the running mean is 0 / 0."""
Beta = Annotated[float, Field(strict=True, ge=0, le=MAX_BETA)]


class AdamState(NamedTuple):
    """State of all descents between two iterations."""

    position: Array  # (agents, dimensions) in the unit box
    moments: Any  # optax's m and v of the source, (agents, dimensions) each
    iteration: Array  # () int32, iterations done
    key: Array  # random key for the next draws


class DescentSettings(Section):
    """Settings of gradient descent, alone or after a search."""

    learning_rate: Positive = 0.03
    """Length of the first step in each coordinate, in widths of the box; it decays to 0."""
    spread: Share = 0.05
    """Spread of the starts of a descent after a search, in widths of the box: one is at the best
    position found, the others up to this far from it in each coordinate."""
    gradient_price: Count = 23
    """Evaluations that a cost with its gradient counts as: 1, and 22 for the parameters."""


class Adam(DescentSettings, Optimiser):
    """Gradient descent (Kingma and Ba 2015) in the unit box, from many starts at once."""

    optimiser: Literal["adam"] = "adam"
    """Name of the optimiser."""
    agents: Count = 8
    """Number of starts, drawn uniformly over the box."""
    iterations: Count = 135
    """Number of steps of each start."""
    beta1: Beta = 0.9
    """Decay of the gradient's running mean, no unit."""
    beta2: Beta = 0.999
    """Decay of the squared gradient's running mean, no unit."""
    epsilon: Epsilon = 1e-8
    """Added to the root of that mean, to avoid division by zero."""

    title: ClassVar[str] = "Gradient descent (Adam)"
    agent_noun: ClassVar[str] = "start"
    iteration_noun: ClassVar[str] = "step"
    wants_gradients: ClassVar[bool] = True
    fixed_length: ClassVar[str] = "Adam's steps shrink towards the end"

    @property
    def evaluations_per_agent(self) -> int:
        """The price of a gradient."""
        return self.gradient_price

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> AdamState:
        """Draw the starts uniformly over the unit box."""
        key, key_position = random.split(key)
        return self._at(uniform(key_position, (self.agents, dimensions), dtype), key)

    def begin_at(self, state: AdamState, position: Array) -> AdamState:
        """Start at a position (dimensions,) in the unit box, and around it."""
        key, key_move = random.split(state.key)
        moves = 2 * uniform(key_move, state.position.shape, position.dtype) - 1
        moves = self.spread * moves.at[0].set(0)
        return self._at(jnp.clip(position[None, :] + moves, 0, 1), key)

    def _at(self, position: Array, key: Array) -> AdamState:
        return AdamState(position, self._adam().init(position), jnp.asarray(0, jnp.int32), key)

    def _adam(self) -> "optax.GradientTransformation":
        import optax  # here, as it would take a quarter of the time to import posegsa

        return optax.scale_by_adam(self.beta1, self.beta2, self.epsilon)

    def tell(self, state: AdamState, costs: Array, gradients: Array) -> AdamState:
        """Take one step down each gradient (agents, dimensions), and project it onto the box."""
        del costs
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
            direction, moments = self._adam().update(gradients, state.moments)
        share = jnp.minimum(state.iteration, self.iterations).astype(gradients.dtype)
        rate = 0.5 * self.learning_rate * (1 + jnp.cos(jnp.pi * share / self.iterations))
        position = jnp.clip(state.position - rate * jnp.asarray(direction), 0, 1)
        return AdamState(position, moments, state.iteration + 1, state.key)
