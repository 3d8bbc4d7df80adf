"""A controller read back from .fis and .fll, and what is refused."""

import dataclasses

import jax
import numpy as np
import pytest
from helpers.fuzzy_readers import CASES, controller
from helpers.schedules import MIDRANGE, K, tuned

import posegsa
from posegsa.errors import ArgumentError, FuzzyError
from posegsa.model.fuzzy import FuzzyController

pytestmark = pytest.mark.quick

WRITERS = {"fis": posegsa.export_fis, "fll": posegsa.export_fll}


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("case", CASES)
def test_a_controller_comes_back_as_it_was(form, case, tmp_path):
    one = controller(case)
    path = tmp_path / f"gain.{form}"
    path.write_text(WRITERS[form](one), encoding="utf-8")
    with jax.enable_x64(True):
        # A .fis can't state that the last gain is kept.
        again = posegsa.load_controller(path, no_rule="hold" if form == "fis" else None)
    for field in dataclasses.fields(FuzzyController):
        if field.name not in ("reach", "sampled_points"):
            np.testing.assert_array_equal(getattr(again, field.name), getattr(one, field.name))
    assert again.output_terms.dtype == np.float64


@pytest.mark.parametrize("form", WRITERS)
def test_of_a_run_in_float32_too(form, tmp_path):
    one = tuned(K, *MIDRANGE).controller
    path = tmp_path / f"gain.{form}"
    path.write_text(WRITERS[form](tuned(K, *MIDRANGE)), encoding="utf-8")
    again = posegsa.load_controller(path)
    assert again.no_rule == "midrange"
    np.testing.assert_array_equal(again.input_terms, one.input_terms)
    np.testing.assert_array_equal(again.output_terms, one.output_terms)


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("offset", [0.0, 0.25, 12.0])
def test_the_offset_of_the_gain_is_in_the_outputs_name(form, offset, tmp_path):
    one = dataclasses.replace(controller("covering"), offset=offset)
    text = WRITERS[form](one)
    assert f"K = {offset:g} + output" in " ".join(text.replace("#", " ").replace("%", " ").split())
    path = tmp_path / f"gain.{form}"
    path.write_text(text, encoding="utf-8")
    assert posegsa.load_controller(path, no_rule="hold").offset == offset


