"""The box that is searched; optimisers see it as the unit box."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.arguments import real_array, refuse


class Box(NamedTuple):
    """A box to search in; `box` builds a checked one."""

    lower: Array  # (dimensions,)
    upper: Array  # (dimensions,); equal to lower where a coordinate is fixed


def box(lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike) -> Box:
    """Build a box and check it; outside jit only.

    Args:
        lower: Smallest value of each coordinate, (dimensions,).
        upper: Largest value of each coordinate, (dimensions,). A coordinate whose two bounds are
            equal is fixed at that value.

    Returns:
        The box, in the bounds' own floating type as far as JAX has it; the search runs in that.

    Raises:
        ArgumentError: If the bounds are not numbers of one equal length of at least 1, if one is
            not finite in their type, or if a lower bound lies above its upper one.
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
    """Map positions (..., d) in the unit box into `box`, never past its bounds.

    0 and 1 give the bounds exactly, and a box of zero width its value.
    """
    lower = jnp.broadcast_to(box.lower, unit.shape)
    upper = jnp.broadcast_to(box.upper, unit.shape)
    return jnp.clip(lower * (1 - unit) + upper * unit, lower, upper)


def to_unit(box: Box, position: Array) -> Array:
    """Map a position (d,) in the box into the unit box; 0 where the box has no width."""
    width = box.upper - box.lower
    return jnp.clip((position - box.lower) / jnp.where(width > 0, width, 1), 0, 1)
