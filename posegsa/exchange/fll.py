"""Write and read `.fll` files of fuzzylite.

The format expresses a whole controller except K = 1 + output. Inputs are clipped (`lock-range`),
and the last gain is kept where no rule fires (`lock-previous`). Its centroid is a sum over the
midpoints of equal parts of the output's range; for an exact centroid we write `RESOLUTION` parts.
"""

import re
from collections.abc import Iterator, Sequence

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
from posegsa.model.fuzzy import FuzzyController, NoRule

RESOLUTION = 1000
"""Number of parts of the output's range written for an exact centroid."""

_METHODS = {"conjunction": "Minimum", "implication": "Minimum", "aggregation": "Maximum"}
Block = tuple[str, str, list[tuple[str, str]]]
"""Kind, name, and (key, value) pairs."""


def to_fll(controller: FuzzyController, about: Sequence[str] = ()) -> str:
    """The text of a .fll file, for fuzzylite and pyfuzzylite.

    Args:
        controller: The controller to write.
        about: Lines for the comment at the top.

    Raises:
        ArgumentError: The first argument is not a controller.
        FuzzyError: It is a batch of several controllers.
    """
    system = system_of(controller)
    resolution = RESOLUTION if system.points is None else system.points
    lines = [f"Engine: {NAME}"]
    for one in (system.error, system.rate):
        lines += [f"InputVariable: {one.name}", "  enabled: true", *_range(one, locked=True)]
    output = system.output
    lines += [
        f"OutputVariable: {output.name}",
        "  enabled: true",
        *_range(output, locked=False)[:2],
        f"  aggregation: {_METHODS['aggregation']}",
        f"  defuzzifier: Centroid {resolution}",
        f"  default: {system.middle!r}",
        f"  lock-previous: {'true' if system.no_rule == 'hold' else 'false'}",
        *_range(output, locked=False)[2:],
        "RuleBlock: rules",
        "  enabled: true",
        f"  conjunction: {_METHODS['conjunction']}",
        "  disjunction: none",
        f"  implication: {_METHODS['implication']}",
        "  activation: General",
        *(f"  rule: {_rule(system, rule)}" for rule in system.rules),
    ]
    return commented([*about, limits(system.offset)], "#") + "\n".join(lines) + "\n"


def _range(variable: Variable, *, locked: bool) -> list[str]:
    """Range and lock, then the terms."""
    return [
        f"  range: {variable.low!r} {variable.high!r}",
        f"  lock-range: {'true' if locked else 'false'}",
        *(f"  term: {t.name} Triangle {' '.join(map(repr, t.feet))}" for t in variable.terms),
    ]


def _rule(system: System, rule: Rule) -> str:
    """'if error is VS and rate is VS then gain_minus_1 is L'."""
    chosen = zip((system.error, system.rate, system.output), rule, strict=True)
    error, rate, output = (f"{one.name} is {one.terms[term].name}" for one, term in chosen)
    return f"if {error} and {rate} then {output}"


def from_fll(text: str) -> System:
    """The system that a file's text describes.

    Raises:
        FuzzyError: The text is not a .fll file, or has another structure; says where.
    """
    blocks = list(_blocks(text))
    kinds = [kind for kind, _, _ in blocks]
    wanted = ["Engine", "InputVariable", "InputVariable", "OutputVariable", "RuleBlock"]
    if kinds != wanted:
        raise FuzzyError(f"has {', '.join(kinds) or 'nothing'}; allowed: {', '.join(wanted)}")
    _, first, second, output, rules = blocks
    inputs = {block[1]: _read_variable(block) for block in (first, second)}
    check_inputs(inputs)
    error, rate = (inputs[name] for name in INPUTS)
    out = _read_variable(output)
    _check_methods(output, ("aggregation",))
    _check_methods(rules, ("conjunction", "implication"))
    kind, _, count = _value(output, "defuzzifier").partition(" ")
    if kind != "Centroid":
        raise FuzzyError(f"{out.name}: defuzzifier {kind!r}; allowed: 'Centroid'")
    system = System(
        error=error,
        rate=rate,
        output=out,
        rules=tuple(
            _read_rule(value, (error, rate, out)) for key, value in rules[2] if key == "rule"
        ),
        offset=offset_of(out.name),
        no_rule=None,
        points=int(count) if count.isdecimal() else None,
    )
    return system._replace(no_rule=_no_rule(output, system.middle))


def _blocks(text: str) -> Iterator[Block]:
    block: Block | None = None
    for raw in text.splitlines():
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        key, colon, value = (part.strip() for part in line.partition(":"))
        if not colon:
            raise FuzzyError(f"must be key: value, got {line[:60]!r}")
        if key[:1].isupper():
            if block is not None:
                yield block
            block = (key, value, [])
        elif block is None:
            raise FuzzyError(f"a .fll must start with Engine, got {line[:60]!r}")
        else:
            block[2].append((key, value))
    if block is not None:
        yield block


def _value(block: Block, key: str) -> str:
    _, name, pairs = block
    found = [value for k, value in pairs if k == key]
    if len(found) != 1:
        raise FuzzyError(f"{name}: {len(found)} lines '{key}: ...'; allowed: one")
    return found[0]


def _check_methods(block: Block, keys: Sequence[str]) -> None:
    for key in keys:
        if (found := _value(block, key)) != _METHODS[key]:
            raise FuzzyError(f"{block[1]}: {key} {found!r}; allowed: {_METHODS[key]!r}")


def _no_rule(output: Block, middle: float) -> NoRule | None:
    if _value(output, "lock-previous") == "true":
        return "hold"
    (default,) = numbers_of(_value(output, "default"), 1, f"{output[1]}: default")
    return "midrange" if default == middle else None


def _read_variable(block: Block) -> Variable:
    _, name, pairs = block
    if dict(pairs).get("enabled", "true") != "true":
        raise FuzzyError(f"{name}: not enabled")
    low, high = numbers_of(_value(block, "range"), 2, f"{name}: range")
    terms = []
    for key, value in pairs:
        if key == "term":
            term, kind, *feet = [*value.split(), "", ""]
            if kind != "Triangle":
                raise FuzzyError(f"{name}: term {term} is a {kind!r}; allowed: 'Triangle'")
            a, b, c = numbers_of(" ".join(feet), 3, f"{name}: term {term}")
            terms.append(Term(term, (a, b, c)))
    return Variable(name, low, high, tuple(terms))


def _read_rule(text: str, variables: tuple[Variable, ...]) -> Rule:
    """'if error is VS and rate is VS then gain_minus_1 is L', its two conditions in any order."""
    name = r"(\w+) is (\w+)"
    found = re.fullmatch(rf"if {name} and {name} then {name}(?: with 1(?:\.0*)?)?", text)
    if found is None:
        raise FuzzyError(
            f"rule {text!r}: must be like 'if error is VS and rate is VS then output is L'"
        )
    words = found.groups()
    terms = dict(zip(words[::2], words[1::2], strict=True))
    indices = []
    for variable in variables:
        names = [term.name for term in variable.terms]
        if terms.get(variable.name) not in names:
            raise FuzzyError(
                f"rule {text!r}: needs {variable.name} is one of {', '.join(names) or 'no term'}"
            )
        indices.append(names.index(terms[variable.name]))
    return Rule(*indices)
