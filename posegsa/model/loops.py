"""`lax.scan` over time whose cost per step does not grow with the number of steps."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.model.elementwise import choose
from posegsa.model.gpu_loop import last_of_scan, on_gpu

LONGEST_LOOP, LONGEST_TOGETHER = 8, 256
"""Maximum number of steps in a loop that stores something, of one simulation and of many; longer
loops are nested. Shorter loops copy less, and padding wastes more: up to a quarter of the steps
with 8. The steps of many simulations take longer than the copies, so their loops may be longer."""

Step = Callable[[Any, Any], tuple[Any, Any]]
"""Maps the carry and a step's input to the new carry and what is stored, as in `lax.scan`."""


def scan_rows(step: Step, start: Any, inputs: Any, count: Array | None = None) -> tuple[Any, Any]:
    """`scan` over inputs with leaves (N, ...), all of one shape, packed into one array.

    Each step then reads its numbers with one slice. With some fifty separate arrays XLA fuses one
    slice per array into the loops over agents, and LLVM does not vectorise those: 2.3 times slower
    on CPUs.
    """
    step = jax.jit(step)  # traced once, for its shapes and for the loop; XLA inlines it
    leaves, structure = jax.tree.flatten(inputs)
    rows = jnp.stack(leaves, axis=-1)
    if on_gpu() and count is None:

        def after(carry: Any, row: list[Array]) -> tuple[Any, Any]:
            return step(carry, jax.tree.unflatten(structure, row))

        last = last_of_scan(after, start, rows)
        if last is not None:
            return last, None

    def on_row(carry: Any, row: Array) -> tuple[Any, Any]:
        return step(carry, jax.tree.unflatten(structure, _along(row, 0)))

    return scan(on_row, start, rows, count)


def scan_lanes(step: Step, start: Any, inputs: Any) -> tuple[Any, Any]:
    """`scan_rows` of S sequences, each for A lanes of the carry: inputs (S, N), the carry (S A,).

    `vmap` of `scan_rows` has two axes, for which XLA nests two loops. They compute the address of
    each array anew for each sequence: with 32 agents a Kalman filter took 1.8 times as long.
    """
    step = jax.jit(step)  # traced once, for its shapes and for the loop; XLA inlines it
    leaves, structure = jax.tree.flatten(inputs)
    rows = jnp.stack([leaf.T for leaf in leaves], axis=1)
    each = jax.tree.leaves(start)[0].shape[0] // rows.shape[2]

    def on_rows(carry: Any, rows: Array) -> tuple[Any, Any]:
        # The barrier stores them: fused into what uses them, loops would have two axes again.
        every = lax.optimization_barrier(jnp.repeat(rows, each, axis=1))
        return step(carry, jax.tree.unflatten(structure, _along(every, 0)))

    return scan(on_rows, start, rows)


def scan_together(
    step: Step, start: Any, inputs: Any, count: Array | None = None
) -> tuple[Any, tuple[Any, Any]]:
    """`scan_rows` of S simulations at once: inputs have leaves (S, N), the carry (S, ...).

    `step` handles one sample of all simulations, leaves (S,). It stores a pair: numbers of each
    simulation and numbers that are kept of the first one only; each of them has leaves (S,) of one
    dtype, at least one. They are returned as leaves (S, N) and (N,). `vmap` of `scan_rows` gives
    the same results three times slower on CPUs: it lays the n numbers of a step out as (S, n), so
    that one number of all simulations is not contiguous. Here the layout is (n, S).
    """
    step = jax.jit(step)  # traced once, for its shapes and for the loop; XLA inlines it
    leaves, structure = jax.tree.flatten(inputs)
    rows = jnp.stack([leaf.T for leaf in leaves], axis=1)

    def on_rows(carry: Any, rows: Array) -> tuple[Any, Any]:
        after, (each, of_first) = step(carry, jax.tree.unflatten(structure, _along(rows, 0)))
        first = [leaf[0] for leaf in jax.tree.leaves(of_first)]
        return after, (jnp.stack(jax.tree.leaves(each)), jnp.stack(first))

    one = jax.tree.unflatten(structure, _along(rows[0], 0))
    _, what = jax.eval_shape(step, start, one)
    last, stored = scan(on_rows, start, rows, count, LONGEST_TOGETHER)
    each, of_first = (
        jax.tree.unflatten(jax.tree.structure(tree), _along(numbers, 1))
        for tree, numbers in zip(what, stored, strict=True)
    )
    return last, (jax.tree.map(jnp.transpose, each), of_first)


def _along(a: Array, axis: int) -> list[Array]:
    """The parts of an array along an axis, one by one."""
    count = a.shape[axis]
    return [lax.index_in_dim(a, i, axis, keepdims=False) for i in range(count)]


def scan(
    step: Step, start: Any, inputs: Any, count: Array | None = None, longest: int = LONGEST_LOOP
) -> tuple[Any, Any]:
    """`lax.scan` over inputs with leaves (N, ...), as nested loops if steps store something.

    With the fast path's options (`runtime`) XLA:CPU copies everything that a loop stores at every
    step. Nested loops of few steps each keep those copies small. The last loop is padded; the
    padding changes nothing, and neither do the inputs from `count` on, if it is given. No loop has
    more than `longest` steps.
    """
    first = jax.tree.map(lambda a: a[0], inputs)
    _, (_, stored) = jax.eval_shape(lambda: (None, step(start, first)))
    given = jax.tree.leaves(inputs)[0].shape[0]
    lengths = _loop_lengths(given, longest) if jax.tree.leaves(stored) else [given]
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


def batched_alike(carry: Any, others: Any) -> Any:
    """A carry with the same values; `vmap` batches all its leaves if it batches any of the inputs.

    Otherwise `vmap` of a loop finds out which leaves differ between agents by tracing the batched
    step repeatedly, up to eight times for a Kalman filter. XLA removes the `choose` operations that
    this adds.

    Args:
        carry: floating, whole or boolean leaves of any shape.
        others: arrays that the step uses, of any shape.
    """
    leaves, structure = jax.tree.flatten(carry)
    one: Any = leaves[0]
    for leaf in (*leaves[1:], *jax.tree.leaves(others)):
        number = lax.slice(jnp.ravel(leaf), (0,), (1,)) if jnp.ndim(leaf) else leaf
        one = choose(True, one, jnp.reshape(number, ()).astype(one.dtype))
    return jax.tree.unflatten(structure, [choose(True, a, one.astype(a.dtype)) for a in leaves])


def _loop_lengths(count: int, longest: int) -> list[int]:
    """Lengths of nested loops for `count` steps, as few loops as `longest` allows."""
    depth = 1
    while longest**depth < count:
        depth += 1
    lengths = []
    for level in range(depth, 0, -1):
        lengths.append(math.ceil(count ** (1 / level)))
        count = math.ceil(count / lengths[-1])
    return lengths
