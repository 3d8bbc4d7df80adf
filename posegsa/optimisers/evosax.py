"""Strategies of the evosax library, including CMA-ES, as optimisers of this package.

Source: R. T. Lange, "evosax: JAX-based Evolution Strategies", 2022, version 0.3 of the library.
It comes with the extra `posegsa[compare]`; nothing else of this package needs it.

The strategies have no box. Their positions are mirrored at the faces of the unit box, as often as
needed, before they are evaluated. The strategy gets the costs as those of its own positions.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax, random
from jax.typing import DTypeLike
from pydantic import Field

from posegsa.errors import ConfigError
from posegsa.optimisers.ask_tell import Optimiser, uniform
from posegsa.settings.fields import Count, Positive


class EvosaxState(NamedTuple):
    """State of a strategy between two iterations."""

    strategy: Any  # the state of evosax
    asked: Array  # (agents, dimensions) the strategy's positions, before mirroring
    told: Array  # () bool, whether `tell` was called
    key: Array  # random key for the next draws


class Evosax(Optimiser):
    """A strategy of the evosax library, in the unit box."""

    optimiser: Literal["evosax"] = "evosax"
    """Name of the optimiser."""
    agents: Annotated[Count, Field(ge=2)] = 100
    """Number of positions that are evaluated at once."""
    strategy: Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_]+$")] = "CMA_ES"
    """Its name in `evosax.algorithms`, for example "CMA_ES", "SNES" or "SimpleGA"."""
    sigma: Positive = 0.3
    """Initial standard deviation, in widths of the box, for strategies that have one."""

    title: ClassVar[str] = "A strategy of evosax"
    compared_by_default: ClassVar[bool] = False

    def check_usable(self) -> None:
        """Check that evosax is installed and has the strategy."""
        try:
            from evosax.algorithms import algorithms
        except ImportError:
            raise ConfigError(
                "evosax is not installed; in a clone of posegsa: pip install '.[compare]'"
            ) from None
        if self.strategy not in algorithms:
            allowed = f"{self.optimiser}; allowed: {', '.join(sorted(algorithms))}"
            raise ConfigError(f"strategy = {self.strategy!r} of {allowed}")

    def _made(self, dimensions: int) -> tuple[Any, Any, bool]:
        return _make(self.strategy, self.agents, dimensions, self.sigma)

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> EvosaxState:
        """Start in the middle of the box, or with a population drawn uniformly over it."""
        key, key_first = random.split(key)
        strategy, params, from_costs = self._made(dimensions)
        asked = uniform(key_first, (self.agents, dimensions), dtype)
        with _loose():
            if from_costs:
                made = strategy.init(key_first, asked, jnp.zeros(self.agents, dtype), params)
                made = jax.tree.map(jnp.asarray, made)
            else:
                middle = jnp.full(dimensions, 0.5, dtype)
                made = strategy.init(key_first, middle, params)
                asked, made = strategy.ask(key_first, jax.tree.map(jnp.asarray, made), params)
        return EvosaxState(_like(made, made), asked.astype(dtype), jnp.asarray(False), key)

    def ask(self, state: EvosaxState) -> Array:
        """Return the strategy's positions (agents, dimensions), mirrored into the unit box."""
        path = jnp.mod(state.asked, 2)  # period 2: forth and back
        return jnp.where(jnp.isfinite(path), jnp.where(path > 1, 2 - path, path), 0.5)

    def tell(self, state: EvosaxState, costs: Array) -> EvosaxState:
        """Give the strategy the costs of its positions, and let it choose the next positions."""
        dimensions, dtype = state.asked.shape[1], state.asked.dtype
        strategy, params, from_costs = self._made(dimensions)
        key, key_tell, key_ask = random.split(state.key, 3)

        def later(old: Any) -> Any:
            return _like(strategy.tell(key_tell, state.asked, costs, old, params)[0], old)

        def first(old: Any) -> Any:
            return _like(strategy.init(key_tell, state.asked, costs, params), old)

        with _loose():
            old = state.strategy
            # The first costs belong to the initial population.
            made = lax.cond(state.told, later, first, old) if from_costs else later(old)
            asked, made = strategy.ask(key_ask, made, params)
        return EvosaxState(_like(made, old), asked.astype(dtype), jnp.asarray(True), key)


class CMAES(Evosax):
    """CMA-ES of the evosax library."""

    optimiser: Literal["cma_es"] = "cma_es"
    """Name of the optimiser."""
    strategy: Literal["CMA_ES"] = "CMA_ES"
    """Its name in `evosax.algorithms`."""

    title: ClassVar[str] = "CMA-ES (evosax)"
    compared_by_default: ClassVar[bool] = True


@cache
def _make(name: str, agents: int, dimensions: int, sigma: float) -> tuple[Any, Any, bool]:
    """A strategy, its parameters, and whether it starts from the costs of a population."""
    from evosax.algorithms import algorithms
    from evosax.algorithms.population_based.base import PopulationBasedAlgorithm

    with jax.ensure_compile_time_eval(), jax.enable_x64(False), _loose():
        strategy = algorithms[name](population_size=agents, solution=jnp.zeros(dimensions))
        params = strategy.default_params
        if hasattr(params, "std_init"):
            params = params.replace(std_init=jnp.asarray(sigma))
    return strategy, params, isinstance(strategy, PopulationBasedAlgorithm)


def _like(tree: Any, model: Any) -> Any:
    """A tree cast to the types of another, as a compiled loop requires."""
    return jax.tree.map(lambda a, m: jnp.asarray(a).astype(jnp.asarray(m).dtype), tree, model)


@contextmanager
def _loose() -> Iterator[None]:
    """Allow JAX's standard promotion of types and shapes, which evosax needs."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
