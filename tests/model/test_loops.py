"""Loops over many steps: the same as one `lax.scan`, however they are split."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array, lax

from posegsa.model.loops import (
    LONGEST_LOOP,
    LONGEST_TOGETHER,
    batched_alike,
    scan,
    scan_lanes,
    scan_rows,
    scan_together,
)


def inputs(count: int) -> dict[str, Array]:
    a, b = np.random.default_rng(0).normal(size=(2, count)).astype(np.float32)
    return {"a": jnp.asarray(a), "b": jnp.asarray(b)}


START = {"sum": jnp.float32(0.5), "count": jnp.int32(3)}


def storing(carry: Any, one: Any) -> tuple[Any, Any]:
    """A step whose result depends on the order of the inputs and on how many there are."""
    after = {"sum": 0.5 * carry["sum"] + one["a"], "count": carry["count"] + 1}
    return after, (carry["sum"] * one["b"], carry["count"])


def silent(carry: Any, one: Any) -> tuple[Any, None]:
    return storing(carry, one)[0], None


@pytest.mark.parametrize("count", [1, 5, 256, 257, 70_000])
def test_loops_inside_each_other_are_one_loop(count: int) -> None:
    @jax.jit
    def each(x: dict[str, Array]) -> list[list[Any]]:
        loops = (lax.scan, scan, scan_rows)
        return [[loop(step, START, x) for loop in loops] for step in (storing, silent)]

    for want, *others in each(inputs(count)):
        for got in others:
            assert jax.tree.structure(got) == jax.tree.structure(want)
            for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
                assert a.shape == b.shape
                assert a.dtype == b.dtype
                # Whole numbers are equal; with others fused multiply-adds may differ.
                np.testing.assert_allclose(a, b, rtol=0 if a.dtype == np.int32 else 1e-5, atol=1e-6)


@pytest.mark.parametrize("until", [257, 100])
def test_simulations_together_are_each_by_itself(until: int) -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 3, 257)).astype(np.float32)
    start = {"sum": jnp.array([0.5, -1.0, 2.0], jnp.float32), "count": jnp.arange(3)}
    given, count = {"a": jnp.asarray(a), "b": jnp.asarray(b)}, jnp.asarray(until)

    def step(carry: Any, one: Any) -> tuple[Any, Any]:
        after, (product, _) = storing(carry, one)
        return after, ({"product": product, "sum": carry["sum"]}, {"product": product})

    last, (stored, of_first) = jax.jit(lambda x: scan_together(step, start, x, count))(given)
    assert stored["sum"].shape == (3, 257)
    np.testing.assert_array_equal(of_first["product"], stored["product"][0])
    for i in range(3):
        own, first = (jax.tree.map(lambda leaf, i=i: leaf[i], tree) for tree in (given, start))
        want_last, (want, _) = lax.scan(step, first, jax.tree.map(lambda leaf: leaf[:until], own))
        for name in ("product", "sum"):
            np.testing.assert_allclose(
                stored[name][i, :until], want[name], rtol=1e-5, atol=1e-6, err_msg=name
            )
        assert last["count"][i] == want_last["count"]
        np.testing.assert_allclose(last["sum"][i], want_last["sum"], rtol=1e-5)


def test_lanes_are_each_a_sequence_by_itself() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 3, 257)).astype(np.float32)
    lanes = 6  # two for each of the three sequences
    start = {"sum": jnp.arange(lanes, dtype=jnp.float32), "count": jnp.arange(lanes)}
    given = {"a": jnp.asarray(a), "b": jnp.asarray(b)}
    last, _ = jax.jit(lambda x: scan_lanes(silent, start, x))(given)
    for lane in range(lanes):
        own = jax.tree.map(lambda leaf, i=lane // 2: leaf[i], given)
        want, _ = lax.scan(silent, jax.tree.map(lambda leaf, i=lane: leaf[i], start), own)
        assert last["count"][lane] == want["count"]
        np.testing.assert_allclose(last["sum"][lane], want["sum"], rtol=1e-5)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("count", [5, 257])
def test_derivatives_go_through(count: int) -> None:
    given = jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), inputs(count))

    def total(x: dict[str, Array], loop: Any) -> Array:
        def step(carry: Array, one: dict[str, Array]) -> tuple[Array, Array]:
            # A step that would be infinite with the padding of the last loop.
            return 0.5 * carry + jnp.sqrt(one["a"] ** 2 + 1e-3), carry * one["b"]

        last, stored = loop(step, jnp.asarray(0.5), x)
        return last + jnp.sum(stored**2)

    def both(x: dict[str, Array], loop: Any) -> Any:
        forward = jax.jvp(lambda x: total(x, loop), (x,), (jax.tree.map(jnp.ones_like, x),))
        return forward, jax.grad(total)(x, loop)

    got, want = (jax.jit(both, static_argnums=1)(given, loop) for loop in (scan, lax.scan))
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 8, 255, 256, 257, 1500, 65_536, 65_537, 10_000_000])
@pytest.mark.parametrize(("longest", "waste"), [(LONGEST_LOOP, 0.25), (LONGEST_TOGETHER, 0.1)])
def test_loops_are_short_and_few_steps_are_made_for_nothing(
    count: int, longest: int, waste: float
) -> None:
    # Traced and never run: the inputs have a shape and no numbers.
    given = {name: jax.ShapeDtypeStruct((count,), np.float32) for name in ("a", "b")}
    program = jax.make_jaxpr(lambda x: scan(storing, START, x, longest=longest))(given)
    lengths = loop_lengths(program.jaxpr)
    assert max(lengths) <= longest
    assert count <= np.prod(lengths) <= (1 + waste) * count + 1
    assert (len(lengths) == 1) == (count <= longest)


def loop_lengths(program: Any) -> list[int]:
    """Lengths of the nested loops of a traced program, the outermost first."""
    for one in program.eqns:
        if one.primitive is lax.scan_p:
            return [one.params["length"], *loop_lengths(one.params["jaxpr"].jaxpr)]
    return []


def test_a_carry_batched_alike_is_unchanged() -> None:
    carry = (jnp.float32(1.5), jnp.arange(3, dtype=jnp.int32), jnp.array([True, False]))

    found = jax.vmap(lambda other: batched_alike(carry, other))(jnp.arange(4.0))

    for leaf, given in zip(found, carry, strict=True):
        assert leaf.dtype == given.dtype
        np.testing.assert_array_equal(leaf, np.stack([given] * 4))


@pytest.mark.parametrize(("alike", "times"), [(True, 1), (False, 6)])
def test_vmap_batches_the_step_of_a_carry_batched_alike_once(alike: bool, times: int) -> None:
    """Each of the carry's five numbers depends on the one before, the first on the agent."""
    batched = 0

    @jax.custom_batching.custom_vmap
    def identity(x: Array) -> Array:
        return x

    @identity.def_vmap
    def _(size: int, which: Any, x: Array) -> Any:
        nonlocal batched
        batched += 1
        return x, which[0]

    def run(agent: Array) -> Array:
        def step(carry: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], None]:
            return (identity(agent), *carry[:-1]), None

        start = (jnp.float32(0),) * 5
        return lax.scan(step, batched_alike(start, agent) if alike else start, None, 9)[0][-1]

    np.testing.assert_array_equal(jax.vmap(run)(jnp.arange(4.0)), np.arange(4.0))

    assert batched == times
