"""Continuity and derivatives of the gain of fuzzy inference."""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.controllers import (
    INPUTS,
    OUTPUTS,
    RULES,
    corner_vectors,
    fuzzy,
    gains_of,
    repaired_terms,
    search_vectors,
)
from jax import Array

from posegsa.model.fuzzy import FuzzyController

DTYPES = ("float32", "float64")

called = jax.jit(FuzzyController.__call__)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("seed", range(3))
def test_the_gain_is_continuous(seed: int) -> None:
    inputs, outputs = (t[0] for t in repaired_terms(search_vectors(1, seed)))
    controller = fuzzy(inputs, outputs)
    start, end = np.random.default_rng(seed).random((2, 2))

    line = start + np.linspace(0, 1, 1_000_001)[:, None] * (end - start)
    gains = np.asarray(called(controller, *line.T))

    def largest_jump(every: int) -> float:
        return float(np.abs(np.diff(gains[::every])).max())

    # A jump is equally large for any step length. A steep slope is not a jump: terms may
    # overlap by 0.01 only, and the gain then changes by tens within a fraction of that.
    assert largest_jump(1) < 0.1 * largest_jump(1000)


@cache
def derivatives() -> Callable[..., Array]:
    """Derivatives (B, 2) of the gain by error and rate; B is always 200, to compile once."""

    def gain(x: Array, inputs: Array, outputs: Array) -> Array:
        return FuzzyController(inputs, outputs, RULES, (0.0, 100.0))(x[0], x[1])

    return jax.jit(jax.vmap(jax.grad(gain)))


@pytest.mark.parametrize("dtype", DTYPES)
def test_derivatives_are_finite(dtype: str) -> None:
    vectors = np.concatenate([search_vectors(100), corner_vectors(100)])
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 2, (200, 2))
    x[::4] = rng.integers(0, 2, (50, 2))
    with jax.enable_x64(dtype == "float64"):
        arrays = (jnp.asarray(a, dtype) for a in (x, *repaired_terms(vectors)))
        slope = np.asarray(derivatives()(*arrays))
    assert np.isfinite(slope).all()
    # Clipped inputs have no influence, the others have.
    clipped = (x < 0) | (x > 1)
    assert (slope[clipped] == 0).all()
    assert (slope[~clipped] != 0).mean() > 0.3


@pytest.mark.usefixtures("x64")
def test_derivatives_are_those_of_the_gain() -> None:
    terms = repaired_terms(search_vectors(200))
    x, h = np.random.default_rng(0).uniform(0.01, 0.99, (200, 2)), 1e-6
    along = np.random.default_rng(1).normal(size=(200, 2))
    slope = np.sum(np.asarray(derivatives()(*map(jnp.asarray, (x, *terms)))) * along, axis=1)
    before, at, after = (gains_of(*terms, *(x + s * h * along).T) for s in (-1, 0, 1))
    # min and max make kinks: compare where both sides have the same slope, to rounding and h.
    smooth = np.abs(after - 2 * at + before) < 1e-3 * np.abs(after - before) + 1e-10
    assert smooth.mean() > 0.95
    difference = (after - before) / (2 * h)
    np.testing.assert_allclose(difference[smooth], slope[smooth], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("dtype", DTYPES)
def test_derivatives_at_the_ends_of_the_inputs_are_not_the_vertical_edges(dtype: str) -> None:
    # VS peaks at 0 and VL at 1, with their vertical edge there, at the ends of the tested range.
    corners = np.array([[0.0, 0], [0, 1], [1, 0], [1, 1]])
    with jax.enable_x64(dtype == "float64"):
        arrays = (np.repeat([INPUTS], 200, axis=0), np.repeat([OUTPUTS], 200, axis=0))
        x = np.repeat(corners, 50, axis=0)
        slope = np.asarray(derivatives()(*(jnp.asarray(a, dtype) for a in (x, *arrays))))
    # The steepest edge that is not vertical, over the whole output.
    widths = np.diff(INPUTS, axis=1)
    assert np.abs(slope).max() <= 100 / widths[widths > 0].min()
