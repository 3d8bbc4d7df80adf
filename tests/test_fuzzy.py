"""Fuzzy inference, against the quadrature reference and scikit-fuzzy."""

import dataclasses
from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import skfuzzy
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array
from setups import PAPER, RULES, corner_vectors, fuzzy, repaired_terms, search_vectors

from posegsa.errors import FuzzyError
from posegsa.fuzzy import FuzzyController, exact_integrals
from posegsa.parameters import rule_indices

DTYPES = ("float32", "float64")
INPUTS, OUTPUTS = (terms[0] for terms in repaired_terms(search_vectors(1, seed=5)))
"""Terms with nothing special about them."""
GAPPED = [[0, 0, 0.1], [0.2, 0.2, 0.3], [0.25, 0.4, 0.6], [0.5, 0.6, 0.8], [0.7, 1, 1]]
"""Input terms that leave (0.1, 0.2) to no rule."""


def evaluated(controller: FuzzyController, error: object, rate: object, *last: float) -> np.ndarray:
    """Gains at the controller's dtype of errors and rates given as any numbers."""
    dtype = controller.output_terms.dtype
    return np.asarray(controller(*(jnp.asarray(x, dtype) for x in (error, rate, *last))))


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
    """Gains K of heights under output terms; the gain to hold is NaN, so that a hold shows."""
    arrays = (jnp.asarray(np.asarray(a, np.float64), dtype) for a in (outputs, heights))
    return np.asarray(defuzzifier(**options)(*arrays, jnp.asarray(np.nan, dtype)))


def some_heights(count: int, seed: int = 0) -> np.ndarray:
    """Heights (count, 5) in [0, 1]: random, with zeros, ones and equal ones among them."""
    rng = np.random.default_rng(seed)
    heights = rng.random((count, 5))
    heights = np.where(rng.random((count, 5)) < 0.3, rng.integers(0, 2, (count, 5)), heights)
    heights = np.where(rng.random((count, 1)) < 0.2, np.round(2 * heights) / 2, heights)
    heights[heights.max(axis=1) == 0, 2] = 0.5
    return heights


# Rules and memberships ----------------------------------------------------------------------------


def test_the_configured_rules_are_the_papers() -> None:
    assert rule_indices(PAPER.fuzzy.rules) == RULES
    # Corners of Table I, read by hand: least error and rate, one of them large, both.
    assert (RULES[0][0], RULES[0][4], RULES[4][0], RULES[4][4]) == (0, 4, 3, 4)


EDGES = [
    *INPUTS.tolist(),
    *([0, 0, 0.3], [0.7, 1, 1], [0.4, 0.4, 0.6], [0.2, 0.5, 0.5]),  # vertical edges
    *([0.5, 0.5, 0.5], [0, 0, 0], [1, 1, 1]),  # no width
]


