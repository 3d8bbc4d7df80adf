"""Fuzzy inference against the reference and scikit-fuzzy: rules, memberships, controllers."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import skfuzzy
from helpers import reference
from helpers.controllers import (
    GAPPED,
    INPUTS,
    OUTPUTS,
    RULES,
    corner_vectors,
    evaluated,
    fuzzy,
    gains_of,
    repaired_terms,
    search_vectors,
)
from helpers.experiments import PAPER

from posegsa.errors import FuzzyError
from posegsa.model.fuzzy import FuzzyController
from posegsa.search.search_spaces import rule_indices

DTYPES = ("float32", "float64")


# Rules and memberships ----------------------------------------------------------------------------


def test_the_configured_rules_are_the_papers() -> None:
    assert rule_indices(PAPER.fuzzy.rules) == RULES
    # Corners of Table I, read by hand: smallest error and rate, one of them large, both large.
    assert (RULES[0][0], RULES[0][4], RULES[4][0], RULES[4][4]) == (0, 4, 3, 4)


EDGES = [
    *INPUTS.tolist(),
    *([0, 0, 0.3], [0.7, 1, 1], [0.4, 0.4, 0.6], [0.2, 0.5, 0.5]),  # vertical edges
    *([0.5, 0.5, 0.5], [0, 0, 0], [1, 1, 1]),  # no width
]


@pytest.mark.usefixtures("x64")
def test_memberships_against_the_reference_and_scikit_fuzzy() -> None:
    x = np.unique(np.concatenate([np.linspace(0, 1, 201), np.ravel(EDGES)]))
    # One term at a time as VS, all others out of reach, on the diagonal of the table:
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
    # draws a vertical edge as a slope of one spacing, 0.005. The quadrature test shows that the
    # error is theirs.
    assert off.max() < (2e-3 if vectors is search_vectors else 4e-3)
    assert (off < 2e-3).mean() > 0.98
    assert np.median(off) < 1e-6
    rules = reference.PAPER_RULES
    heights = [reference.firing_heights(e, r, i, rules) for e, r, i, _ in cases]
    exact = [reference.centroid_by_quadrature(h, o) for h, o in zip(heights, outputs, strict=True)]
    np.testing.assert_allclose(gains - 1, exact, rtol=0, atol=1e-9)


# Under JAX's transformations ----------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_arrays_and_vmap_equal_single_calls() -> None:
    error, rate, last = np.random.default_rng(0).random((3, 2, 4))
    controller = fuzzy(GAPPED, OUTPUTS, centroid="sampled")
    called = FuzzyController.__call__
    each = [
        [float(controller(*x)) for x in zip(*row, strict=True)]
        for row in zip(error, rate, last, strict=True)
    ]
    by_row = jax.vmap(called, in_axes=(None, 0, 0, 0))
    forms = {
        "arrays": controller(error, rate, last),
        "vmap": jax.jit(jax.vmap(by_row, in_axes=(None, 0, 0, 0)))(controller, error, rate, last),
    }
    # Other orders of sums, and fused multiply-adds.
    for name, gains in forms.items():
        np.testing.assert_allclose(gains, each, rtol=100 * np.finfo(float).eps, err_msg=name)
    assert (np.asarray(each) == last).any()  # some kept the last gain


def test_inputs_are_clipped_and_broadcast(caplog: pytest.LogCaptureFixture) -> None:
    controller = fuzzy(INPUTS, OUTPUTS, "float32")
    ends = evaluated(controller, [0.0, 1.0], [1.0, 0.0])
    np.testing.assert_array_equal(evaluated(controller, [-3.0, 1.5], [7.0, -0.1]), ends)
    assert evaluated(controller, np.zeros((3, 2)), 0.5).shape == (3, 2)
    assert controller(0.3, 0.2).shape == ()
    # Outside of jit a call is itself a compiled program, reused for other numbers and controllers.
    other = dataclasses.replace(controller, output_terms=0.5 * controller.output_terms)
    with jax.log_compiles():
        assert float(controller(0.4, 0.1)) != float(other(0.4, 0.1))
        assert "Compiling" not in caplog.text
        controller(np.zeros(7), 0.1)
        assert "Compiling" in caplog.text


def test_the_surfaces_rows_are_the_rate() -> None:
    controller = fuzzy(INPUTS, OUTPUTS, "float32")
    error, rate, gains = controller.surface(6)
    np.testing.assert_array_equal(error, np.linspace(0, 1, 6, dtype=np.float32))
    np.testing.assert_array_equal(rate, error)
    for r, e in np.ndindex(6, 6):
        np.testing.assert_allclose(gains[r, e], controller(error[e], rate[r]), rtol=1e-5)
    assert not np.allclose(gains, gains.T)


# Invalid controllers ------------------------------------------------------------------------------


def changed(terms: np.ndarray, i: int, values: list[float]) -> np.ndarray:
    return np.concatenate([terms[:i], [values], terms[i + 1 :]])


REFUSED = {
    "shape": (
        {"inputs": np.zeros((5, 2))},
        r"input_terms:.* \(terms, 3\).*\(5, 2\)",
    ),
    "one term flat": ({"outputs": np.zeros(3)}, r"output_terms: must have the shape.*\(3,\)"),
    "no terms": ({"outputs": np.zeros((0, 3))}, r"output_terms: must have the shape.*\(0, 3\)"),
    "nan": ({"inputs": changed(INPUTS, 1, [0, np.nan, 0.2])}, r"input_terms:.*finite.*nan"),
    "infinite": (
        {"outputs": changed(OUTPUTS, 4, [50, 100, np.inf])},
        r"output_terms:.*finite",
    ),
    "triangle": (
        {"inputs": changed(INPUTS, 1, [0.1, 0.05, 0.2])},
        "input_terms: each term must ascend",
    ),
    "across terms": (
        {"outputs": changed(OUTPUTS, 2, [0, 0, 0])},
        "output_terms: the a's, b's and c's must each ascend.*centroid=\"sampled\"",
    ),
    "few rows": ({"rules": RULES[:4]}, r"rules:.* 5 rows of 5"),
    "short row": ({"rules": (*RULES[:4], (1, 2))}, r"rules:.* 5 rows of 5"),
    "unknown output": (
        {"rules": (*RULES[:4], (0, 0, 0, 0, 5))},
        "rules: entries must be output terms 0 to 4",
    ),
    "negative output": (
        {"rules": (*RULES[:4], (0, 0, 0, 0, -1))},
        "rules: entries must be.*0 to 4",
    ),
    "sampled_points": (
        {"centroid": "sampled", "sampled_points": 1},
        r"sampled_points:.* at least 2.* 1",
    ),
    "range": ({"output_range": (100.0, 0.0)}, r"output_range: must ascend.* \(100.0, 0.0\)"),
    "ends that are no tuple": (
        {"output_range": [0.0, 100.0]},
        r"output_range:.* a tuple of two finite numbers.* \[0.0, 100.0\]",
    ),
    "rules as lists": (
        {"rules": [list(row) for row in RULES]},
        r"rules:.* a tuple of tuples of output terms",
    ),
    "infinite offset": (
        {"offset": np.inf},
        r"offset:.* a finite number of at least 0.* inf",
    ),
    "negative reach": ({"reach": -1}, r"reach:.* a whole number from 0, or None.* -1"),
    "short reach": ({"reach": 0}, "reach: must not be 0, as output terms 1 apart overlap"),
}


@pytest.mark.parametrize(("given", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_refused(given: dict, message: str) -> None:
    with pytest.raises(FuzzyError, match=message):
        fuzzy(**({"inputs": INPUTS, "outputs": OUTPUTS, "dtype": "float32"} | given))


def test_terms_as_numpy_arrays_are_checked_too() -> None:
    words: Any = [["small"] * 3] * 5
    with pytest.raises(FuzzyError, match=r"input_terms:.*array of numbers"):
        FuzzyController(words, OUTPUTS, RULES, (0.0, 100.0))
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


def test_nan_input_gives_a_nan_gain() -> None:
    controller = fuzzy(INPUTS, OUTPUTS, "float32")
    assert np.isnan(controller(np.nan, 0.1))
    assert np.isnan(controller(error=0.1, rate=np.nan, last=3.0))
    gains = controller(np.array([0.1, np.nan]), np.array([0.1, 0.1]))
    np.testing.assert_array_equal(np.isnan(gains), [False, True])
    np.testing.assert_array_equal(gains[0], controller(0.1, 0.1))
