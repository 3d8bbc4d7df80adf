"""Functions of scalars as C statements: what is written, and what is omitted."""

import math
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiled_c import COMPILERS, needs_cc

from posegsa.errors import ArgumentError
from posegsa.export.scalar_c import literal, written
from posegsa.export.scalar_trace import Known
from posegsa.model.elementwise import choose, maximum, minimum

pytestmark = pytest.mark.quick


def lines(function, arguments, results) -> list[str]:
    return list(written(function, arguments, results).statements)


def test_a_value_used_once_is_written_in_place():
    assert lines(lambda a, b: a * (b - 1.5), ("x", "y"), "z") == ["z = x * (y - POSEGSA_C(1.5));"]
    # Evaluated from left to right, as in Python, so that rounding is the same.
    assert lines(lambda a, b: a - (b - a) - b, ("x", "y"), "z") == ["z = x - (y - x) - y;"]
    assert lines(lambda a, b: -(a / (b * a)), ("x", "y"), "z") == ["z = -(x / (y * x));"]


def test_a_quotient_of_whole_numbers_is_no_whole_number():
    """C would divide 1 by 2 as integers, which is 0."""

    def half(a):
        return choose(a > 0, jnp.ones_like(a), 0.0) / 2

    assert lines(half, ("x",), "z") == ["z = POSEGSA_C(x > 0 ? 1 : 0) / 2;"]
    assert lines(lambda a: 1 / a, ("x",), "z") == ["z = 1 / x;"]


def test_a_value_used_twice_is_named_after_its_function():
    def squared_sum(a, b):
        return a + b

    def function(a, b):
        return squared_sum(a, b) * squared_sum(a, b)

    assert lines(function, ("p->x", "p->y"), "z") == [
        "const posegsa_real squared_sum_1 = p->x + p->y;",
        "z = squared_sum_1 * squared_sum_1;",
    ]


def test_results_may_be_arguments_too():
    """All arguments are read before any result is set."""

    def turned(a, b):
        return b + a, a - b

    assert lines(turned, ("x", "y"), ("x", "y")) == [
        "const posegsa_real turned_1 = y + x;",
        "const posegsa_real turned_2 = x - y;",
        "x = turned_1;",
        "y = turned_2;",
    ]


def test_constants_are_folded_and_unused_values_are_left_out():
    def function(a, limit):
        unlimited = jnp.isfinite(limit)
        return choose(unlimited, minimum(a, limit), a) * 1.0 + 0.0 * a, jnp.exp(a)

    assert lines(function, ("x", Known("top", math.inf)), ("y", None)) == ["y = x;"]
    assert lines(function, ("x", Known("top", 2.0)), ("y", None)) == ["y = posegsa_min(x, top);"]
    assert lines(function, (2.0, 3.0), ("y", None)) == ["y = 2;"]


def test_a_choice_within_a_choice_by_the_same_condition_is_made():
    def function(a):
        some = a > 0
        return choose(some, choose(some, 3 * a, 0.0) * 1.0, choose(some, 5.0, -a))

    assert lines(function, ("x",), "y") == ["y = x > 0 ? 3 * x : -x;"]


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0.0, "0"),
        (-3.0, "(-3)"),
        (0.1, "POSEGSA_C(0.1)"),
        (1e22, "POSEGSA_C(1e+22)"),
        (math.inf, "POSEGSA_C(INFINITY)"),
        (-math.inf, "-POSEGSA_C(INFINITY)"),
        (math.nan, "POSEGSA_C(NAN)"),
        (True, "1"),
    ],
)
def test_numbers_are_of_the_type_that_is_computed_in(number, text):
    assert literal(number) == text


