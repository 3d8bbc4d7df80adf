"""A loop over the sensors of one kind, within a time step.

On a CPU it is a `lax.scan`, compiled once, which becomes a loop in exported C too. A GPU kernel
can't index the arrays of such a loop (`model.gpu_loop`), so there the step is written out for each
sensor; XLA's own loops over time are a third faster so too.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.model.gpu_loop import on_gpu

_KEPT = ContextVar("kept", default=False)


@contextmanager
def kept_as_loops() -> Iterator[None]:
    """Within it loops stay loops on a GPU too: what is traced becomes C."""
    token = _KEPT.set(True)
    try:
        yield
    finally:
        _KEPT.reset(token)


class _Several:
    """One number of each sensor, side by side; JAX takes it for one leaf."""

    def __init__(self, each: Sequence[Array]) -> None:
        self.each = each


def stacked(sensors: Iterable[Any]) -> Any:
    """Sensors of one kind, trees of one structure, together for `in_turn`."""
    join = _Several if on_gpu() and not _KEPT.get() else jnp.stack
    return jax.tree.map(lambda *leaves: join(leaves), *sensors)


def in_turn(step: Callable[[Any, Any], tuple[Any, Any]], carry: Any, sensors: Any) -> Any:
    """`lax.scan(step, carry, sensors)` over `stacked` sensors; what it returns is stacked too."""
    leaves = jax.tree.leaves(sensors)
    if not isinstance(leaves[0], _Several):
        return lax.scan(step, carry, sensors)
    found = []
    for sensor in apart(sensors, len(leaves[0].each)):
        carry, one = step(carry, sensor)
        found.append(one)
    return carry, stacked(found)


def apart(sensors: Any, count: int) -> tuple[Any, ...]:
    """The inverse of `stacked`, for `count` sensors."""

    def one(leaf: Any, i: int) -> Array:
        if isinstance(leaf, _Several):
            return leaf.each[i]
        return lax.index_in_dim(leaf, i, keepdims=False)

    return tuple(jax.tree.map(lambda leaf, i=i: one(leaf, i), sensors) for i in range(count))
