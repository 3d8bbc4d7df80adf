"""IEC 61131-7: as pyit2fls reads it, and fuzzylite after the changes of docs/export-formats.md."""

import re
import warnings
from importlib import import_module

import numpy as np
import pytest
from helpers.fuzzy_readers import (
    CASES,
    by_midpoints,
    by_samples,
    controller,
    exact,
    inputs,
    needs_fuzzylite,
    with_fuzzylite,
)
from helpers.schedules import GAPS, MIDRANGE, K, tuned

import posegsa

pytestmark = pytest.mark.quick


def for_fuzzylite(text: str) -> str:
    """Its dialect: ACCU belongs to the output, and a default is a number."""
    text = text.replace("  ACCU : MAX;\n", "")
    return text.replace("  METHOD : COG;\n", "  METHOD : COG;\n  ACCU : MAX;\n").replace(
        "DEFAULT := NC;", "DEFAULT := 50.0 | NC;"
    )


@needs_fuzzylite
@pytest.mark.parametrize("case", ["covering", "vertical"])
def test_fuzzylite_reads_the_gain(case, tmp_path):
    one, given = controller(case), inputs()
    given = given[np.isfinite(exact(one, given))]
    read = with_fuzzylite(for_fuzzylite(posegsa.export_fcl(one)), "fcl", given, tmp_path)
    np.testing.assert_allclose(read, by_midpoints(one, given, 100), rtol=1e-10)


def with_pyit2fls(text: str, given: np.ndarray, points: int, monkeypatch) -> np.ndarray:
    """What pyit2fls reads in a text, with so many points along each variable."""
    module = pytest.importorskip("pyit2fls.FCL", reason="pyit2fls is not installed")
    monkeypatch.setattr(import_module("pyit2fls.FML"), "DOMAIN_RESOLUTION", points)
    reader = module.FCL()
    name, variables, rules = reader.parse_fcl(text)
    assert name == "posegsa_gain"
    assert len(rules["rules"]) == 25
    system = reader.generate(variables, rules)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 0 / 0 where no rule fires
        return np.array(
            [system.evaluate({"error": e, "rate": r})[1]["gain_minus_1"] for e, r in given.tolist()]
        )


@pytest.mark.parametrize("case", CASES)
def test_pyit2fls_reads_the_gain(case, monkeypatch):
    one, given = controller(case), inputs(40)
    read = with_pyit2fls(posegsa.export_fcl(one), given, 401, monkeypatch)
    ends = np.ones(401)
    ends[[0, -1]] = 0.5  # the trapezoidal rule
    expected = by_samples(one, given, np.linspace(0, 100, 401), ends)
    np.testing.assert_allclose(read, expected, rtol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_what_stands_in_it_is_the_controller(case):
    """Read by the grammar of the standard: terms are points, with all digits."""
    one = controller(case)
    text = re.sub(r"//.*", "", posegsa.export_fcl(one))
    for keyword, name, terms, (low, high) in (
        ("FUZZIFY", "error", one.input_terms, (0, 1)),
        ("FUZZIFY", "rate", one.input_terms, (0, 1)),
        ("DEFUZZIFY", "gain_minus_1", one.output_terms, one.output_range),
    ):
        (body,) = re.findall(rf"\b{keyword} {name}\n(.*?)END_{keyword}", text, re.DOTALL)
        lines = re.findall(r"TERM (\w+) := (.*);", body)
        assert [term for term, _ in lines] == ["VS", "S", "M", "L", "VL"]
        for (_, points), (a, b, c) in zip(lines, np.asarray(terms).tolist(), strict=True):
            found = [(float(x), float(y)) for x, y in re.findall(r"\((\S+), (\d)\)", points)]
            corners = [(a, 0.0), (b, 1.0), (c, 0.0)]
            expected = [p for p in corners if p[1] or not (p[0] == b and b in (low, high))]
            assert found == expected
    rules = re.findall(
        r"RULE (\d+) : if error is (\w+) and rate is (\w+) then gain_minus_1 is (\w+);", text
    )
    assert [int(number) for number, *_ in rules] == list(range(1, 26))
    index = ["VS", "S", "M", "L", "VL"].index
    for _, error, rate, output in rules:
        assert one.rules[index(rate)][index(error)] == index(output)
    assert "RANGE := (0.0 .. 100.0);" in text


def test_it_says_whether_it_holds():
    held, middle = (posegsa.export_fcl(tuned(K, *more)) for more in (GAPS, MIDRANGE))
    assert "DEFAULT := NC;" in held
    assert "DEFAULT := 50.0;" in middle
    assert "NC (no change) keeps the last output" in held
