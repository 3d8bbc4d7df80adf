"""IEEE 1855: by the standard's elements, and as pyit2fls reads it under the names that it knows.

pyit2fls 0.9 knows the names that the language had before the standard: `FuzzySystem` and so on, and
clauses by attributes.
"""

import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from helpers.fuzzy_readers import CASES, by_samples, controller, inputs
from helpers.schedules import GAPS, MIDRANGE, K, tuned

import posegsa

pytestmark = pytest.mark.quick

STANDARD = {"f": "http://www.ieee1855.org"}


def before_the_standard(text: str) -> str:
    """The same with older names."""
    root = ET.fromstring(text)
    old = ET.Element("FuzzySystem", name=root.get("name", ""))
    base = ET.SubElement(old, "KnowledgeBase")
    for variable in root.findall("f:knowledgeBase/f:fuzzyVariable", STANDARD):
        renamed = ET.SubElement(base, "FuzzyVariable", variable.attrib)
        for term in variable:
            (shape,) = term
            copy = ET.SubElement(renamed, "FuzzyTerm", term.attrib)
            ET.SubElement(copy, shape.tag.partition("}")[2], shape.attrib)
    (rules,) = root.findall("f:mamdaniRuleBase", STANDARD)
    renamed = ET.SubElement(old, "RuleBase", {**rules.attrib, "type": "mamdani"})
    for rule in rules:
        copy = ET.SubElement(renamed, "Rule", rule.attrib)
        for part, where in (("Antecedent", "f:antecedent"), ("Consequent", "f:consequent/f:then")):
            clauses = ET.SubElement(copy, part)
            for clause in rule.findall(f"{where}/f:clause", STANDARD):
                words = [clause.findtext(f"f:{tag}", "", STANDARD) for tag in ("variable", "term")]
                ET.SubElement(clauses, "Clause", dict(zip(("var", "term"), words, strict=True)))
    return ET.tostring(old, encoding="unicode")


@pytest.mark.parametrize("case", CASES)
def test_pyit2fls_reads_the_gain(case, monkeypatch):
    module = pytest.importorskip("pyit2fls.FML", reason="pyit2fls is not installed")
    monkeypatch.setattr(module, "DOMAIN_RESOLUTION", 401)
    one, given = controller(case), inputs(40)
    reader = module.FML()
    _, variables, rules = reader.parse_fml(before_the_standard(posegsa.export_fml(one)))
    system = reader.generate(variables, rules)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 0 / 0 where no rule fires
        read = [
            system.evaluate({"error": e, "rate": r})[1]["gain_minus_1"] for e, r in given.tolist()
        ]
    ends = np.ones(401)
    ends[[0, -1]] = 0.5  # the trapezoidal rule
    expected = by_samples(one, given, np.linspace(0, 100, 401), ends)
    np.testing.assert_allclose(read, expected, rtol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_what_stands_in_it_is_the_controller(case):
    one = controller(case)
    root = ET.fromstring(posegsa.export_fml(one))
    assert root.tag == "{http://www.ieee1855.org}fuzzySystem"
    variables = root.findall("f:knowledgeBase/f:fuzzyVariable", STANDARD)
    assert [v.get("name") for v in variables] == ["error", "rate", "gain_minus_1"]
    assert [v.get("type") for v in variables] == ["input", "input", "output"]
    ends = [(float(v.get("domainleft", "")), float(v.get("domainright", ""))) for v in variables]
    assert ends == [(0, 1), (0, 1), one.output_range]
    assert variables[2].get("scale") == "1/s"
    assert (variables[2].get("accumulation"), variables[2].get("defuzzifier")) == ("MAX", "COG")
    names = {}
    for variable, terms in zip(
        variables, (one.input_terms, one.input_terms, one.output_terms), strict=True
    ):
        shapes = variable.findall("f:fuzzyTerm/f:triangularShape", STANDARD)
        feet = [[float(shape.get(f"param{i}", "")) for i in (1, 2, 3)] for shape in shapes]
        np.testing.assert_array_equal(feet, terms)  # all digits
        names[variable.get("name")] = [term.get("name") for term in variable]
    (rules,) = root.findall("f:mamdaniRuleBase", STANDARD)
    assert rules.attrib["andMethod"] == rules.attrib["activationMethod"] == "MIN"
    assert len(rules) == 25
    for rule in rules:
        term = {
            clause.findtext("f:variable", "", STANDARD): clause.findtext("f:term", "", STANDARD)
            for clause in rule.iter("{http://www.ieee1855.org}clause")
        }
        e, r, k = (names[name].index(term[name]) for name in ("error", "rate", "gain_minus_1"))
        assert one.rules[r][e] == k


def test_names_are_unique_as_the_schema_wants_it():
    root = ET.fromstring(posegsa.export_fml(controller("covering")))
    names = [element.get("name") for element in root.iter() if element.get("name")]
    assert len(set(names)) == len(names) > 40


def test_the_comment_says_what_the_format_cannot():
    held, middle = (posegsa.export_fml(tuned(K, *more)) for more in (GAPS, MIDRANGE))
    for text in (held, middle):
        head = " ".join(text.partition("-->")[0].split())
        assert "the gain is K = 1 + output [1/s]" in head
        assert "error = e / " in head
        ET.fromstring(text)  # no "--" in the comment
    assert "keep the last output" in " ".join(held.split())
    assert "keep the last output" not in " ".join(middle.split())
    assert 'defaultValue="50.0"' in middle
