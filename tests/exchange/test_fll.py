"""fuzzylite's format, read by fuzzylite and pyfuzzylite."""

import numpy as np
import pytest
from helpers.fuzzy_readers import (
    CASES,
    by_midpoints,
    controller,
    exact,
    inputs,
    needs_fuzzylite,
    with_fuzzylite,
)
from helpers.schedules import DRAWN, GAPS, MIDRANGE, tuned

import posegsa
from posegsa.exchange.fll import RESOLUTION

pytestmark = pytest.mark.quick


def with_pyfuzzylite(text: str, given: np.ndarray) -> np.ndarray:
    """The outputs of pyfuzzylite for a file's text, one for each row of inputs."""
    fuzzylite = pytest.importorskip("fuzzylite", reason="pyfuzzylite is not installed")
    engine = fuzzylite.FllImporter().from_string(text)
    read = []
    for error, rate in given.tolist():
        engine.input_variable("error").value = error
        engine.input_variable("rate").value = rate
        engine.process()
        read.append(float(np.squeeze(engine.output_variable("gain_minus_1").value)))
    return np.array(read)


def held(values: np.ndarray, first: float) -> np.ndarray:
    """Each NaN replaced by the value before it."""
    found = []
    for value in values.tolist():
        found.append((found or [first])[-1] if np.isnan(value) else value)
    return np.array(found)


@needs_fuzzylite
@pytest.mark.parametrize("case", CASES)
def test_fuzzylite_reads_the_gain(case, tmp_path):
    one, given = controller(case), inputs()
    read = with_fuzzylite(posegsa.export_fll(one), "fll", given, tmp_path)
    expected = held(by_midpoints(one, given, RESOLUTION), 50.0)
    np.testing.assert_allclose(read, expected, rtol=1e-10)
    # It is less accurate at vertical edges, and next to gaps, where a term may be clipped so low
    # that only a few parts contain it.
    assert np.nanquantile(np.abs(read - exact(one, given)), 0.9) < 0.02


@pytest.mark.parametrize("case", CASES)
def test_pyfuzzylite_reads_the_gain(case):
    one, given = controller(case), inputs(15)
    read = with_pyfuzzylite(posegsa.export_fll(one), given)
    np.testing.assert_allclose(read, held(by_midpoints(one, given, RESOLUTION), 50.0), rtol=1e-10)


@needs_fuzzylite
@pytest.mark.parametrize(("settings", "holds"), [(GAPS, True), (MIDRANGE, False)])
def test_where_no_rule_fires_it_holds_or_takes_the_middle(settings, holds, tmp_path):
    one = tuned(DRAWN[0], *settings, dtype="float64").controller
    given = inputs()
    gaps = np.isnan(exact(one, given))
    assert gaps.any()
    assert not gaps[0]
    read = with_fuzzylite(posegsa.export_fll(one), "fll", given, tmp_path)
    before = np.roll(read, 1)
    np.testing.assert_array_equal(read[gaps], before[gaps] if holds else 50.0)
    first = given[gaps][:1]
    assert with_fuzzylite(posegsa.export_fll(one), "fll", first, tmp_path) == [50.0]


@needs_fuzzylite
def test_inputs_are_clipped(tmp_path):
    text = posegsa.export_fll(controller("covering"))
    outside, at_ends = np.array([[-0.5, 1.7], [1.2, 0.3]]), np.array([[0.0, 1.0], [1.0, 0.3]])
    read, expected = (with_fuzzylite(text, "fll", given, tmp_path) for given in (outside, at_ends))
    np.testing.assert_array_equal(read, expected)
