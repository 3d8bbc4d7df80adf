"""Parameter vectors and fuzzy controllers."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from helpers import reference
from posegsa.model.fuzzy import FuzzyController

RULES = tuple(tuple(row) for row in reference.PAPER_RULES.tolist())


def search_vectors(count: int, seed: int = 0) -> np.ndarray:
    """Vectors k (count, 22) drawn uniformly from the paper's boxes, not repaired."""
    rng = np.random.default_rng(seed)
    return rng.uniform(reference.PAPER_LOWER, reference.PAPER_UPPER, (count, 22))


def corner_vectors(count: int, seed: int = 0) -> np.ndarray:
    """Such vectors with entries at their bounds: half of them, or in every second vector all.

    The first two vectors are the upper and the lower bounds themselves.
    """
    rng = np.random.default_rng(seed)
    ends = np.where(rng.random((count, 22)) < 0.5, reference.PAPER_LOWER, reference.PAPER_UPPER)
    share = np.where(np.arange(count) % 2, 1.0, 0.5)[:, None]
    vectors = np.where(rng.random((count, 22)) < share, ends, search_vectors(count, seed + 1))
    vectors[:2] = reference.PAPER_UPPER, reference.PAPER_LOWER
    return vectors


def repaired_terms(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Input and output terms (count, 5, 3) by the reference's own repair."""
    low, high = reference.PAPER_LOWER, reference.PAPER_UPPER
    inputs, outputs = zip(*(reference.repair(k, low, high) for k in vectors), strict=True)
    return np.array(inputs), np.array(outputs)


def fuzzy(
    inputs: ArrayLike, outputs: ArrayLike, dtype: str = "float64", **options: Any
) -> FuzzyController:
    """A controller, with the paper's rules unless others are given."""
    terms = (jnp.asarray(np.asarray(t, np.float64), dtype) for t in (inputs, outputs))
    return FuzzyController(*terms, **{"rules": RULES, "output_range": (0.0, 100.0)} | options)


INPUTS, OUTPUTS = (terms[0] for terms in repaired_terms(search_vectors(1, seed=5)))
"""Ordinary terms."""
GAPPED = [[0, 0, 0.1], [0.2, 0.2, 0.3], [0.25, 0.4, 0.6], [0.5, 0.6, 0.8], [0.7, 1, 1]]
"""Input terms for which no rule fires in (0.1, 0.2)."""


def evaluated(controller: FuzzyController, error: object, rate: object, *last: float) -> np.ndarray:
    """Gains, in the controller's dtype, for errors and rates of any type."""
    dtype = controller.output_terms.dtype
    return np.asarray(controller(*(jnp.asarray(x, dtype) for x in (error, rate, *last))))


@cache
def compiled_gain() -> Callable[..., Array]:
    """Gains (B,) for terms (B, 5, 3), errors and rates (B,)."""
    return jax.jit(jax.vmap(lambda i, o, e, r: FuzzyController(i, o, RULES, (0.0, 100.0))(e, r)))


def gains_of(*arrays: np.ndarray) -> np.ndarray:
    return np.asarray(compiled_gain()(*(jnp.asarray(a) for a in arrays)))
