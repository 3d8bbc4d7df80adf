"""Functions of many scalars as loops over arrays in C: the same numbers, whatever their order."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiled_c import COMPILERS, WARNINGS, needs_cc, sanitizers

from posegsa.export.scalar_c import Code, written
from posegsa.export.scalar_loops import written_in_loops

HEAD = """
#include <math.h>
#include <stdio.h>
#ifndef POSEGSA_REAL
#define POSEGSA_REAL double
#endif
typedef POSEGSA_REAL posegsa_real;
#define POSEGSA_C(x) ((posegsa_real)(x))
#define posegsa_tanh(x) POSEGSA_C(tanh(x))
"""
N = 12
X, Y = (tuple(f"{name}[{i}]" for i in range(N)) for name in "xy")
Scalars = tuple[jax.Array, ...]


def computed(folder: Path, codes: list[Code], given: np.ndarray, *options: str) -> np.ndarray:
    """(functions, numbers) what each function sets x and y to, from x and y in `given`."""
    text = HEAD
    for i, code in enumerate(codes):
        text += f"static void f{i}(posegsa_real *x, posegsa_real *y)\n{{\n    (void)x, (void)y;\n"
        text += f"{code.text(4)}\n}}\n"
    text += f"int main(void)\n{{\n    posegsa_real g[{2 * N}], a[{2 * N}];\n    int i;\n"
    text += "    if (fread(g, sizeof g, 1, stdin) != 1) return 1;\n"
    for i in range(len(codes)):
        text += f"    for (i = 0; i < {2 * N}; ++i) a[i] = g[i];\n    f{i}(a, a + {N});\n"
        text += "    fwrite(a, sizeof a, 1, stdout);\n"
    source = folder / "loops.c"
    source.write_text(text + "    return 0;\n}\n")
    command = [COMPILERS[0], "-std=c99", "-O1", *WARNINGS, *sanitizers(COMPILERS[0]), *options]
    subprocess.run([*command, str(source), "-o", str(folder / "loops"), "-lm"], check=True)
    done = subprocess.run(
        [folder / "loops"], input=given.tobytes(), capture_output=True, check=True
    )
    return np.frombuffer(done.stdout, given.dtype).reshape(len(codes), 2 * N)


def expected(function: Callable[..., tuple[Scalars, Scalars]], given: np.ndarray) -> np.ndarray:
    with jax.enable_x64(given.dtype == np.float64):
        x, y = (tuple(jnp.asarray(part)) for part in np.split(given, 2))
        return np.array(jax.tree.leaves(jax.jit(function)(x, y)))


GIVEN = np.random.default_rng(0).normal(size=2 * N)


def swapped(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """A loop that hands each number on to another place, in cycles of two, three and one."""

    def turn(carried: Scalars, z: jax.Array) -> tuple[Scalars, None]:
        a, b, c, d, e, f, *rest = carried
        return (b, a, d, e, c, f + z, *rest), None

    return jax.lax.scan(turn, x, jnp.stack(y[:5]))[0], y


def reversed_on_the_spot(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """Results that are arguments too, in another order."""
    return x[::-1], tuple(a + b for a, b in zip(x, y[::-1], strict=True))


def half_of_a_boolean(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """A loop that carries booleans, and constants that are computed before it."""
    scale = x[0] * x[1]

    def turn(carried: tuple, z: jax.Array) -> tuple[tuple, None]:
        seen, total, unused = carried
        return (seen | (z > 0.5), total + jax.lax.select(seen, z * scale, z), unused + z), None

    seen, total, _ = jax.lax.scan(turn, (x[0] > 5, x[2], x[3]), jnp.stack(y))[0]
    return (total, jax.lax.select(seen, x[1], x[2]), *x[2:]), y


def loop_in_a_loop(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    def inner(carried: Scalars, z: jax.Array) -> tuple[Scalars, None]:
        return tuple(0.5 * b + z for b in (*carried[1:], carried[0])), None

    def outer(carried: Scalars, z: jax.Array) -> tuple[Scalars, None]:
        once, _ = jax.lax.scan(inner, carried, jnp.stack([z, x[0], carried[3]]))
        return tuple(a - 0.1 * b for a, b in zip(once, carried, strict=True)), None

    return jax.lax.scan(outer, x, jnp.stack(y))[0], y


def what_is_stored(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """A loop whose stored numbers and booleans are used one by one, and by the loop after it."""

    def turn(total: jax.Array, z: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        return total + z, (total * z, z > 0)

    def again(total: jax.Array, stored: tuple) -> tuple[jax.Array, jax.Array]:
        number, positive = stored
        return total - number, jax.lax.select(positive, number, total)

    total, stored = jax.lax.scan(turn, x[0], jnp.stack(y[:5]))
    last, chosen = jax.lax.scan(again, total, stored)
    each = tuple(jax.lax.index_in_dim(chosen, i, keepdims=False) for i in range(5))
    return (total, last, *each, *x[7:]), y


def sums_so_far(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """Each needs the one before: no array that could be computed at once."""
    found = [x[0]]
    for one in x[1:]:
        found.append(0.5 * found[-1] * found[-1] + one)
    return tuple(found), tuple(a * found[3] for a in y)


def same(x: Scalars) -> Scalars:
    return x


def changed_if(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """Branches that are taken and not, one within another, with what they swap and leave alone."""

    def outer(carried: Scalars) -> Scalars:
        a, b, *rest = carried
        first = jax.lax.cond(y[0] < y[1], lambda pair: (pair[1], pair[0] * y[2]), same, (a, b))
        return (*first, *(0.5 * one - a for one in rest))

    below = jax.lax.cond(x[0] < x[1], outer, same, x)
    above = jax.lax.cond(x[0] >= x[1], outer, same, x)
    return tuple(a - b for a, b in zip(below, above, strict=True)), y


def either(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """A branch on either side, a truth among what comes out, and a condition that is known."""
    number, positive = jax.lax.cond(
        y[0] * y[1] > 0, lambda a: (a * y[2], a > 0), lambda a: (a - y[3], a > 1), x[0]
    )
    known = jax.lax.cond(jnp.asarray(2.0) > 1, lambda a: a + 1, lambda a: a - 1, x[1])
    return (jax.lax.select(positive, number, -number), known, *x[2:]), y


def branch_in_a_loop(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    def turn(carried: Scalars, z: jax.Array) -> tuple[Scalars, None]:
        turned = (*carried[1:], carried[0])
        return jax.lax.cond(z > 0, lambda x: tuple(jnp.tanh(a + z) for a in x), same, turned), None

    return jax.lax.scan(turn, x, jnp.stack(y))[0], y


def as_long_as_it_holds(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """Loops of some turns and of none, and one within the turns of another, whose length is told by
    numbers that they change and by one that they do not."""

    def turned(x: Scalars) -> Scalars:
        return (*x[1:], 0.5 * x[0] + 0.1 * y[0])

    def turn(counted: tuple) -> tuple:
        count, x = counted
        half = jax.lax.while_loop(lambda a: a * a > y[1] * y[1], lambda a: 0.5 * a, x[0])
        return count + 1, turned((half, *x[1:]))

    def long(counted: tuple) -> jax.Array:
        count, x = counted
        return (count < 5) & (x[0] * x[0] > 0.1 * y[2] * y[2])

    count, after = jax.lax.while_loop(long, turn, (jnp.zeros_like(x[0]), x))
    never = jax.lax.while_loop(lambda x: x[1] * x[1] < -1, turned, x)
    truth = jax.lax.while_loop(lambda b: b, lambda b: b & (x[0] > 9), y[3] > 0)
    return after, (jax.lax.select(truth, count, -count), *never[1:4], *y[4:])


def only_truths(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
    """Branches and loops that carry truths alone, two of which change places."""
    above = jax.lax.cond(x[0] > y[0], lambda a, b: a > b, lambda a, b: a < -1, x[1], x[2])

    def turn(carried: tuple, z: jax.Array) -> tuple[tuple, None]:
        a, b = carried
        return jax.lax.cond(z > 0, lambda p: (p[1], p[0]), lambda p: p, (a, b)), None

    first, second = jax.lax.scan(turn, (above, x[3] > 0), jnp.stack(y))[0]
    return (jax.lax.select(first, x[0], x[1]), jax.lax.select(second, x[2], x[3]), *x[2:]), y


BY_HAND = [
    as_long_as_it_holds,
    only_truths,
    changed_if,
    either,
    branch_in_a_loop,
    swapped,
    reversed_on_the_spot,
    half_of_a_boolean,
    loop_in_a_loop,
    what_is_stored,
    sums_so_far,
]


def made_up(seed: int) -> Callable[[Scalars, Scalars], tuple[Scalars, Scalars]]:
    """A function of a few rounds, each of which changes the numbers by neighbours far and near."""
    rng = np.random.default_rng(seed)
    rounds = [
        (rng.integers(7), rng.permutation(N).tolist(), int(rng.integers(N)), float(rng.normal()))
        for _ in range(rng.integers(2, 6))
    ]
    looped, crossed, counted = rng.random() < 0.6, rng.random() < 0.5, rng.random() < 0.5

    def changed(x: Scalars, y: Scalars) -> Scalars:
        for kind, order, at, factor in rounds:
            shifted = x[at:] + x[:at]
            match kind:
                case 0:
                    x = tuple(x[i] for i in order)
                case 1:  # as a Kalman filter's covariance is cut
                    gain = tuple(factor * a + 0.1 * b for a, b in zip(x, shifted, strict=True))
                    part = tuple(0.2 * g for g in gain[: 1 + at // 4])
                    x = tuple(a - part[i % len(part)] * gain[i] for i, a in enumerate(x))
                case 2:
                    x = tuple(jnp.tanh(x[i] + factor * y[k]) for k, i in enumerate(order))
                case 3:
                    x = tuple(a + 0.3 * b for a, b in zip(x, shifted, strict=True))
                case 4:
                    x = x[:at] + tuple(0.5 * a - y[0] for a in x[at:])
                case 5:
                    less = 0.1 * x[at]
                    x = jax.lax.cond(
                        x[at] > y[0], lambda x, b=less: tuple(a - b for a in x), same, x
                    )
                case _:
                    x = tuple(0.5 * a + x[at] * b for a, b in zip(x, y, strict=True))
        return tuple(jnp.tanh(a) if i % 5 == 0 else a for i, a in enumerate(x))

    def function(x: Scalars, y: Scalars) -> tuple[Scalars, Scalars]:
        if not looped:
            after = changed(x, y)
        elif counted:
            begin = (jnp.zeros_like(x[0]), changed(x, y))
            _, after = jax.lax.while_loop(
                lambda c: (c[0] < 4) & (c[1][0] < 1), lambda c: (c[0] + 1, changed(c[1], y)), begin
            )
        else:
            rows = [jnp.stack(y[i : i + 3]) for i in range(4)]
            after, _ = jax.lax.scan(
                lambda x, z: (changed(x, (*z, *y[4:])), None), changed(x, y), rows
            )
        return (after, x) if crossed else (after, y)

    return function


@needs_cc
def test_loops_and_orders_of_every_kind_compute_what_jax_does(tmp_path):
    want = np.stack([expected(f, GIVEN) for f in BY_HAND])
    for write in (written_in_loops, written):
        got = computed(tmp_path, [write(f, (X, Y), (X, Y)) for f in BY_HAND], GIVEN)
        np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-13)


@needs_cc
def test_made_up_functions_compute_what_jax_does(tmp_path):
    """Some overwrite arrays, some need copies, some can't be arrays at all."""
    functions = [made_up(seed) for seed in range(40)]
    codes = [written_in_loops(f, (X, Y), (X, Y)) for f in functions]
    got = computed(tmp_path, codes, GIVEN)
    want = np.stack([expected(f, GIVEN) for f in functions])
    np.testing.assert_allclose(got, want, rtol=1e-11, atol=1e-12)


