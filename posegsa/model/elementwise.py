"""Elementwise operations of the hot loop, each with as few vector instructions as possible.

`minimum` and `maximum` differ from their namesakes in `jax.numpy` at NaN and at ties:
`jnp.minimum` propagates NaN, which takes three instructions, and splits the derivative between
equal arguments. All three functions are single XLA operations, whereas `jnp.where` is a function
that JAX traces at each call.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike, DTypeLike

T = TypeVar("T")


def choose(condition: ArrayLike, a: ArrayLike, b: ArrayLike) -> Array:
    """`a` where the condition holds, else `b`: arrays of one dtype, or Python numbers."""
    dtype = next((x.dtype for x in (a, b) if isinstance(x, Array)), jnp.result_type(a, b))
    shape = np.broadcast_shapes(np.shape(condition), np.shape(a), np.shape(b))
    return lax.select(_to(condition, shape, bool), _to(a, shape, dtype), _to(b, shape, dtype))


def minimum(a: Array | float, b: Array | float) -> Array:
    """The smaller of a and b, in one instruction; b and its derivative if equal or if a is NaN."""
    return choose(a < b, a, b)


def maximum(a: Array, b: ArrayLike) -> Array:
    """The larger of a and b, in one instruction; b and its derivative if equal or if a is NaN."""
    return choose(a > b, a, b)


def only_if(condition: Array, change: Callable[[T], T], carry: T) -> T:
    """A carry, changed where the condition holds; else the change is not computed.

    For a condition of many it is computed for all, and chosen. Exported C has an `if`.
    """
    if jnp.ndim(condition):
        return jax.tree.map(partial(choose, condition), change(carry), carry)
    return lax.cond(condition, change, lambda unchanged: unchanged, carry)


def as_long_as(condition: Callable[[T], Array], change: Callable[[T], T], carry: T, most: int) -> T:
    """A carry that is changed as long as a condition of it holds, at most `most` times.

    Of many each is changed as long as its own condition holds; the change is computed for all as
    long as one holds. Exported C has a `while`.

    Args:
        condition: of a carry; () or of the batch shape.
        change: maps a carry to the next one.
        carry: the first one; its first leaf is of a floating type, in which changes are counted.
        most: the largest number of changes.
    """

    def goes_on(counted: tuple[Array, T]) -> Array:
        count, carry = counted
        holds = condition(carry)
        return (count < most) & (jnp.any(holds) if jnp.ndim(holds) else holds)

    def changed(counted: tuple[Array, T]) -> tuple[Array, T]:
        count, carry = counted
        after, holds = change(carry), condition(carry)
        if jnp.ndim(holds):
            after = jax.tree.map(partial(choose, holds), after, carry)
        return count + 1, after

    first = jax.tree.leaves(carry)[0]
    return lax.while_loop(goes_on, changed, (jnp.zeros((), first.dtype), carry))[1]


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
