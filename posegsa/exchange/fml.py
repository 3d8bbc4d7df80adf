"""IEEE 1855-2016, Fuzzy Markup Language, `.fml`: written.

The standard's elements, namespace and units (`scale`). It can say neither that the last gain is
kept where no rule fires, nor how the centroid is computed; its numbers are `xs:float`, so that a
reader may round them to float32, which is what a run in float32 had.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from posegsa.exchange.system import NAME, System, Variable, commented, limits, system_of
from posegsa.model.fuzzy import FuzzyController

NAMESPACE = "http://www.ieee1855.org"


def to_fml(controller: FuzzyController, about: Sequence[str] = ()) -> str:
    """A controller for JFML and other readers of the standard.

    Args:
        controller: It.
        about: Lines for the comment at the head.

    Raises:
        ArgumentError: It is no controller.
        FuzzyError: It is a batch of several.
    """
    system = system_of(controller)
    notes = [limits(system.offset)]
    if system.no_rule == "hold":
        notes.append(
            "Where no rule fires, keep the last output; the standard can only name a default, "
            f"which is {system.middle!r}, the middle of the range, with which to begin."
        )
    root = ET.Element("fuzzySystem", {"xmlns": NAMESPACE, "name": NAME})
    base = ET.SubElement(root, "knowledgeBase")
    for one in (system.error, system.rate):
        _add_variable(base, one, {"scale": "", "type": "input"})
    _add_variable(
        base,
        system.output,
        {
            "scale": "1/s",
            "type": "output",
            "accumulation": "MAX",
            "defuzzifier": "COG",
            "defaultValue": repr(system.middle),
        },
    )
    _add_rules(root, system)
    ET.indent(root)
    text = commented([*about, *notes], "").replace("--", "- -")
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<!--\n{text}-->\n'
        f"{ET.tostring(root, encoding='unicode')}\n"
    )


def _add_variable(base: ET.Element, variable: Variable, attributes: dict[str, str]) -> None:
    element = ET.SubElement(
        base,
        "fuzzyVariable",
        {
            "name": variable.name,
            "domainleft": repr(variable.low),
            "domainright": repr(variable.high),
            **attributes,
        },
    )
    for i, term in enumerate(variable.terms):
        one = ET.SubElement(
            element, "fuzzyTerm", {"name": _term_name(variable, i), "complement": "false"}
        )
        feet = {f"param{k}": repr(x) for k, x in enumerate(term.feet, start=1)}
        ET.SubElement(one, "triangularShape", feet)


def _term_name(variable: Variable, term: int) -> str:
    """'error_VS': names are unique in a whole document."""
    return f"{variable.name}_{variable.terms[term].name}"


def _add_rules(root: ET.Element, system: System) -> None:
    rules = ET.SubElement(
        root,
        "mamdaniRuleBase",
        {"name": "rules", "activationMethod": "MIN", "andMethod": "MIN", "orMethod": "MAX"},
    )
    for i, rule in enumerate(system.rules, start=1):
        one = ET.SubElement(
            rules,
            "rule",
            {"name": f"rule{i}", "andMethod": "MIN", "connector": "and", "weight": "1.0"},
        )
        given = ET.SubElement(one, "antecedent")
        _add_clause(given, system.error, rule.error)
        _add_clause(given, system.rate, rule.rate)
        then = ET.SubElement(ET.SubElement(one, "consequent"), "then")
        _add_clause(then, system.output, rule.output)


def _add_clause(parent: ET.Element, variable: Variable, term: int) -> None:
    clause = ET.SubElement(parent, "clause")
    ET.SubElement(clause, "variable").text = variable.name
    ET.SubElement(clause, "term").text = _term_name(variable, term)