def test_numbers_of_float32_are_written_as_short_as_they_are():
    code = written(lambda a: a * jnp.float32(0.1), ("x",), "y", np.float32)
    assert code.statements == ("y = x * POSEGSA_C(0.1);",)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda a: jnp.sum(jnp.stack([a, a])), "on arrays"),
        (lambda a: jax.lax.while_loop(lambda x: x[0] < 1, jnp.sin, a + jnp.ones(2))[0], "arrays"),
        (lambda a: jax.lax.fori_loop(0, 3, lambda k, x: x + 1, a), "on integers"),
        (lambda a: jnp.interp(a, jnp.arange(3.0), jnp.ones(3)), "allowed"),
        (lambda a: a + np.ones(2)[0] * jnp.ones(3)[0], "on arrays"),
        (lambda a: 1.0 if a > 0 else 2.0, "can't be written in C"),
        (lambda a: a * (a.astype(int) + 1).astype(a.dtype), "on integers"),
        (jax.scipy.special.gammaln, "'lgamma'"),
        (lambda a: jax.lax.cond(a > 0, jnp.stack, lambda b: jnp.stack(b) + 1, [a, a])[0], "arrays"),
        (lambda a: jax.lax.switch(a.astype(int), [jnp.sin, jnp.cos], a), "on integers"),
    ],
)
def test_other_than_scalar_arithmetic_is_refused(function, words):
    with pytest.raises(ArgumentError, match=words):
        written(function, ("x",), "y")


@needs_cc
def test_the_c_computes_what_the_function_does(tmp_path):
    """Every supported operation, with numbers of all kinds."""

    def function(a, b):
        far = maximum(jnp.abs(a), minimum(b, a)) > 1.25
        inside = ~(a > b) & (b >= -2) | (a == b) | far
        return (
            choose(inside, jnp.sqrt(jnp.abs(a)), jnp.exp(0.1 * b)),
            jnp.sin(a) * jnp.cos(b) + jnp.tan(a) - jnp.tanh(b),
            jnp.log(1 + a * a) ** 2 + b**3 + jnp.square(a),
            jnp.round(a) + jnp.floor(b) + jax.lax.rsqrt(1 + b * b),
            jnp.where(far != (b < 0), a, -b),
            jnp.clip(a, -1.0, 1.0) + jnp.minimum(a, b) * jnp.maximum(a, b),
            a**5 - (2 + b * b) ** -3 + a**0 + far.astype(a.dtype) * b,
            jnp.arctan2(a, b) + jnp.abs(a) ** b,
        )

    count = 8
    code = written(function, ("x[0]", "x[1]"), tuple(f"y[{i}]" for i in range(count)))
    functions = ""
    for f in code.functions:
        of = "ab" if f in ("atan2", "pow") else "a"
        given = ", ".join(f"double {x}" for x in of)
        functions += f"static double posegsa_{f}({given}) {{ return {f}({', '.join(of)}); }}\n"
    source = (
        "#include <math.h>\n#include <stdio.h>\ntypedef double posegsa_real;\n"
        "#define POSEGSA_C(x) ((posegsa_real)(x))\n"
        "static double posegsa_min(double a, double b) { return a < b ? a : b; }\n"
        "static double posegsa_max(double a, double b) { return a > b ? a : b; }\n"
        f"{functions}int main(void)\n{{\n    double x[2], y[{count}];\n"
        "    while (fread(x, sizeof x, 1, stdin) == 1) {\n"
        f"{code.text(8)}\n        fwrite(y, sizeof y, 1, stdout);\n    }}\n    return 0;\n}}\n"
    )
    (tmp_path / "scalar.c").write_text(source)
    command = [COMPILERS[0], "-std=c99", "-Wall", "-Wextra", "-Werror", "scalar.c", "-o", "scalar"]
    subprocess.run([*command, "-lm"], check=True, cwd=tmp_path)
    x = np.random.default_rng(0).normal(size=(500, 2)) * 2
    x[::7, 1] = x[::7, 0]
    x[3] = 0.5, -1.5  # round to even
    done = subprocess.run([tmp_path / "scalar"], input=x.tobytes(), capture_output=True, check=True)
    got = np.frombuffer(done.stdout).reshape(-1, count)
    with jax.enable_x64(True):
        want = np.stack(jax.jit(jax.vmap(function))(*jnp.asarray(x).T), axis=1)
    np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-13)
