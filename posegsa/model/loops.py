"""`lax.scan` over time, at a price for each step that does not grow with the number of steps."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.model.elementwise import choose

LONGEST_LOOP = 256
"""Steps of a loop that stores something, at most; more are several loops inside each other."""

Step = Callable[[Any, Any], tuple[Any, Any]]
"""Maps what is carried and a step's input to what is carried on and what is stored."""


def scan_rows(step: Step, start: Any, inputs: Any, count: Array | None = None) -> tuple[Any, Any]:
    """`scan` over inputs with leaves (N, ...), all of one shape, which travel as one array.

    A step then takes its numbers by one slice. Were they some fifty arrays, XLA would fuse a slice
    of each into the loops over agents, and LLVM does not vectorise a loop that looks up its own
    index: 2.3 times slower on CPUs.
    """
    leaves, structure = jax.tree.flatten(inputs)
    rows = jnp.stack(leaves, axis=-1)

    def on_row(carry: Any, row: Array) -> tuple[Any, Any]:
        return step(carry, jax.tree.unflatten(structure, [row[i] for i in range(len(leaves))]))

    return scan(on_row, start, rows, count)


def scan_together(
    step: Step, start: Any, inputs: Any, count: Array | None = None
) -> tuple[Any, Any]:
    """`scan_rows` of S simulations at once: inputs have leaves (S, N), what is carried (S, ...).

    The step is one simulation's; it stores at least one number, all of one dtype, and what is
    stored of all has leaves (S, N). `vmap` of `scan_rows` gives the same, but there the n numbers
    of a step lie in memory as (S, n), where one number of all simulations is no vector, and each
    number is stored by itself: three times slower on CPUs. Here they lie as (n, S).
    """
    leaves, structure = jax.tree.flatten(inputs)
    rows = jnp.stack([leaf.T for leaf in leaves], axis=1)

    def on_row(carry: Any, row: Array) -> tuple[Any, Any]:
        return step(carry, jax.tree.unflatten(structure, [row[i] for i in range(len(leaves))]))

    def on_rows(carries: Any, rows: Array) -> tuple[Any, Array]:
        after, stored = jax.vmap(on_row, in_axes=(0, 1))(carries, rows)
        return after, jnp.stack(jax.tree.leaves(stored))

    _, what = jax.eval_shape(jax.vmap(on_row, in_axes=(0, 1)), start, rows[0])
    last, stored = scan(on_rows, start, rows, count)
    each = [stored[:, i].T for i in range(stored.shape[1])]
    return last, jax.tree.unflatten(jax.tree.structure(what), each)


def scan(step: Step, start: Any, inputs: Any, count: Array | None = None) -> tuple[Any, Any]:
    """`lax.scan` over inputs with leaves (N, ...), cut into loops where steps store something.

    XLA:CPU with the fast path's options (`runtime`) copies all that a loop stores at every step. So
    the loop is cut into a few loops inside each other, each of so few steps that this does not
    matter. Inputs are added to fill the last one up; they change nothing, and neither do those
    from `count` on, if it is given.
    """
    first = jax.tree.map(lambda a: a[0], inputs)
    _, (_, stored) = jax.eval_shape(lambda: (None, step(start, first)))
    given = jax.tree.leaves(inputs)[0].shape[0]
    lengths = _loop_lengths(given) if jax.tree.leaves(stored) else [given]
    if len(lengths) == 1 and count is None:
        return lax.scan(step, start, inputs)
    full = math.prod(lengths)
    until = given if count is None else count

    def filled(a: Array) -> Array:
        more = jnp.broadcast_to(a[-1:], (full - given, *a.shape[1:]))
        return jnp.concatenate([a, more]).reshape(*lengths, *a.shape[1:])

    def innermost(carry: Any, numbered: Any) -> tuple[Any, Any]:
        number, one = numbered
        after, stored = step(carry, one)
        return jax.tree.map(lambda a, b: choose(number < until, a, b), after, carry), stored

    def within(inner: Step) -> Step:
        return lambda carry, part: lax.scan(inner, carry, part)

    nested: Step = innermost
    for _ in lengths[1:]:
        nested = within(nested)
    numbers = jnp.arange(full, dtype=jnp.int32).reshape(lengths)
    last, stored = lax.scan(nested, start, (numbers, jax.tree.map(filled, inputs)))
    return last, jax.tree.map(lambda a: a.reshape(full, *a.shape[len(lengths) :])[:given], stored)


def _loop_lengths(count: int) -> list[int]:
    """Lengths of as few loops inside each other as keep to LONGEST_LOOP, for `count` steps."""
    depth = 1
    while LONGEST_LOOP**depth < count:
        depth += 1
    lengths = []
    for level in range(depth, 0, -1):
        lengths.append(math.ceil(count ** (1 / level)))
        count = math.ceil(count / lengths[-1])
    return lengths
