"""The centroid, exact and sampled, against quadrature; and the gain where there is none."""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.controllers import (
    GAPPED,
    INPUTS,
    OUTPUTS,
    RULES,
    corner_vectors,
    evaluated,
    fuzzy,
    repaired_terms,
    search_vectors,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array

from posegsa.model.fuzzy import FuzzyController, exact_integrals

DTYPES = ("float32", "float64")


BATCH = {"exact": 300, "sampled": 40}
"""Sets of heights at once; always the same number, so that programs are compiled once."""


@cache
def defuzzifier(**options: object) -> Callable[..., Array]:
    """Compiled map from output terms (B, m, 3), heights (B, m) and last gain to gains (B,)."""

    def one(outputs: Array, heights: Array, last: Array) -> Array:
        controller = FuzzyController(
            jnp.zeros((5, 3), outputs.dtype), outputs, RULES, (0.0, 100.0), **options
        )
        return controller.defuzzify(tuple(heights), controller.prepare(), last)

    return jax.jit(jax.vmap(one, in_axes=(0, 0, None)))


def defuzzified(outputs: object, heights: object, dtype: str = "float64", **options) -> np.ndarray:
    """Gains K of heights under output terms; the last gain is NaN, so that a hold shows."""
    count, batch = len(np.asarray(heights)), BATCH["sampled" if options else "exact"]
    assert count <= batch
    given = (np.asarray(a, np.float64) for a in (outputs, heights))
    padded = (np.resize(a, (batch, *a.shape[1:])).astype(dtype) for a in given)
    return np.asarray(defuzzifier(**options)(*padded, np.asarray(np.nan, dtype)))[:count]


def some_heights(count: int, seed: int = 0) -> np.ndarray:
    """Heights (count, 5) in [0, 1]: random, with zeros, ones and equal ones among them."""
    rng = np.random.default_rng(seed)
    heights = rng.random((count, 5))
    heights = np.where(rng.random((count, 5)) < 0.3, rng.integers(0, 2, (count, 5)), heights)
    heights = np.where(rng.random((count, 1)) < 0.2, np.round(2 * heights) / 2, heights)
    heights[heights.max(axis=1) == 0, 2] = 0.5
    return heights


# The exact centroid -------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", [search_vectors, corner_vectors])
def test_exact_centroid_against_quadrature(vectors: Callable[[int], np.ndarray]) -> None:
    _, outputs = repaired_terms(vectors(300))
    heights = some_heights(300)
    expected = [
        reference.centroid_by_quadrature(h, t) for h, t in zip(heights, outputs, strict=True)
    ]
    # A corner vector may fire only a term without width: no area, see the limit points below.
    area = np.isfinite(expected)
    assert area.mean() > 0.98
    gains = defuzzified(outputs, heights)
    np.testing.assert_allclose((gains - 1)[area], np.array(expected)[area], rtol=0, atol=1e-9)
    assert np.isfinite(gains).all()


DEGENERATE = {
    "left edges vertical": [[0, 0, 20], [10, 10, 40], [30, 30, 50], [30, 30, 70], [60, 60, 100]],
    "right edges vertical": [[0, 20, 20], [10, 40, 40], [30, 50, 50], [30, 70, 70], [60, 100, 100]],
    "all alike": [[10, 40, 60]] * 5,
    "pairs alike": [[0, 0, 10], [5, 20, 50], [5, 20, 50], [20, 60, 90], [20, 60, 90]],
    "no width among others": [[0, 0, 0], [0, 10, 20], [20, 20, 20], [20, 50, 60], [60, 60, 60]],
    "touching": [[0, 0, 20], [20, 30, 40], [40, 40, 60], [60, 80, 80], [80, 100, 100]],
    "apart": [[0, 0, 5], [10, 12, 15], [30, 31, 40], [60, 60, 61], [90, 100, 100]],
    "one peak": [[0, 50, 50], [10, 50, 60], [20, 50, 70], [30, 50, 80], [40, 50, 100]],
    "one foot": [[0, 0, 30], [0, 10, 30], [0, 20, 40], [0, 30, 90], [0, 100, 100]],
    "nearly no width": [
        [0, 0, 1e-9],
        [20, 20, 20 + 1e-9],
        [40, 50, 60],
        [70, 80, 90],
        [90, 95, 99],
    ],
    "nearly alike": [[10, 40, 60 + i * 1e-12] for i in range(5)],
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("outputs", DEGENERATE.values(), ids=DEGENERATE.keys())
def test_exact_centroid_of_degenerate_terms_against_quadrature(outputs: list) -> None:
    terms = np.asarray(fuzzy(INPUTS, outputs).output_terms)  # outside jit, so it is checked
    heights = np.concatenate([some_heights(60), np.eye(5), np.ones((1, 5)), 1e-6 * np.eye(5)])
    expected = np.array([reference.centroid_by_quadrature(h, terms) for h in heights])
    area = np.isfinite(expected)
    gains = defuzzified(np.broadcast_to(terms, (len(heights), 5, 3)), heights)
    np.testing.assert_allclose((gains - 1)[area], expected[area], rtol=0, atol=1e-9)
    assert area.sum() > 40


@pytest.mark.usefixtures("x64")
def test_exact_area_of_any_number_of_terms_against_trapezoids() -> None:
    # The closed form holds for any number of terms, including one.
    z = np.linspace(0, 100, 200_001)
    for count in (1, 2, 7):
        rng = np.random.default_rng(count)
        terms = np.sort(np.sort(rng.uniform(0, 100, (count, 3)), axis=1), axis=0)
        heights = rng.random(count)
        controller = fuzzy([[0, 0, 1]], terms, rules=((0,),))
        area, moment = exact_integrals(tuple(jnp.asarray(heights)), controller.prepare().overlaps)
        mu = np.max(
            [
                np.minimum(h, np.interp(z, t, [0, 1, 0]))
                for h, t in zip(heights, terms, strict=True)
            ],
            axis=0,
        )
        # Trapezoids of width 5e-4 have errors only at kinks, some 1e-7 each.
        np.testing.assert_allclose(area, np.trapezoid(mu, z), rtol=1e-6)
        np.testing.assert_allclose(moment, np.trapezoid(z * mu, z), rtol=1e-6)


# The sampled centroid -----------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("points", [101, 11])
def test_sampled_sum_against_the_reference(points: int) -> None:
    _, outputs = repaired_terms(search_vectors(40))
    heights = some_heights(40)
    expected = [
        reference.sampled_centroid(h, t, 0.0, 100.0, points)
        for h, t in zip(heights, outputs, strict=True)
    ]
    gains = defuzzified(outputs, heights, centroid="sampled", sampled_points=points)
    seen = np.isfinite(expected)  # a single narrow term may lie between two points
    assert seen.sum() > 30
    # The grid points agree to rounding, and so do the memberships unless an edge is vertical.
    np.testing.assert_allclose((gains - 1)[seen], np.array(expected)[seen], rtol=0, atol=1e-9)


@pytest.mark.usefixtures("x64")
def test_sampled_trapezoid_halves_the_weight_of_the_ends() -> None:
    _, outputs = repaired_terms(search_vectors(20))
    heights = np.ones((20, 5))
    z = np.linspace(0, 100, 101)
    expected = []
    for h, terms in zip(heights, outputs, strict=True):
        mu = np.array([reference.aggregated(x, h, terms) for x in z])
        expected.append(np.trapezoid(z * mu, z) / np.trapezoid(mu, z))
    gains = defuzzified(outputs, heights, centroid="sampled", sampled_rule="trapezoid")
    np.testing.assert_allclose(gains - 1, expected, rtol=0, atol=1e-9)
    # Both ends have area here, so the two rules must differ.
    assert np.abs(gains - defuzzified(outputs, heights, centroid="sampled")).max() > 0.05


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("rule", ["sum", "trapezoid"])
def test_sampled_centroid_tends_to_the_exact_one(rule: str) -> None:
    _, outputs = repaired_terms(search_vectors(40))
    heights = some_heights(40)
    exact = defuzzified(outputs, heights)
    off = [
        np.median(
            np.abs(
                exact
                - defuzzified(
                    outputs, heights, centroid="sampled", sampled_points=points, sampled_rule=rule
                )
            )
        )
        for points in (101, 1001, 10_001)
    ]
    # The error of a sum over both ends is of the order of the spacing, of a trapezoid its square.
    order = {"sum": 10, "trapezoid": 100}[rule]
    assert off[1] < 2 * off[0] / order
    assert off[2] < 2 * off[1] / order
    assert off[2] < {"sum": 1e-2, "trapezoid": 1e-5}[rule]


# No rule fires, or no term has an area -----------------------------------------------------------


@pytest.mark.parametrize("centroid", ["exact", "sampled"])
def test_where_no_rule_fires_the_last_gain_is_held_or_the_mid_range_taken(centroid: str) -> None:
    held, middle = (
        fuzzy(GAPPED, OUTPUTS, "float32", centroid=centroid, no_rule=no_rule)
        for no_rule in ("hold", "midrange")
    )
    assert evaluated(held, 0.15, 0.5, 7.25) == 7.25
    assert evaluated(held, 0.5, 0.15, 7.25) == 7.25
    assert evaluated(held, 0.15, 0.5) == 51  # before any gain: mid-range of [0, 100], plus 1
    assert evaluated(middle, 0.15, 0.5, 7.25) == 51
    # If rules fire, neither matters.
    assert evaluated(held, 0.25, 0.5, 7.25) == evaluated(middle, 0.25, 0.5, 9.0)


def test_the_mid_range_is_that_of_the_output_range() -> None:
    outputs = 10 + 0.2 * OUTPUTS
    controller = fuzzy(GAPPED, outputs, "float32", no_rule="midrange", output_range=(10.0, 30.0))
    assert evaluated(controller, 0.15, 0.5) == 21
    assert controller.initial_gain() == 21


@pytest.mark.parametrize("dtype", DTYPES)
def test_the_limit_where_rules_fire_over_no_area(dtype: str) -> None:
    with jax.enable_x64(dtype == "float64"):
        spikes = np.repeat([[0.0], [10], [30], [70], [100]], 3, axis=1)
        # One term without width: its position, at any firing height.
        for h in (1.0, 0.3, 1e-6):
            gains = defuzzified([spikes] * 5, h * np.eye(5), dtype)
            np.testing.assert_allclose(gains, 1 + spikes[:, 0], rtol=1e-6)
        # All terms at one position: that position.
        same = np.full((5, 3), 40.0)
        assert defuzzified([same], [[0.2, 0, 0.4, 1, 0.1]], dtype) == pytest.approx(41, rel=1e-6)
        # A term so low that its area underflows: the middle of its support, as for any low height.
        tiny = 1e-30 if dtype == "float32" else 1e-200
        gains = defuzzified([OUTPUTS] * 5, tiny * np.eye(5), dtype)
        np.testing.assert_allclose(gains, 1 + (OUTPUTS[:, 0] + OUTPUTS[:, 2]) / 2, rtol=1e-6)


@pytest.mark.parametrize(("dtype", "tiny"), [("float32", 1e-30), ("float64", 1e-200)])
def test_the_limit_where_several_terms_fire_too_low_for_an_area(dtype: str, tiny: float) -> None:
    # Terms with a width: clipped that low they are flat, and wide ones have more weight.
    heights = np.array([[1.0, 0, 0, 0, 1], [1, 0.5, 0, 0, 0], [0, 1, 0.2, 0.7, 0]])
    flat = [reference.centroid_by_quadrature(1e-9 * h, OUTPUTS) for h in heights]
    with jax.enable_x64(dtype == "float64"):
        gains = defuzzified([OUTPUTS] * 3, tiny * heights, dtype)
    np.testing.assert_allclose(gains - 1, flat, rtol=1e-5)


@pytest.mark.usefixtures("x64")
def test_terms_of_no_width_are_the_limit_of_equally_narrow_ones() -> None:
    places, width = np.array([0.0, 10, 30, 70, 100]), 1e-5
    spikes, narrow = (places[:, None] + w * np.array([-1, 0, 1]) for w in (0.0, width))
    heights = some_heights(20)
    expected = [reference.centroid_by_quadrature(h, narrow) for h in heights]
    gains = defuzzified([spikes] * 20, heights)
    # Feet near 1e2 are rounded to 1e-14, which is 1e-9 of the width.
    np.testing.assert_allclose(gains - 1, expected, rtol=0, atol=1e-6)


AWKWARD = st.one_of(
    st.floats(0, 1, width=32),
    st.sampled_from([0.0, 1.0, 0.5, 0.25, 1e-45, 1e-39, 1e-38, 1e-30, 1e-12, 1 - 2**-24]),
    st.sampled_from([5e-324, 1e-310, 1e-300, 1e-160, 1 - 2**-53]),
)
TERMS = st.lists(AWKWARD, min_size=15, max_size=15).map(
    lambda numbers: np.sort(np.sort(np.reshape(numbers, (5, 3)), axis=1), axis=0)
)
CRISP = st.one_of(AWKWARD, st.floats(-1, 2), st.just(-0.0))


@pytest.mark.parametrize("options", [{}, {"centroid": "sampled"}], ids=["exact", "sampled"])
@settings(max_examples=100)
@given(data=st.data())
def test_gains_are_never_nan_and_stay_inside_the_output(options: dict, data: st.DataObject) -> None:
    inputs, outputs = data.draw(TERMS), 100 * data.draw(TERMS)
    crisp = np.array(data.draw(st.lists(st.tuples(CRISP, CRISP), min_size=8, max_size=8)))
    for dtype, slack in (("float32", 1e-3), ("float64", 1e-10)):
        with jax.enable_x64(dtype == "float64"):
            controller = fuzzy(inputs, outputs, dtype, **options)
            held = np.asarray(1 + outputs.min(), dtype)
            gains = np.asarray(_called(controller, *crisp.astype(dtype).T, held))
        assert gains.dtype == dtype
        # Sums over the whole output round by a few units at 100.
        assert (gains >= 1 + outputs.min() - slack).all()
        assert (gains <= 1 + outputs.max() + slack).all()


_called = jax.jit(jax.vmap(FuzzyController.__call__, in_axes=(None, 0, 0, None)))