@pytest.mark.usefixtures("x64")
def test_memberships_against_the_reference_and_scikit_fuzzy() -> None:
    x = np.unique(np.concatenate([np.linspace(0, 1, 201), np.ravel(EDGES)]))
    # One term at a time as VS, with every other one out of reach, on the diagonal of the table:
    # the height of output term VS is then the term's membership.
    for term in EDGES:
        controller = fuzzy([term, *[[2, 2, 2]] * 4], OUTPUTS)
        membership = controller.heights(jnp.asarray(x), jnp.asarray(x))[0]
        expected = [reference.triangle(z, *term) for z in x]
        # Rounding of a difference of numbers up to 1, over the narrowest width here.
        np.testing.assert_allclose(membership, expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(membership, skfuzzy.trimf(x, term), rtol=0, atol=1e-13)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("seed", range(3))
def test_firing_heights_against_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rules = tuple(tuple(row) for row in rng.integers(0, 5, (5, 5)).tolist()) if seed else RULES
    inputs, outputs = (t[0] for t in repaired_terms(search_vectors(1, seed)))
    error, rate = rng.random((2, 100))
    heights = fuzzy(inputs, outputs, rules=rules).heights(jnp.asarray(error), jnp.asarray(rate))
    expected = [
        reference.firing_heights(e, r, inputs, np.array(rules))
        for e, r in zip(error, rate, strict=True)
    ]
    np.testing.assert_allclose(np.stack(heights, axis=1), expected, rtol=0, atol=1e-13)


@pytest.mark.usefixtures("x64")
def test_the_tables_rows_are_the_rate_and_its_columns_the_error() -> None:
    # Peaks of the terms: exactly one rule fires, fully.
    middle = [[0, 0, 0.1], [0, 0.2, 0.3], [0.2, 0.4, 0.5], [0.4, 0.6, 0.8], [0.8, 1, 1]]
    peaks = np.array(middle)[:, 1]
    controller = fuzzy(middle, OUTPUTS)
    for r, e in np.ndindex(5, 5):
        heights = controller.heights(jnp.asarray(peaks[e]), jnp.asarray(peaks[r]))
        assert int(np.argmax(heights)) == reference.PAPER_RULES[r, e]
        assert sorted(heights)[-2:] == [0, 1]


# The exact centroid -------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", [search_vectors, corner_vectors])
def test_exact_centroid_against_quadrature(vectors: Callable[[int], np.ndarray]) -> None:
    _, outputs = repaired_terms(vectors(300))
    heights = some_heights(300)
    expected = [
        reference.centroid_by_quadrature(h, t) for h, t in zip(heights, outputs, strict=True)
    ]
    # A corner vector may fire a term of no width alone: no area, see the limit points below.
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
    terms = np.asarray(fuzzy(INPUTS, outputs).output_terms)  # made outside jit, so checked
    heights = np.concatenate([some_heights(60), np.eye(5), np.ones((1, 5)), 1e-6 * np.eye(5)])
    expected = np.array([reference.centroid_by_quadrature(h, terms) for h in heights])
    area = np.isfinite(expected)
    gains = defuzzified(np.broadcast_to(terms, (len(heights), 5, 3)), heights)
    np.testing.assert_allclose((gains - 1)[area], expected[area], rtol=0, atol=1e-9)
    assert area.sum() > 40


@pytest.mark.usefixtures("x64")
def test_exact_area_of_any_number_of_terms_against_trapezoids() -> None:
    # Not only five: the closed form is for any number, one included.
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
        # Trapezoids of 5e-4 err by kinks only, some 1e-7 each.
        np.testing.assert_allclose(area, np.trapezoid(mu, z), rtol=1e-6)
        np.testing.assert_allclose(moment, np.trapezoid(z * mu, z), rtol=1e-6)


# Against scikit-fuzzy -----------------------------------------------------------------------------

UNIVERSE = np.linspace(0, 100, 20_001)


def by_scikit_fuzzy(error: float, rate: float, inputs: np.ndarray, outputs: np.ndarray) -> float:
    """Gain: memberships at the crisp input, heights by the rules, `defuzz` at 20 001 points."""
    of_error, of_rate = (
        [skfuzzy.trimf(np.array([x]), term)[0] for term in inputs] for x in (error, rate)
    )
    heights = np.zeros(5)
    for (r, e), output in np.ndenumerate(reference.PAPER_RULES):
        heights[output] = max(heights[output], min(of_rate[r], of_error[e]))
    clipped = [
        np.fmin(h, skfuzzy.trimf(UNIVERSE, t)) for h, t in zip(heights, outputs, strict=True)
    ]
    return 1 + skfuzzy.defuzz(UNIVERSE, np.max(clipped, axis=0), "centroid")


@cache
def compiled_gain() -> Callable[..., Array]:
    """Gains (B,) of terms (B, 5, 3), errors and rates (B,)."""
    return jax.jit(jax.vmap(lambda i, o, e, r: FuzzyController(i, o, RULES, (0.0, 100.0))(e, r)))


def gains_of(*arrays: np.ndarray) -> np.ndarray:
    return np.asarray(compiled_gain()(*(jnp.asarray(a) for a in arrays)))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", [search_vectors, corner_vectors])
def test_gain_against_scikit_fuzzy_on_random_points(
    vectors: Callable[[int], np.ndarray],
) -> None:
    inputs, outputs = repaired_terms(vectors(80))
    error, rate = np.random.default_rng(1).random((2, 80))
    cases = list(zip(error, rate, inputs, outputs, strict=True))
    gains = gains_of(inputs, outputs, error, rate)
    off = np.abs(gains - [by_scikit_fuzzy(*case) for case in cases])
    # Measured over 500 draws of each kind: up to 3e-4, and all but 3 under 1e-5, where no edge is
    # vertical; up to 3e-3, and all but 1 under 2e-3, with corners of the boxes. `trimf` on a grid
    # draws a vertical edge as a slope of one spacing, 0.005. That the difference is theirs, the
    # quadrature shows.
    assert off.max() < (2e-3 if vectors is search_vectors else 4e-3)
    assert (off < 2e-3).mean() > 0.98
    assert np.median(off) < 1e-6
    rules = reference.PAPER_RULES
    heights = [reference.firing_heights(e, r, i, rules) for e, r, i, _ in cases]
    exact = [reference.centroid_by_quadrature(h, o) for h, o in zip(heights, outputs, strict=True)]
    np.testing.assert_allclose(gains - 1, exact, rtol=0, atol=1e-9)


@pytest.mark.usefixtures("x64")
def test_gain_against_scikit_fuzzy_on_a_grid() -> None:
    axis = np.linspace(0, 1, 6)
    error, rate = (x.ravel() for x in np.meshgrid(axis, axis))
    for vector in search_vectors(2, seed=3):
        terms = [t[0] for t in repaired_terms(vector[None])]
        expected = [by_scikit_fuzzy(e, r, *terms) for e, r in zip(error, rate, strict=True)]
        gains = evaluated(fuzzy(*terms), error, rate)
        np.testing.assert_allclose(gains, expected, rtol=0, atol=2e-3)  # measured: 9e-6


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
    gains = defuzzified(outputs, heights, centroid="sampled", points=points)
    seen = np.isfinite(expected)  # a narrow term alone may lie between two points
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
    # Both ends count here, so the rules must differ.
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
                    outputs, heights, centroid="sampled", points=points, sampled_rule=rule
                )
            )
        )
        for points in (101, 1001, 10_001)
    ]
    # A sum over both ends is off by the order of the spacing, a trapezoid by its square.
    order = {"sum": 10, "trapezoid": 100}[rule]
    print(rule, off)
    assert off[1] < 2 * off[0] / order
    assert off[2] < 2 * off[1] / order
    assert off[2] < {"sum": 1e-2, "trapezoid": 1e-5}[rule]


