"""The box to search; optimisers get it scaled to the unit box."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.arguments import real_array, refuse


class Box(NamedTuple):
    """A box to search; `box` builds a checked one."""

    lower: Array  # (dimensions,)
    upper: Array  # (dimensions,); equal to lower if a coordinate is fixed


def box(lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike) -> Box:
    """Build a box and check it; only outside jit.

    Args:
        lower: Smallest value of each coordinate, (dimensions,).
        upper: Largest value of each coordinate, (dimensions,). A coordinate whose two bounds are
            equal is fixed at that value.

    Returns:
        The box, in the floating type of the bounds if JAX has it; the search runs in this type.

    Raises:
        ArgumentError: The bounds are not numbers of equal length, at least 1; one is not finite in
            their type; or a lower bound is above its upper bound.
    """
    low, high = (real_array(f"box: {n}", a) for n, a in (("lower", lower), ("upper", upper)))
    dtype = jax.dtypes.canonicalize_dtype(np.result_type(low, high, np.float32))
    with np.errstate(over="ignore"):
        low, high = low.astype(dtype), high.astype(dtype)
    for name, bound in (("lower", low), ("upper", high)):
        if bound.ndim != 1 or bound.size == 0:
            refuse(f"box: {name} has shape {bound.shape}", "(dimensions,), dimensions >= 1")
        for i in np.flatnonzero(~np.isfinite(bound)):
            refuse(f"box: {name}[{i}] = {bound[i]}", f"a finite {dtype} number")
    if low.shape != high.shape:
        refuse(f"box: lower has shape {low.shape}, upper {high.shape}", "equal shapes")
    for i in np.flatnonzero(low > high):
        refuse(f"box: lower[{i}] = {low[i]}, upper[{i}] = {high[i]}", "lower <= upper")
    return Box(jnp.asarray(low), jnp.asarray(high))


def from_unit(box: Box, unit: Array) -> Array:
    """Map positions (..., d) in the unit box into `box`, never outside its bounds.

    0 and 1 give the bounds exactly; a coordinate of zero width gives its value.
    """
    lower = jnp.broadcast_to(box.lower, unit.shape)
    upper = jnp.broadcast_to(box.upper, unit.shape)
    return jnp.clip(lower * (1 - unit) + upper * unit, lower, upper)


def to_unit(box: Box, position: Array) -> Array:
    """Map a position (d,) in the box into the unit box; 0 where the width is 0."""
    width = box.upper - box.lower
    return jnp.clip((position - box.lower) / jnp.where(width > 0, width, 1), 0, 1)
