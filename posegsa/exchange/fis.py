"""Write and read `.fis` files of MATLAB's Fuzzy Logic Toolbox.

MATLAB samples the centroid at 101 points, and outputs the middle of the range where no rule fires;
a file can change neither. A term with its peak at an end of the range is written with a foot
outside the range, as in MATLAB's own files: inside the range it is the same term, and Octave's
toolkit refuses vertical edges.
"""

import re
from collections.abc import Sequence

from posegsa.errors import FuzzyError
from posegsa.exchange.system import (
    INPUTS,
    NAME,
    Rule,
    System,
    Term,
    Variable,
    check_inputs,
    commented,
    limits,
    numbers_of,
    offset_of,
    system_of,
)
from posegsa.model.fuzzy import FuzzyController

METHODS = {
    "Type": "mamdani",
    "AndMethod": "min",
    "OrMethod": "max",
    "ImpMethod": "min",
    "AggMethod": "max",
    "DefuzzMethod": "centroid",
}


def to_fis(controller: FuzzyController, about: Sequence[str] = ()) -> str:
    """The text of a .fis file, for `readfis`.

    Args:
        controller: The controller to write.
        about: Lines for the comment at the top.

    Raises:
        ArgumentError: The first argument is not a controller.
        FuzzyError: It is a batch of several controllers.
    """
    system = system_of(controller)
    notes = [
        limits(system.offset),
        "MATLAB samples the centroid at 101 points; it differs from the exact one by up to 0.5/s.",
    ]
    if system.no_rule == "hold":
        notes.append(
            "Where no rule fires (evalfis warns), keep the last gain; MATLAB's own answer there is "
            "the middle of the range."
        )
    settings = {
        "Name": f"'{NAME}'",
        "Type": f"'{METHODS['Type']}'",
        "Version": "2.0",
        "NumInputs": "2",
        "NumOutputs": "1",
        "NumRules": f"{len(system.rules)}",
        **{key: f"'{value}'" for key, value in METHODS.items() if key != "Type"},
    }
    parts = [
        "[System]\n" + "".join(f"{key}={value}\n" for key, value in settings.items()),
        *(
            f"[{section}]\n{_variable(one)}"
            for section, one in (
                ("Input1", system.error),
                ("Input2", system.rate),
                ("Output1", system.output),
            )
        ),
        "[Rules]\n"
        + "".join(f"{r.error + 1} {r.rate + 1}, {r.output + 1} (1) : 1\n" for r in system.rules),
    ]
    return commented([*about, *notes], "%") + "\n".join(parts)


def _variable(variable: Variable) -> str:
    lines = [
        f"Name='{variable.name}'",
        f"Range=[{variable.low!r} {variable.high!r}]",
        f"NumMFs={len(variable.terms)}",
    ]
    width = variable.high - variable.low
    for i, term in enumerate(variable.terms, start=1):
        a, b, c = term.feet
        if a == b == variable.low:
            a -= width
        if b == c == variable.high:
            c += width
        lines.append(f"MF{i}='{term.name}':'trimf',[{a!r} {b!r} {c!r}]")
    return "\n".join(lines) + "\n"


def from_fis(text: str) -> System:
    """The system that a file's text describes.

    Raises:
        FuzzyError: The text is not a .fis file, or has another structure; says where.
    """
    sections = _sections(text)
    system, rules = (_section(sections, name) for name in ("System", "Rules"))
    values = dict(_key_and_value(line) for line in system)
    for key, wanted in METHODS.items():
        found = values.get(key, "").strip("'")
        if found != wanted and key != "OrMethod":  # no rule has an OR
            raise FuzzyError(f"[System] {key} = {found!r}; allowed: {wanted!r}")
    inputs = [_read_variable(sections, f"Input{i}") for i in (1, 2)]
    if "Input3" in sections or "Output2" in sections:
        raise FuzzyError("[System]: has more than two inputs and one output")
    check_inputs([one.name for one in inputs])
    swapped = inputs[0].name != INPUTS[0]
    error, rate = reversed(inputs) if swapped else inputs
    output = _read_variable(sections, "Output1")
    return System(
        error=error,
        rate=rate,
        output=output,
        rules=tuple(_read_rule(line, swapped, (error, rate, output)) for line in rules),
        offset=offset_of(output.name),
        no_rule="midrange",
        points=None,
    )


def _sections(text: str) -> dict[str, list[str]]:
    """The lines of each section by its name."""
    found: dict[str, list[str]] = {}
    current = None
    for raw in text.splitlines():
        line = raw.strip()
        if not line or line.startswith(("%", "#")):
            continue
        if line.startswith("[") and line.endswith("]"):
            current = line[1:-1]
            if current in found:
                raise FuzzyError(f"[{current}]: appears twice")
            found[current] = []
        elif current is None:
            raise FuzzyError(f"a .fis must start with [System], got {line[:60]!r}")
        else:
            found[current].append(line)
    return found


def _section(sections: dict[str, list[str]], name: str) -> list[str]:
    if name not in sections:
        raise FuzzyError(f"[{name}]: missing")
    return sections[name]


def _key_and_value(line: str) -> tuple[str, str]:
    key, equals, value = line.partition("=")
    if not equals:
        raise FuzzyError(f"must be key=value, got {line[:60]!r}")
    return key.strip(), value.strip()


def _read_variable(sections: dict[str, list[str]], section: str) -> Variable:
    pairs = [_key_and_value(line) for line in _section(sections, section)]
    values = dict(pairs)
    low, high = _numbers(values.get("Range", ""), 2, f"[{section}] Range")
    terms = []
    for key, value in pairs:
        if not re.fullmatch(r"MF\d+", key):
            continue
        found = re.fullmatch(r"'([^']*)'\s*:\s*'([^']*)'\s*,\s*(\[.*\])", value)
        if found is None:
            raise FuzzyError(f"[{section}] {key}: must be 'name':'trimf',[a b c], got {value!r}")
        name, kind, feet = found.groups()
        if kind != "trimf":
            raise FuzzyError(f"[{section}] {key}: a {kind!r}; allowed: 'trimf'")
        a, b, c = _numbers(feet, 3, f"[{section}] {key}")
        terms.append(Term(name, (a, b, c)))
    return Variable(values.get("Name", "").strip("'"), low, high, tuple(terms))


def _numbers(text: str, count: int, where: str) -> list[float]:
    """'[0 1]' as numbers."""
    return numbers_of(text.strip("[]").replace(",", " "), count, where)


def _read_rule(line: str, swapped: bool, variables: tuple[Variable, ...]) -> Rule:
    """'1 1, 3 (1) : 1'."""
    found = re.fullmatch(r"(\S+)\s+(\S+)\s*,\s*(\S+)\s*\(([^)]*)\)\s*:\s*(\d+)", line)
    if found is None:
        raise FuzzyError(f"[Rules]: must be like '1 1, 3 (1) : 1', got {line!r}")
    *terms, weight, connector = _numbers(" ".join(found.groups()), 5, f"[Rules] {line!r}")
    if (weight, connector) != (1, 1):
        raise FuzzyError(f"[Rules] {line!r}: allowed are weight (1) and connector 1, which is AND")
    if swapped:
        terms[:2] = terms[1], terms[0]
    for term, variable in zip(terms, variables, strict=True):
        if term not in range(1, len(variable.terms) + 1):
            raise FuzzyError(
                f"[Rules] {line!r}: {variable.name} has no term {term:g}; allowed: 1 to "
                f"{len(variable.terms)}"
            )
    e, r, k = (int(term) - 1 for term in terms)
    return Rule(e, r, k)