def test_inputs_in_the_other_order(tmp_path):
    path = tmp_path / "gain.fis"
    text = posegsa.export_fis(controller("covering"))
    one, other = "[Input1]\nName='error'", "[Input2]\nName='rate'"
    assert one in text
    swapped = text.replace(one, "[Input1]\nName='rate'").replace(other, "[Input2]\nName='error'")
    path.write_text(swapped, encoding="utf-8")
    rules = posegsa.load_controller(path).rules
    assert rules == tuple(zip(*controller("covering").rules, strict=True))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Type='mamdani'", "Type='sugeno'", r"Type = 'sugeno'; allowed: 'mamdani'"),
        ("AndMethod='min'", "AndMethod='prod'", "AndMethod = 'prod'; allowed: 'min'"),
        ("DefuzzMethod='centroid'", "DefuzzMethod='mom'", "DefuzzMethod = 'mom'"),
        ("[Rules]", "[Rulez]", r"\[Rules\]: missing"),
        ("Name='rate'", "Name='speed'", "inputs: named error, speed; allowed: error and rate"),
        ("Range=[0.0 1.0]", "Range=[0.0 2.0]", r"error: has the range \[0, 2\]"),
        ("Range=[0.0 1.0]", "Range=[zero]", r"\[Input1\] Range: must be 2 numbers"),
        ("[0.0 100.0]", "[0.0 50.0]", "cut off by the range .0, 50."),
        ("'trimf'", "'gaussmf'", r"\[Input1\] MF1: a 'gaussmf'; allowed: 'trimf'"),
        ("MF1='VS':'trimf',[-1.0 0.0", "MF1='VS':'trimf',[-1.0 nan", "the term VS must be finite"),
        ("\n1 1, 1 (1) : 1", "", "rules: 0 of them for error is VS, rate is VS"),
        ("\n1 1, 1 (1) : 1", "\n1 1, 1 (0.5) : 1", r"weight \(1\) and connector 1"),
        ("\n1 1, 1 (1) : 1", "\n1 1, 1 (1) : 2", r"weight \(1\) and connector 1"),
        ("\n1 1, 1 (1) : 1", "\n1 -1, 1 (1) : 1", "rate has no term -1"),
        ("\n1 1, 1 (1) : 1", "\n1 1, 9 (1) : 1", "gain_minus_1 has no term 9"),
        ("\n1 1, 1 (1) : 1", "\n1 1, 1 (1) : 1\n1 1, 2 (1) : 1", "rules: 2 of them"),
        ("[System]", "System", "a .fis must start with"),
        ("Version=2.0", "Version 2.0", "must be key=value"),
    ],
)
def test_another_fis_is_refused_by_what_is_wrong(old, new, message, tmp_path):
    text = posegsa.export_fis(controller("covering"))
    assert old in text
    path = tmp_path / "other.fis"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FuzzyError, match=rf"other\.fis: .*({message})"):
        posegsa.load_controller(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("conjunction: Minimum", "conjunction: AlgebraicProduct", "rules: conjunction 'Algebr"),
        ("aggregation: Maximum", "aggregation: BoundedSum", "gain_minus_1: aggregation 'Bounded"),
        ("defuzzifier: Centroid 1000", "defuzzifier: Bisector 1000", "defuzzifier 'Bisector'"),
        ("InputVariable: rate", "InputVariable: speed", "inputs: named error, speed"),
        ("enabled: true", "enabled: false", "error: not enabled"),
        ("range: 0.0 1.0", "range: 0.0", "error: range: must be 2 numbers, got '0.0'"),
        ("VS Triangle", "VS Gaussian", "term VS is a 'Gaussian'"),
        ("if error is VS and", "if error is very VS and", "must be like 'if error is VS"),
        ("if error is VS and", "if error is VS or", "must be like 'if error is VS"),
        ("if error is VS and", "if error is XS and", "needs error is one of VS, S, M, L, VL"),
        ("RuleBlock: rules", "RuleBlock: rules\nRuleBlock: more", "has Engine, InputVariable"),
        ("lock-previous: true", "lock-previous: false\n  default: nan", "2 lines 'default: ...'"),
        ("Engine: posegsa_gain", "", "has InputVariable, InputVariable"),
    ],
)
def test_another_fll_is_refused_by_what_is_wrong(old, new, message, tmp_path):
    text = posegsa.export_fll(controller("covering"))
    assert old in text
    path = tmp_path / "other.fll"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FuzzyError, match=rf"other\.fll: .*{message}"):
        posegsa.load_controller(path)


def test_what_no_file_says_must_be_given(tmp_path):
    text = posegsa.export_fll(controller("gaps"))
    path = tmp_path / "gain.fll"
    unsaid = text.replace("lock-previous: true", "lock-previous: false")
    path.write_text(unsaid.replace("default: 50.0", "default: nan"), encoding="utf-8")
    with pytest.raises(FuzzyError, match="no_rule: not stated in the file"):
        posegsa.load_controller(path)
    assert posegsa.load_controller(path, no_rule="hold").no_rule == "hold"


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"ends in \.fis or \.fll"):
        posegsa.load_controller(tmp_path / "gain.txt")
    with pytest.raises(FuzzyError, match="does not exist"):
        posegsa.load_controller(tmp_path / "gain.fis")
    with pytest.raises(ArgumentError, match="no_rule = 'zero'"):
        posegsa.load_controller(tmp_path / "gain.fis", no_rule="zero")  # type: ignore[arg-type]  # wrong on purpose
    (tmp_path / "gain.fis").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FuzzyError, match="cannot be read"):
        posegsa.load_controller(tmp_path / "gain.fis")
    (tmp_path / "large.fis").write_bytes(b"%" * (2**20 + 1))
    with pytest.raises(FuzzyError, match="more than 1048576 bytes"):
        posegsa.load_controller(tmp_path / "large.fis")


def test_a_controller_of_another_size(tmp_path):
    terms = np.array([[0.0, 0.0, 0.6], [0.4, 1.0, 1.0]])
    small = FuzzyController(terms, 20 * terms, ((0, 1), (1, 1)), (0.0, 20.0))
    for form, write in WRITERS.items():
        path = tmp_path / f"small.{form}"
        path.write_text(write(small), encoding="utf-8")
        again = posegsa.load_controller(path)
        assert (again.rules, again.output_range) == (small.rules, (0.0, 20.0))
        np.testing.assert_array_equal(again.input_terms, small.input_terms)
