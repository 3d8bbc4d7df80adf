"""Calls of a filter's functions, with checks of what they return.

The functions may be a user's. They are called while a program is traced, so that the checks cost
nothing when it runs.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from posegsa.arguments import made_of_jax, refuse
from posegsa.filters.base import Filter, ReadyFilter, Record, Samples, Sensors
from posegsa.model.estimate import FilterState

T = TypeVar("T")


def started(filter: Filter, initial: FilterState, sensors: Sensors) -> Any:
    """The state before the first sample; Python numbers in it become arrays.

    Raises:
        ArgumentError: The state holds something else than numbers, or the function uses their
            values outside JAX; names the function.
    """
    name = f"{type(filter).__name__}.start"
    with made_of_jax(name, "the initial estimate"):
        state = filter.start(initial, sensors)
    return _arrays(f"{name}: its state", state, jnp.result_type(initial.place[0]))


def stepped(
    ready: ReadyFilter, state: Any, now: Samples, shape: tuple[int, ...] = ()
) -> tuple[Any, Record]:
    """The state at the next sample, and the record of this one.

    `shape` is the shape of a number of many simulations at once, for an `elementwise` filter.

    Raises:
        ArgumentError: The function does not return both, or a state that differs in structure,
            shapes or types from the one given, or uses values outside JAX; names the function.
    """
    name = f"{type(ready).__name__}.step"
    with made_of_jax(name, "the state or the sample"):
        returned = ready.step(state, now)
    both = "(state, record), the state at the next sample and a Record, such as Record()"
    if not isinstance(returned, tuple) or len(returned) != 2:
        refuse(f"{name}: returns a {type(returned).__name__}", both)
    after, record = returned
    if not isinstance(record, Record):
        refuse(f"{name}: its record is a {type(record).__name__}", both)
    after = _arrays(f"{name}: its state", after, jnp.result_type(now.time))
    after = of_shape(after, shape)
    _check_alike(name, state, after)
    return after, of_shape(record, shape)


def estimated(ready: ReadyFilter, state: Any) -> FilterState:
    """The pose and biases in a state.

    Raises:
        ArgumentError: The function does not return a FilterState by components, or uses values
            outside JAX; names the function.
    """
    name = f"{type(ready).__name__}.estimate"
    with made_of_jax(name, "the state"):
        found = ready.estimate(state)
    allowed = "a FilterState: a quaternion of four scalars, and three vectors of three"
    if not isinstance(found, FilterState):
        refuse(f"{name}: returns a {type(found).__name__}", allowed)
    lengths = [len(each) if isinstance(each, tuple | list) else 0 for each in found[:4]]
    if lengths != [4, 3, 3, 3]:
        fields = zip(FilterState._fields, lengths, strict=False)
        parts = (f"{length or 'no tuple'} ({field})" for field, length in fields)
        refuse(f"{name}: returns components {', '.join(parts)}", allowed)
    own = [leaf for leaf in jax.tree.leaves(found) if hasattr(leaf, "dtype")]
    return _arrays(f"{name}: its estimate", found, jnp.result_type(*own or [float]))


def of_shape(tree: T, shape: tuple[int, ...]) -> T:
    """A pytree whose scalars, the same in all simulations, have the shape of the others."""
    if not shape:
        return tree
    return jax.tree.map(lambda a: a if np.ndim(a) else jnp.broadcast_to(a, shape), tree)


def _arrays(what: str, tree: Any, dtype: DTypeLike) -> Any:
    """A pytree whose Python numbers are arrays, fractions at a dtype."""

    def array(leaf: Any) -> Any:
        if isinstance(leaf, bool | int | float):
            return jnp.asarray(leaf, dtype if isinstance(leaf, float) else None)
        if not isinstance(leaf, Array | np.ndarray | np.generic):
            refuse(
                f"{what} holds a {type(leaf).__name__}",
                "numbers, in tuples and classes that JAX knows (NamedTuple, "
                "jax.tree_util.register_dataclass)",
            )
        return leaf

    return jax.tree.map(array, tree)


def _check_alike(name: str, before: Any, after: Any) -> None:
    """Raise an ArgumentError unless the state of a step is like the one before it."""
    was, now = (
        {
            f"state{jax.tree_util.keystr(path)}": jax.typeof(leaf)
            for path, leaf in jax.tree_util.tree_leaves_with_path(state)
        }
        for state in (before, after)
    )
    allowed = "a state of the same structure, shapes and types as that of `start`"
    for place in {**was, **now}:
        old, new = was.get(place), now.get(place)
        if old is None or new is None:
            refuse(f"{name}: {place} is in the state {'after' if new else 'before'} it", allowed)
        same = old.weak_type or old.dtype == new.dtype
        if old.shape != new.shape or not same:
            refuse(f"{name}: {place} is {old.str_short()} before, {new.str_short()} after", allowed)
    if jax.tree.structure(before) != jax.tree.structure(after):
        refuse(f"{name}: its state has other classes than the one before", allowed)