# Where nothing fires, or nothing has an area ------------------------------------------------------


@pytest.mark.parametrize("centroid", ["exact", "sampled"])
def test_where_no_rule_fires_the_last_gain_is_held_or_the_mid_range_taken(centroid: str) -> None:
    held, middle = (
        fuzzy(GAPPED, OUTPUTS, "float32", centroid=centroid, no_rule=no_rule)
        for no_rule in ("hold", "midrange")
    )
    assert evaluated(held, 0.15, 0.5, 7.25) == 7.25
    assert evaluated(held, 0.5, 0.15, 7.25) == 7.25
    assert evaluated(held, 0.15, 0.5) == 51  # before any gain: mid-range of [0, 100], and 1
    assert evaluated(middle, 0.15, 0.5, 7.25) == 51
    # Where rules fire, neither matters.
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
        # One term of no width: its place, however high it fires.
        for h in (1.0, 0.3, 1e-6):
            gains = defuzzified([spikes] * 5, h * np.eye(5), dtype)
            np.testing.assert_allclose(gains, 1 + spikes[:, 0], rtol=1e-6)
        # All in one place: that place.
        same = np.full((5, 3), 40.0)
        assert defuzzified([same], [[0.2, 0, 0.4, 1, 0.1]], dtype) == pytest.approx(41, rel=1e-6)
        # A term so low that its area underflows: the middle of its support, as for any low height.
        tiny = 1e-30 if dtype == "float32" else 1e-200
        gains = defuzzified([OUTPUTS] * 5, tiny * np.eye(5), dtype)
        np.testing.assert_allclose(gains, 1 + (OUTPUTS[:, 0] + OUTPUTS[:, 2]) / 2, rtol=1e-6)


