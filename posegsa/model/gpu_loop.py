"""A loop over time as one GPU kernel: each thread keeps the state of one agent over all steps.

XLA runs `lax.scan` on a GPU as a few dozen kernels a step, one after another, which pass the state
through memory. On an H200 the 1500 steps of the paper's observer take 74 ms so, for 100 agents as
for 10 000, and 2.4 ms as one kernel (docs/benchmarks.md).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

THREADS = 32
"""Agents in one block of the kernel: a warp, so that few agents already use many processors."""
KNOWN = {
    *("abs", "add", "div", "integer_pow", "mul", "neg", "pow", "rsqrt", "sign", "sqrt", "square"),
    *("sub", "atan2", "cos", "exp", "log", "sin", "tan", "tanh", "floor", "max", "min"),
    *("eq", "ge", "gt", "le", "lt", "ne", "and", "not", "or", "xor", "is_finite", "select_n"),
    *("broadcast_in_dim", "convert_element_type", "reshape", "jit", "pjit"),
}
"""Operations that a kernel may have: elementwise ones that Pallas lowers by Triton."""
MOST_OPERATIONS = 4000
"""In the step of a kernel. The paper's observer has 1200 and compiles in 15 s, with vector biases
2100 in a minute; a Kalman filter of 18 states has 8500, which took over three minutes."""


def on_gpu() -> bool:
    """Whether JAX runs on GPUs."""
    return jax.default_backend() == "gpu"


def last_of_scan(step: Callable[[Any, list[Array]], Any], start: Any, rows: Array) -> Any | None:
    """The loop `start = step(start, rows[k])` over all k as one kernel, if a kernel can run it.

    Derivatives and `vmap` are those of `lax.scan`; `vmap` runs a block for each lane.

    Args:
        step: elementwise, over agents (THREADS,).
        start: leaves (THREADS,).
        rows: (N, n) numbers of each step, passed as n scalars.

    Returns:
        The last carry. None if the step has more than MOST_OPERATIONS or others than
        those that are KNOWN, an array in it is neither a scalar nor one number of each agent, or
        the carry or a constant is not floating.
    """
    carry, structure = jax.tree.flatten(start)
    width = rows.shape[1]

    def flat(carry: list[Array], row: list[Array]) -> list[Array]:
        return jax.tree.leaves(step(jax.tree.unflatten(structure, carry), row))

    if any(jnp.shape(leaf) != (THREADS,) for leaf in carry):
        return None
    traced = jax.make_jaxpr(flat)(carry, [rows[0, i] for i in range(width)])
    operations, kinds = _operations(traced), [(a.shape, a.dtype) for a in carry]
    shapes = {jnp.shape(v.aval) for one in operations for v in one.outvars}
    if not (
        all(jnp.issubdtype(a.dtype, jnp.floating) for a in (*traced.consts, *carry))
        and {jnp.shape(a) for a in traced.consts} <= {(), (THREADS,)}
        and [(a.shape, a.dtype) for a in traced.out_avals] == kinds  # nothing is stored
        and shapes <= {(), (1,), (THREADS,)}
        and {one.primitive.name for one in operations} <= KNOWN
        and len(operations) <= MOST_OPERATIONS
    ):
        return None

    def at(consts: list[Array], carry: list[Array], row: list[Array]) -> list[Array]:
        # A kernel must not refer to arrays outside of it, so they become its inputs.
        return jaxpr_as_fun(ClosedJaxpr(traced.jaxpr, consts))(*carry, *row)

    @jax.custom_jvp
    def loop(consts: list[Array], carry: list[Array], rows: Array) -> list[Array]:
        return _kernel(at, consts, carry, rows)

    @loop.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        return jax.jvp(scanned, primals, tangents)

    def scanned(consts: list[Array], carry: list[Array], rows: Array) -> list[Array]:
        def body(carry: list[Array], row: Array) -> tuple[list[Array], None]:
            return at(consts, carry, list(row)), None

        return lax.scan(body, carry, rows)[0]

    return jax.tree.unflatten(structure, loop(list(traced.consts), carry, rows))


def _operations(traced: ClosedJaxpr) -> list[Any]:
    """All operations, those of functions within too."""
    within = [p for one in traced.eqns for p in one.params.values() if isinstance(p, ClosedJaxpr)]
    return [*traced.eqns, *(one for each in within for one in _operations(each))]


def _kernel(
    at: Callable[[list[Array], list[Array], list[Array]], list[Array]],
    consts: list[Array],
    carry: list[Array],
    rows: Array,
) -> list[Array]:
    # Imported here, as it takes a third of a second and nothing else needs it.
    from jax.experimental import pallas as pl
    from jax.experimental.pallas import triton

    steps, width = rows.shape
    inputs = [jnp.reshape(a, (-1,)) for a in (*consts, *carry)]

    def kernel(*refs: Any) -> None:
        given, (numbers, *results) = refs[: len(inputs)], refs[len(inputs) :]
        read = [ref[...] if ref.shape[0] > 1 else ref[0] for ref in given]
        fixed, begin = read[: len(consts)], read[len(consts) :]

        def body(k: Array, carry: list[Array]) -> list[Array]:
            return at(fixed, carry, [numbers[k, i] for i in range(width)])

        last = lax.fori_loop(0, steps, body, begin)
        for ref, value in zip(results, last, strict=True):
            ref[...] = value

    return pl.pallas_call(
        kernel,
        out_shape=[jax.ShapeDtypeStruct(a.shape, a.dtype) for a in carry],
        interpret=not on_gpu(),  # in tests
        compiler_params=triton.CompilerParams(num_warps=THREADS // 32, num_stages=1),
    )(*inputs, rows)
