"""Elementwise operations of the hot loop, each as few vector instructions as it can be.

`minimum` and `maximum` differ from their namesakes in `jax.numpy` at NaN and in the derivative at
ties: `jnp.minimum` passes every NaN on, which takes three instructions, and halves the derivative
between equals. All three are one operation of XLA, where `jnp.where` is a call that JAX traces each
time.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike, DTypeLike


def choose(condition: ArrayLike, a: ArrayLike, b: ArrayLike) -> Array:
    """`a` where the condition holds, else `b`; of one dtype, or Python's numbers."""
    dtype = next((x.dtype for x in (a, b) if isinstance(x, Array)), jnp.result_type(a, b))
    shape = np.broadcast_shapes(np.shape(condition), np.shape(a), np.shape(b))
    return lax.select(_to(condition, shape, bool), _to(a, shape, dtype), _to(b, shape, dtype))


def minimum(a: Array | float, b: Array | float) -> Array:
    """The smaller of a and b, one instruction; b, and its derivative, where equal or a is NaN."""
    return choose(a < b, a, b)


def maximum(a: Array, b: ArrayLike) -> Array:
    """The larger of a and b, one instruction; b, and its derivative, where equal or a is NaN."""
    return choose(a > b, a, b)


def _to(x: ArrayLike, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    if np.ndim(x) == 0 and not isinstance(x, Array):
        return lax.full(shape, x, dtype)
    array = x if isinstance(x, Array) else jnp.asarray(x, dtype)
    if array.shape == shape:
        return array
    first = len(shape) - array.ndim
    return lax.broadcast_in_dim(
        lax.reshape(array, (1,) * first + array.shape), shape, tuple(range(len(shape)))
    )