@pytest.mark.parametrize(("dtype", "tiny"), [("float32", 1e-30), ("float64", 1e-200)])
def test_the_limit_where_several_terms_fire_too_low_for_an_area(dtype: str, tiny: float) -> None:
    # Terms that have a width: clipped that low they are flat, and wide ones count for more.
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
    # The feet that far from 1e2 are rounded to 1e-14, 1e-9 of the width.
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
@pytest.mark.parametrize("dtype", DTYPES)
@settings(max_examples=150)
@given(data=st.data())
def test_gains_are_never_nan_and_stay_inside_the_output(
    dtype: str, options: dict, data: st.DataObject
) -> None:
    inputs, outputs = data.draw(TERMS), 100 * data.draw(TERMS)
    crisp = np.array(data.draw(st.lists(st.tuples(CRISP, CRISP), min_size=8, max_size=8)))
    with jax.enable_x64(dtype == "float64"):
        controller = fuzzy(inputs, outputs, dtype, **options)
        held = jnp.asarray(1 + outputs.min(), dtype)
        gains = np.asarray(_called(controller, *jnp.asarray(crisp, dtype).T, held))
    assert gains.dtype == dtype
    # Sums over the whole output round by a few units at 100.
    slack = 1e-3 if dtype == "float32" else 1e-10
    assert (gains >= 1 + outputs.min() - slack).all()
    assert (gains <= 1 + outputs.max() + slack).all()


_called = jax.jit(jax.vmap(FuzzyController.__call__, in_axes=(None, 0, 0, None)))


# Continuity and derivatives -----------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("seed", range(3))
def test_the_gain_is_continuous(seed: int) -> None:
    inputs, outputs = (t[0] for t in repaired_terms(search_vectors(1, seed)))
    controller = fuzzy(inputs, outputs)
    start, end = np.random.default_rng(seed).random((2, 2))

    def largest_jump(steps: int) -> float:
        line = start + np.linspace(0, 1, steps + 1)[:, None] * (end - start)
        return float(np.abs(np.diff(evaluated(controller, *line.T))).max())

    # A jump would be as large however short the steps are. A steep place is not a jump: terms may
    # overlap by 0.01 only, and the gain then changes by tens within a fraction of that.
    assert largest_jump(1_000_000) < 0.1 * largest_jump(1000)


@cache
def derivatives() -> Callable[..., Array]:
    """Derivatives (B, 2) of the gain by error and rate; B = 200 always, to compile it once."""

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
    # Clipped inputs have no influence, the others some.
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
    # VS peaks at 0 and VL at 1, with their vertical edge there, at the end of what is looked at.
    corners = np.array([[0.0, 0], [0, 1], [1, 0], [1, 1]])
    with jax.enable_x64(dtype == "float64"):
        arrays = (np.repeat([INPUTS], 200, axis=0), np.repeat([OUTPUTS], 200, axis=0))
        x = np.repeat(corners, 50, axis=0)
        slope = np.asarray(derivatives()(*(jnp.asarray(a, dtype) for a in (x, *arrays))))
    # The steepest edge that is not vertical, over the whole output.
    widths = np.diff(INPUTS, axis=1)
    assert np.abs(slope).max() <= 100 / widths[widths > 0].min()


# Under JAX's transformations ----------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"centroid": "sampled"}], ids=["exact", "sampled"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_jit_and_vmap_equal_single_calls(dtype: str, options: dict) -> None:
    error, rate, last = np.random.default_rng(0).random((3, 2, 4))
    with jax.enable_x64(dtype == "float64"):
        controller = fuzzy(GAPPED, OUTPUTS, dtype, **options)
        arrays = tuple(jnp.asarray(a, dtype) for a in (error, rate, last))
        called = FuzzyController.__call__
        single = jax.jit(called)
        each = [
            [float(single(controller, *x)) for x in zip(*row, strict=True)]
            for row in zip(*arrays, strict=True)
        ]
        by_row = jax.vmap(called, in_axes=(None, 0, 0, 0))
        forms = {
            "eager": controller(*arrays),
            "jit": single(controller, *arrays),
            "vmap": jax.jit(jax.vmap(by_row, in_axes=(None, 0, 0, 0)))(controller, *arrays),
        }
    # Other orders of sums, and fused multiply-adds.
    tolerance = 100 * np.finfo(dtype).eps
    for name, gains in forms.items():
        assert gains.dtype == dtype, name
        np.testing.assert_allclose(gains, each, rtol=tolerance, err_msg=name)
    assert (np.asarray(each) == last.astype(dtype)).any()  # some held the last gain


def test_inputs_are_clipped_and_broadcast() -> None:
    controller = fuzzy(INPUTS, OUTPUTS, "float32")
    ends = evaluated(controller, [0.0, 1.0], [1.0, 0.0])
    np.testing.assert_array_equal(evaluated(controller, [-3.0, 1.5], [7.0, -0.1]), ends)
    assert evaluated(controller, np.zeros((3, 2)), 0.5).shape == (3, 2)
    assert controller(0.3, 0.2).shape == ()


