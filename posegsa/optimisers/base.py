"""The search box, and the ask/tell protocol that every optimiser keeps."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, random
from jax.typing import ArrayLike, DTypeLike

from posegsa.optimisers.checks import real_array, refuse

Objective = Callable[[Array], Array]
"""Maps positions (agents, dimensions), in the box's coordinates, to costs (agents,)."""

FailureCost = Literal["largest", "worst so far", "worst now"]
"""What an optimiser is told of a position whose cost is not finite; see `Optimiser`."""


class Box(NamedTuple):
    """A box to search in; `box` builds a checked one."""

    lower: Array  # (dimensions,)
    upper: Array  # (dimensions,); equal to lower where a coordinate is fixed


class Asking(Protocol):
    """What optimisers of both kinds share; positions lie in the unit box.

    An implementation is frozen and hashable, so that it can be static in a compiled function.
    """

    @property
    def agents(self) -> int:
        """Number of positions asked for at once."""
        ...

    @property
    def iterations(self) -> int:
        """Number of iterations that a whole search takes."""
        ...

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> Any:
        """Return the state before the first `ask`; it carries the key."""
        ...

    def ask(self, state: Any) -> Array:
        """Return the positions (agents, dimensions) in [0, 1] whose costs are wanted next."""
        ...


class Optimiser(Asking, Protocol):
    """Settings with three pure methods over an immutable state.

    The costs it is told are finite: the loop (`posegsa.optimisers.loop`) sees to that. What stands
    for one that is not must never pass for a good one, now or later. An optimiser may say by a
    class attribute `failure_cost` what that takes:

        "largest": the largest finite number, for one that does nothing but compare costs.
        "worst so far": a little more than the worst finite cost of the whole search, and before
            any some 1e15 (in float64 1e123), for one that keeps costs and calculates with them.
            This is the default.
        "worst now": the worst finite cost of the iteration, for one that keeps none: an old, high
            cost would make all of these look alike. Where they are equal it is a little more.
    """

    def tell(self, state: Any, costs: Array) -> Any:
        """Return the state after learning the costs (agents,) of the positions asked for."""
        ...


class GradientOptimiser(Asking, Protocol):
    """The same for an optimiser that needs gradients; they are finite too."""

    @property
    def gradient_price(self) -> int:
        """How many evaluations a cost with its gradient counts as."""
        ...

    def tell(self, state: Any, costs: Array, gradients: Array) -> Any:
        """Return the state after learning costs (agents,) and their gradients.

        The gradients (agents, dimensions) are with respect to the positions in the unit box.
        """
        ...


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
    """Map positions in the unit box into `box`, never past its bounds.

    Args:
        box: The target box of d coordinates.
        unit: Positions (..., d) in [0, 1].

    Returns:
        Positions (..., d); 0 and 1 give the bounds exactly, and a box of zero width its value.
    """
    lower = jnp.broadcast_to(box.lower, unit.shape)
    upper = jnp.broadcast_to(box.upper, unit.shape)
    return jnp.clip(lower * (1 - unit) + upper * unit, lower, upper)


def uniform(key: Array, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Draw from [0, 1) in float32 and cast, so that a key means the same in every dtype."""
    return random.uniform(key, shape, jnp.float32).astype(dtype)
