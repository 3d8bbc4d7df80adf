"""IEC 61131-7, Fuzzy Control Language, `.fcl`: written.

The standard's own grammar, with comments of IEC 61131-3's third edition (`//`) and rules in lower
case, so that as many readers as possible take it. Terms are lists of points, the ends of which hold
beyond them, so that inputs need not be clipped. How the centroid is computed is the reader's.
"""

from collections.abc import Sequence

from posegsa.exchange.system import NAME, Variable, commented, limits, rule_text, system_of
from posegsa.model.fuzzy import FuzzyController


def to_fcl(controller: FuzzyController, about: Sequence[str] = ()) -> str:
    """A controller for programmable logic controllers, jFuzzyLogic and others.

    Args:
        controller: It.
        about: Lines for the comment at the head.

    Raises:
        ArgumentError: It is no controller.
        FuzzyError: It is a batch of several.
    """
    system = system_of(controller)
    notes = [limits(system.offset)]
    default = f"{system.middle!r}"
    if system.no_rule == "hold":
        default = "NC"
        notes.append(
            "NC (no change) keeps the last output where no rule fires; begin with "
            f"{system.middle!r}, the middle of the range."
        )
    inputs = (system.error, system.rate)
    lines = [
        f"FUNCTION_BLOCK {NAME}",
        "",
        "VAR_INPUT",
        *(f"  {one.name} : REAL;" for one in inputs),
        "END_VAR",
        "",
        "VAR_OUTPUT",
        f"  {system.output.name} : REAL;",
        "END_VAR",
    ]
    for one in inputs:
        lines += ["", f"FUZZIFY {one.name}", *_terms(one), "END_FUZZIFY"]
    lines += [
        "",
        f"DEFUZZIFY {system.output.name}",
        *_terms(system.output),
        "  METHOD : COG;",
        f"  DEFAULT := {default};",
        f"  RANGE := ({system.output.low!r} .. {system.output.high!r});",
        "END_DEFUZZIFY",
        "",
        "RULEBLOCK rules",
        "  AND : MIN;",
        "  ACT : MIN;",
        "  ACCU : MAX;",
        *(
            f"  RULE {i} : {rule_text(system, rule)};"
            for i, rule in enumerate(system.rules, start=1)
        ),
        "END_RULEBLOCK",
        "",
        "END_FUNCTION_BLOCK",
    ]
    return commented([*about, *notes], "//") + "\n".join(lines) + "\n"


def _terms(variable: Variable) -> list[str]:
    lines = []
    for term in variable.terms:
        a, b, c = term.feet
        points = [(a, 0), (b, 1), (c, 0)]
        # At an end of the range a vertical edge is left out: the peak then holds beyond it.
        if a == b <= variable.low:
            del points[0]
        if b == c >= variable.high:
            del points[-1]
        text = " ".join(f"({x!r}, {y})" for x, y in points)
        lines.append(f"  TERM {term.name} := {text};")
    return lines