def test_the_surfaces_rows_are_the_rate() -> None:
    controller = fuzzy(INPUTS, OUTPUTS, "float32")
    error, rate, gains = controller.surface(6)
    np.testing.assert_array_equal(error, np.linspace(0, 1, 6, dtype=np.float32))
    np.testing.assert_array_equal(rate, error)
    for r, e in np.ndindex(6, 6):
        np.testing.assert_allclose(gains[r, e], controller(error[e], rate[r]), rtol=1e-5)
    assert not np.allclose(gains, gains.T)
    assert controller.surface()[2].shape == (101, 101)


# What makes no controller -------------------------------------------------------------------------


def changed(terms: np.ndarray, i: int, values: list[float]) -> np.ndarray:
    return np.concatenate([terms[:i], [values], terms[i + 1 :]])


REFUSED = {
    "shape": (
        {"inputs": np.zeros((5, 2))},
        r"input_terms: must have the shape \(terms, 3\).*\(5, 2\)",
    ),
    "one term flat": ({"outputs": np.zeros(3)}, r"output_terms: must have the shape.*\(3,\)"),
    "no terms": ({"outputs": np.zeros((0, 3))}, r"output_terms: must have the shape.*\(0, 3\)"),
    "nan": ({"inputs": changed(INPUTS, 1, [0, np.nan, 0.2])}, "input_terms: must be finite.*nan"),
    "infinite": (
        {"outputs": changed(OUTPUTS, 4, [50, 100, np.inf])},
        "output_terms: must be finite",
    ),
    "triangle": (
        {"inputs": changed(INPUTS, 1, [0.1, 0.05, 0.2])},
        "input_terms: each term must ascend",
    ),
    "across terms": (
        {"outputs": changed(OUTPUTS, 2, [0, 0, 0])},
        "output_terms: the a's, b's and c's must each ascend.*centroid=\"sampled\"",
    ),
    "few rows": ({"rules": RULES[:4]}, "rules: must be 5 rows of 5"),
    "short row": ({"rules": (*RULES[:4], (1, 2))}, "rules: must be 5 rows of 5"),
    "unknown output": (
        {"rules": (*RULES[:4], (0, 0, 0, 0, 5))},
        "rules: entries must be output terms 0 to 4",
    ),
    "negative output": (
        {"rules": (*RULES[:4], (0, 0, 0, 0, -1))},
        "rules: entries must be.*0 to 4",
    ),
    "points": ({"centroid": "sampled", "points": 1}, "points: must be at least 2, got 1"),
    "range": ({"output_range": (100.0, 0.0)}, r"output_range: must ascend, got \(100.0, 0.0\)"),
    "negative reach": ({"reach": -1}, "reach: must be a whole number from 0, or None, got -1"),
    "short reach": ({"reach": 0}, "reach: must not be 0, as output terms 1 apart overlap"),
}


@pytest.mark.parametrize(("given", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_refused(given: dict, message: str) -> None:
    with pytest.raises(FuzzyError, match=message):
        fuzzy(**({"inputs": INPUTS, "outputs": OUTPUTS, "dtype": "float32"} | given))


def test_terms_as_numpy_arrays_are_checked_too() -> None:
    with pytest.raises(FuzzyError, match="input_terms: each term must ascend"):
        FuzzyController(INPUTS[:, ::-1], OUTPUTS, RULES, (0.0, 100.0))


def test_the_sampled_centroid_takes_terms_in_any_order() -> None:
    controller = fuzzy(INPUTS, OUTPUTS, "float32", centroid="sampled")
    shuffled = [3, 0, 4, 1, 2]
    rules = tuple(tuple(shuffled.index(i) for i in row) for row in RULES)
    again = fuzzy(INPUTS, OUTPUTS[shuffled], "float32", centroid="sampled", rules=rules)
    np.testing.assert_allclose(again(0.2, 0.3), controller(0.2, 0.3), rtol=1e-6)


def test_changing_an_option_of_a_controller_checks_it_again() -> None:
    controller = fuzzy(INPUTS, OUTPUTS[::-1], "float32", centroid="sampled")
    with pytest.raises(FuzzyError, match="output_terms: the a's"):
        dataclasses.replace(controller, centroid="exact")
