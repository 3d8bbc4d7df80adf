"""Arrays: conversion to a dtype, and comparison to the last bit."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def epsilon(dtype: type[np.floating]) -> float:
    return float(np.finfo(dtype).eps)


def as_arrays(tree: Any, dtype: Any) -> Any:
    """Every leaf as a JAX array of this dtype."""
    return jax.tree.map(lambda a: jnp.asarray(a, dtype), tree)


def assert_same(a: Any, b: Any) -> None:
    """Check that two trees of arrays are equal to the last bit; NaN equals NaN."""

    def check(x: Array, y: Array) -> None:
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)

    assert jax.tree.structure(a) == jax.tree.structure(b)
    jax.tree.map(check, a, b)