@pytest.mark.quick
def test_values_computed_the_same_way_become_a_loop():
    def function(x: Scalars, y: Scalars) -> Scalars:
        return tuple(a - y[0] * b for a, b in zip(x, y, strict=True))

    code = written_in_loops(function, (X, Y), tuple(f"z[{i}]" for i in range(N)))
    assert code.statements == ("for (int k = 0; k < 12; ++k) { z[k] = x[k] - y[0] * y[k]; }",)


@pytest.mark.quick
def test_the_text_does_not_grow_with_the_turns_of_a_loop():
    def length(count: int) -> int:
        def function(x: Scalars, y: Scalars) -> Scalars:
            return jax.lax.scan(lambda x, z: (tuple(a * z for a in x), None), x, jnp.stack(y))[0]

        y = tuple(f"seen->y[{i}]" for i in range(count))
        return len(written_in_loops(function, (X, y), X).text(4))

    assert length(9) == length(2)


@pytest.mark.quick
def test_a_unit_of_rounding_is_that_of_the_type():
    def function(x: jax.Array) -> jax.Array:
        return x * float(jnp.finfo(x.dtype).eps)

    (statement,) = written_in_loops(function, ("x",), "y").statements
    assert "sizeof(posegsa_real) < sizeof(double) ? POSEGSA_C(1.1920929e-07) :" in statement
