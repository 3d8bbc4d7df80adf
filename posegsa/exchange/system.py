"""A Mamdani system with named variables and terms, converted to and from a controller."""

import math
import re
import textwrap
from collections import Counter
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from posegsa.arguments import check_type
from posegsa.errors import FuzzyError
from posegsa.model.fuzzy import Centroid, FuzzyController, NoRule

INPUTS = ("error", "rate")
NAME = "posegsa_gain"
FIVE = ("VS", "S", "M", "L", "VL")
"""Names of five terms, from small to large."""

LONGEST = 110
"""Most characters in a comment line."""
_OUTPUT = re.compile(r"gain_minus_(\d+)(?:_(\d+))?")


def limits(offset: float) -> str:
    """A comment for the file's user: clip the inputs, add the offset of the gain [1/s]."""
    return (
        "Give both inputs clipped to [0, 1]. The output is the centroid; the gain is "
        f"K = {offset:.17g} + output [1/s]. AND and implication are min, aggregation is max."
    )


def output_name(offset: float) -> str:
    """Name of the output, such as gain_minus_1, because no format can add the offset."""
    return f"gain_minus_{offset:.6f}".rstrip("0").rstrip(".").replace(".", "_")


def offset_of(name: str) -> float:
    """The offset in an output's name [1/s], rounded to 1e-6; 1 for any other name."""
    found = _OUTPUT.fullmatch(name)
    return float(f"{found[1]}.{found[2] or 0}") if found else 1.0


class Term(NamedTuple):
    """A triangular term."""

    name: str
    feet: tuple[float, float, float]
    """Left foot, peak, right foot."""


class Variable(NamedTuple):
    """An input or the output."""

    name: str
    low: float
    """Ends of its range."""
    high: float
    terms: tuple[Term, ...]


class Rule(NamedTuple):
    """IF error is a term AND rate is a term THEN the output is a term, by index."""

    error: int
    rate: int
    output: int


class System(NamedTuple):
    """A controller as the formats describe it."""

    error: Variable
    rate: Variable
    output: Variable
    """The output [1/s]; the gain is the output plus the offset."""
    rules: tuple[Rule, ...]
    offset: float
    """The gain minus the output [1/s]."""
    no_rule: NoRule | None
    """What happens where no rule fires; None if the file does not say."""
    points: int | None
    """Sample points of the centroid; None if it is exact, or if the file does not say."""

    @property
    def middle(self) -> float:
        """Middle of the output's range."""
        return 0.5 * (self.output.low + self.output.high)


def system_of(controller: FuzzyController) -> System:
    """The system that describes a controller.

    Raises:
        ArgumentError: The argument is not a controller.
        FuzzyError: It is a batch of several controllers.
    """
    check_type("controller", controller, FuzzyController)
    shape = np.shape(controller.input_terms)
    if len(shape) != 2:
        raise FuzzyError(f"controller: must be one, got a batch of shape {shape[:-2]}")
    low, high = controller.output_range
    inputs = _terms(controller.input_terms)
    error, rate = (Variable(name, 0.0, 1.0, inputs) for name in INPUTS)
    return System(
        error=error,
        rate=rate,
        output=Variable(
            output_name(controller.offset), float(low), float(high), _terms(controller.output_terms)
        ),
        rules=tuple(
            Rule(e, r, output)
            for r, row in enumerate(controller.rules)
            for e, output in enumerate(row)
        ),
        offset=controller.offset,
        no_rule=controller.no_rule,
        points=controller.sampled_points if controller.centroid == "sampled" else None,
    )


def controller_of(system: System, *, no_rule: NoRule | None, centroid: Centroid) -> FuzzyController:
    """The controller that a system describes.

    Args:
        system: A system that was read from a file.
        no_rule: What happens where no rule fires; None to follow the system.
        centroid: The controller's centroid.

    Raises:
        FuzzyError: It has another structure: inputs with other ranges than [0, 1], or different
            terms, or not one rule for each pair of their terms.
    """
    error, rate, output = system.error, system.rate, system.output
    for one in (error, rate):
        if (one.low, one.high) != (0.0, 1.0):
            raise FuzzyError(
                f"{one.name}: has the range [{one.low:g}, {one.high:g}]; allowed: [0, 1]"
            )
    feet: Any = [[_inside(term, one) for term in one.terms] for one in (error, rate, output)]
    if feet[0] != feet[1]:
        raise FuzzyError(
            f"{error.name} and {rate.name}: have different terms, {feet[0]} and {feet[1]}; "
            "allowed: the same for both"
        )
    pairs = Counter((rule.error, rule.rate) for rule in system.rules)
    count = len(error.terms)
    for e in range(count):
        for r in range(count):
            if pairs[e, r] != 1:
                named = (
                    f"{error.name} is {error.terms[e].name}, {rate.name} is {rate.terms[r].name}"
                )
                raise FuzzyError(f"rules: {pairs[e, r]} of them for {named}; allowed: one each")
    table = {(rule.rate, rule.error): rule.output for rule in system.rules}
    chosen = system.no_rule if no_rule is None else no_rule
    if chosen is None:
        raise FuzzyError('no_rule: not stated in the file; give "hold" or "midrange"')
    return FuzzyController(
        feet[0],
        feet[2],
        tuple(tuple(table[r, e] for e in range(count)) for r in range(count)),
        output_range=(output.low, output.high),
        centroid=centroid,
        sampled_points=101 if system.points is None else system.points,
        no_rule=chosen,
        offset=system.offset,
    )


def _inside(term: Term, variable: Variable) -> tuple[float, float, float]:
    """Feet and peak, cut to the range if the peak is at an end of the range.

    Such a term stays the same inside the range. Any other term that reaches outside is refused.
    """
    a, b, c = term.feet
    if not all(map(math.isfinite, term.feet)):
        raise FuzzyError(f"{variable.name}: the term {term.name} must be finite, got {term.feet}")
    a = max(a, variable.low) if b == variable.low else a
    c = min(c, variable.high) if b == variable.high else c
    if a < variable.low or c > variable.high:
        raise FuzzyError(
            f"{variable.name}: the term {term.name}, {list(term.feet)}, is cut off by the range "
            f"[{variable.low:g}, {variable.high:g}]; allowed: inside it, or the peak at its end"
        )
    return a, b, c


def _terms(terms: object) -> tuple[Term, ...]:
    values = np.asarray(terms).tolist()
    names = FIVE if len(values) == len(FIVE) else [f"T{i}" for i in range(1, len(values) + 1)]
    return tuple(Term(name, tuple(feet)) for name, feet in zip(names, values, strict=True))


def commented(lines: list[str], prefix: str) -> str:
    """Lines of text as comment lines; long ones are wrapped."""
    short = (part for line in lines for part in textwrap.wrap(line, LONGEST) or [""])
    return "".join(f"{prefix} {line}".rstrip() + "\n" for line in short)


def check_inputs(names: Collection[str]) -> None:
    """Raise a FuzzyError unless a file's inputs are named error and rate."""
    if set(names) != set(INPUTS):
        raise FuzzyError(f"inputs: named {', '.join(names)}; allowed: {' and '.join(INPUTS)}")


def numbers_of(text: str, count: int, where: str) -> list[float]:
    """Read `count` numbers from a text such as '0 0.5 1'.

    Raises:
        FuzzyError: The text is anything else; says where.
    """
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise FuzzyError(f"{where}: must be {count} numbers, got {text.strip()!r}")
    return numbers
