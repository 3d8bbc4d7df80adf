"""CMA-ES of the pycma library, by the algorithm's author, behind this package's protocol.

Source: N. Hansen, Y. Akimoto, P. Baudis, "CMA-ES/pycma", doi:10.5281/zenodo.2559634, version 4 of
the library. It comes with the extra `posegsa[compare]`; nothing else of this package needs it.

It is no JAX code: `minimise` runs it on the host, with the objective compiled (`on_host`).
"""

import copy
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, random
from jax.typing import DTypeLike

from posegsa.optimisers.checks import SMALLEST_SIGMA, check_count, check_number


class PyCMAState(NamedTuple):
    """State between two iterations; nothing in it is changed once it is made."""

    strategy: Any  # cma.CMAEvolutionStrategy, and its positions before they were cast
    asked: Array  # (agents, dimensions) in the unit box


@dataclass(frozen=True)
class PyCMA:
    """Settings of pycma's CMA-ES, which keeps to the box by its own transformation.

    Attributes:
        agents: Positions per iteration, the article's lambda.
        iterations: Iterations of a whole search; it does not stop by itself before.
        sigma: Standard deviation at the start, in widths of the box.

    Raises:
        ArgumentError: If a setting is out of its range.
        ImportError: If pycma is not installed.
    """

    agents: int = 100
    iterations: int = 250
    sigma: float = 0.3

    on_host: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the settings."""
        check_count("PyCMA: agents", self.agents, least=3)
        check_count("PyCMA: iterations", self.iterations)
        check_number("PyCMA: sigma", self.sigma, least=SMALLEST_SIGMA)
        _library()

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> PyCMAState:
        """Begin in the middle of the box."""
        seed = np.asarray(random.key_data(key)).tolist()
        options = {
            "bounds": [0, 1],
            "popsize": self.agents,
            "seed": np.nan,  # leaves NumPy's own generator alone
            "randn": _Normal(np.random.default_rng(seed)),
            "verbose": -10,
        }
        strategy = _library().CMAEvolutionStrategy([0.5] * dimensions, self.sigma, options)
        return self._asked(strategy, dtype)

    def ask(self, state: PyCMAState) -> Array:
        """Return the positions (agents, dimensions) in the unit box."""
        return state.asked

    def tell(self, state: PyCMAState, costs: Array) -> PyCMAState:
        """Tell a copy of the strategy what its positions cost."""
        strategy, positions = copy.deepcopy(state.strategy)
        strategy.tell(positions, np.asarray(costs, np.float64).tolist())
        return self._asked(strategy, state.asked.dtype)

    def _asked(self, strategy: Any, dtype: DTypeLike) -> PyCMAState:
        positions = strategy.ask()
        return PyCMAState(
            (strategy, positions), jnp.clip(jnp.asarray(np.array(positions), dtype), 0, 1)
        )


class _Normal:
    """Standard normal numbers from a generator that is copied with what it belongs to."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def __call__(self, *shape: int) -> np.ndarray:
        return self.generator.standard_normal(shape)


def _library() -> Any:
    try:
        import cma
    except ImportError:
        raise ImportError("cma (pycma) is not installed; pip install 'posegsa[compare]'") from None
    return cma
