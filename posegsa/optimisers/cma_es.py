"""CMA-ES of the evosax library, as an optimiser of this package.

Source: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, as in R. T. Lange,
"evosax: JAX-based Evolution Strategies", 2022, version 0.3 of the library. It comes with the extra
`posegsa[compare]`; nothing else of this package needs it.

The strategy has no box. Its positions are mirrored at the faces of the unit box, as often as
needed, before they are evaluated. The strategy gets the costs as those of its own positions.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, random
from jax.typing import DTypeLike
from pydantic import Field

from posegsa.errors import ConfigError
from posegsa.optimisers.ask_tell import Optimiser
from posegsa.settings.fields import Count, Positive


class CMAESState(NamedTuple):
    """State of the strategy between two iterations."""

    strategy: Any  # the state of evosax
    asked: Array  # (agents, dimensions) the strategy's positions, before mirroring
    key: Array  # random key for the next draws


class CMAES(Optimiser):
    """CMA-ES of the evosax library, in the unit box."""

    optimiser: Literal["cma_es"] = "cma_es"
    """Name of the optimiser."""
    agents: Annotated[Count, Field(ge=2)] = 100
    """Number of positions that are evaluated at once."""
    sigma: Positive = 0.3
    """Initial standard deviation, in widths of the box."""

    title: ClassVar[str] = "CMA-ES (evosax)"

    def check_usable(self) -> None:
        """Check that evosax is installed."""
        try:
            import evosax  # noqa: F401 - only to check that it is installed
        except ImportError:
            raise ConfigError(
                "evosax is not installed; in a clone of posegsa: pip install '.[compare]'"
            ) from None

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> CMAESState:
        """Start in the middle of the box."""
        key, key_first = random.split(key)
        strategy, params = _made(self.agents, dimensions, self.sigma)
        with _loose():
            made = strategy.init(key_first, jnp.full(dimensions, 0.5, dtype), params)
            asked, made = strategy.ask(key_first, jax.tree.map(jnp.asarray, made), params)
        return CMAESState(made, asked.astype(dtype), key)

    def ask(self, state: CMAESState) -> Array:
        """Return the strategy's positions (agents, dimensions), mirrored into the unit box."""
        path = jnp.mod(state.asked, 2)  # period 2: forth and back
        return jnp.where(jnp.isfinite(path), jnp.where(path > 1, 2 - path, path), 0.5)

    def tell(self, state: CMAESState, costs: Array) -> CMAESState:
        """Give the strategy the costs of its positions, and let it choose the next positions."""
        dimensions, dtype = state.asked.shape[1], state.asked.dtype
        strategy, params = _made(self.agents, dimensions, self.sigma)
        key, key_tell, key_ask = random.split(state.key, 3)
        with _loose():
            old, _ = strategy.tell(key_tell, state.asked, costs, state.strategy, params)
            asked, made = strategy.ask(key_ask, _like(old, state.strategy), params)
        return CMAESState(_like(made, state.strategy), asked.astype(dtype), key)


@cache
def _made(agents: int, dimensions: int, sigma: float) -> tuple[Any, Any]:
    """The strategy and its parameters."""
    from evosax.algorithms import CMA_ES

    with jax.ensure_compile_time_eval(), jax.enable_x64(False), _loose():
        strategy = CMA_ES(population_size=agents, solution=jnp.zeros(dimensions))
        return strategy, strategy.default_params.replace(std_init=jnp.asarray(sigma))


def _like(tree: Any, model: Any) -> Any:
    """A tree cast to the types of another, as a compiled loop requires."""
    return jax.tree.map(lambda a, m: jnp.asarray(a).astype(m.dtype), tree, model)


@contextmanager
def _loose() -> Iterator[None]:
    """Allow JAX's standard promotion of types and shapes, which evosax needs."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
