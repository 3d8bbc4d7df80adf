"""CMA-ES of the pycma library, by the algorithm's author, as an optimiser of this package.

Source: N. Hansen, Y. Akimoto, P. Baudis, "CMA-ES/pycma", doi:10.5281/zenodo.2559634, version 4 of
the library. It comes with the extra `posegsa[compare]`; nothing else of this package needs it.

The library does not use JAX: it runs on the host, and only the objective is compiled.
"""

import copy
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, random
from jax.typing import DTypeLike
from pydantic import Field

from posegsa.errors import ConfigError
from posegsa.optimisers.ask_tell import Optimiser
from posegsa.settings.fields import Count, Positive


class PyCMAState(NamedTuple):
    """State between two iterations; it is never modified."""

    strategy: Any  # (cma.CMAEvolutionStrategy, its positions before the cast)
    position: Array  # (agents, dimensions) in the unit box


class PyCMA(Optimiser):
    """CMA-ES of the pycma library; its own transformation keeps it in the unit box."""

    optimiser: Literal["pycma"] = "pycma"
    """Name of the optimiser."""
    agents: Annotated[Count, Field(ge=3)] = 100
    """Positions per iteration, the article's lambda."""
    sigma: Positive = 0.3
    """Initial standard deviation, in widths of the box."""

    title: ClassVar[str] = "CMA-ES (pycma)"
    on_host: ClassVar[bool] = True
    compared_by_default: ClassVar[bool] = False

    def check_usable(self) -> None:
        """Check that pycma is installed."""
        try:
            import cma  # noqa: F401 - only to check that it is installed
        except ImportError:
            message = (
                "cma (pycma) is not installed; in a clone of posegsa: pip install '.[compare]'"
            )
            raise ConfigError(message) from None

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> PyCMAState:
        """Start in the middle of the box."""
        import cma

        seed = np.asarray(random.key_data(key)).tolist()
        options = {
            "bounds": [0, 1],
            "popsize": self.agents,
            "seed": np.nan,  # does not seed NumPy's global generator
            "randn": partial(_normal, np.random.default_rng(seed)),
            "verbose": -10,
        }
        strategy = cma.CMAEvolutionStrategy([0.5] * dimensions, self.sigma, options)
        return self._asked(strategy, dtype)

    def tell(self, state: PyCMAState, costs: Array) -> PyCMAState:
        """Give the costs of the positions to a copy of the strategy."""
        strategy, positions = copy.deepcopy(state.strategy)
        strategy.tell(positions, np.asarray(costs, np.float64).tolist())
        return self._asked(strategy, state.position.dtype)

    def _asked(self, strategy: Any, dtype: DTypeLike) -> PyCMAState:
        positions = strategy.ask()
        return PyCMAState(
            (strategy, positions), jnp.clip(jnp.asarray(np.array(positions), dtype), 0, 1)
        )


def _normal(generator: np.random.Generator, *shape: int) -> np.ndarray:
    return generator.standard_normal(shape)
