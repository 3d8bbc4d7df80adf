"""Normal numbers by rows: those of `jax.random.normal`, from any row on.

What is long is drawn in pieces, and which pieces these are must not change what is drawn.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.extend.random import threefry_2x32
from jax.typing import ArrayLike

from posegsa.arguments import refuse

_MANTISSA, _ONE = np.uint32(9), np.float32(1.0).view(np.uint32)
_LOWEST = np.nextafter(np.float32(-1), np.float32(0))


def normal_rows(key: Array, first: ArrayLike, rows: int, *shape: int) -> Array:
    """Rows of standard normal numbers (pure, jittable).

    Args:
        key: A key of the generator "threefry2x32" (`jax.random.key`).
        first: Number of the first row.
        rows: How many.
        shape: Of each row.

    Returns:
        (rows, *shape) in float32: those of `jax.random.normal(key, (n, *shape), jnp.float32)`
        from row `first` on, whatever n, where JAX's option `jax_threefry_partitionable` has its
        default: number i is the generator's for the counter i (Salmon et al. 2011).

    Raises:
        ArgumentError: The key is another generator's.
    """
    words = jax.random.key_data(key)
    if words.shape != (2,):
        refuse(f"key of {words.shape} words", 'one of the generator "threefry2x32"')
    width = math.prod(shape)
    index = lax.iota(jnp.uint32, rows * width)
    index = index + jnp.asarray(first).astype(jnp.uint32) * np.uint32(width)
    counters = jnp.concatenate([jnp.zeros_like(index), index])
    high, low = jnp.split(threefry_2x32(words, counters), 2)
    # 23 random bits after the point of a number in [1, 2), moved to (-1, 1).
    bits = lax.shift_right_logical(high ^ low, _MANTISSA) | _ONE
    unit = lax.bitcast_convert_type(bits, jnp.float32) - np.float32(1)
    uniform = lax.max(_LOWEST, unit * (np.float32(1) - _LOWEST) + _LOWEST)
    return (np.float32(math.sqrt(2)) * lax.erf_inv(uniform)).reshape(rows, *shape)
