"""The gain schedule: its error signal, the fuzzy inference, and the boxes of k1..k22."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import BeforeValidator, Field, model_validator

from posegsa.config.tunable import AlsoTuned
from posegsa.model.fuzzy import Centroid, NoRule, SampledRule
from posegsa.model.signal import Rate, Signal
from posegsa.settings.fields import Flag, NonNegative, Number, Positive, Section, Share, Tunable
from posegsa.settings.violations import Violation

Term = Literal["VS", "S", "M", "L", "VL"]
"""A linguistic term, from very small to very large. The paper's table writes V for L."""

TERMS: tuple[Term, ...] = get_args(Term)

Row = tuple[Term, Term, Term, Term, Term]
Bounds = Annotated[tuple[Number, ...], Field(min_length=22, max_length=22)]

INPUT_RANGE = (0.0, 1.0)
"""Universe of both inputs, no unit: the scaled error and its rate are clipped to it."""

PARAMETERS = tuple(f"k{i}" for i in range(1, 23))
"""The names k1..k22: 1 to 11 shape the input terms, 12 to 22 the output terms."""

_PAPER_BOXES = (  # (low, high) of k1..k22, the paper's Eqs. 18 and 19
    (0.0, 0.15),  # VS: c
    (0.0, 0.2),  # S: a, b, c
    (0.0, 0.2),
    (0.1, 0.2),
    (0.05, 0.2),  # M
    (0.1, 0.3),
    (0.1, 0.4),
    (0.1, 0.4),  # L
    (0.2, 0.8),
    (0.3, 0.8),
    (0.2, 0.7),  # VL: a
    (0.0, 10.0),  # VS: c, of the output from here
    (0.0, 10.0),  # S
    (0.0, 20.0),
    (5.0, 30.0),
    (5.0, 20.0),  # M
    (10.0, 50.0),
    (20.0, 50.0),
    (20.0, 50.0),  # L
    (20.0, 70.0),
    (40.0, 90.0),
    (30.0, 70.0),  # VL
)

DEFAULT_ALSO = tuple(
    AlsoTuned(key=key, lower=lower, upper=upper, scale="logarithmic")
    for key, lower, upper in (
        ("scenario.landmarks.0.weight", 0.1, 3.0),
        ("filter.length", 0.3, 10.0),
        ("filter.gamma", 0.2, 20.0),
        ("filter.vector_bias_gain", 0.01, 5.0),
        ("gain.position_weight", 0.01, 1.0),
        ("gain.smoothing", 0.1, 5.0),
        ("gain.error_scale", 0.05, 1.0),
        ("gain.unknown", 0.02, 1.0),
        ("gain.unknown_fall", 0.0005, 0.5),
        ("gain.unknown_rise", 0.01, 1.0),
        ("filter.bias_wait", 0.02, 3.0),
        ("filter.length_growth", 0.001, 10.0),
    )
)
"""The numbers of an observer that are tuned besides k1..k22 by default, where they are not off."""

T = TypeVar("T")


def triangles(k: Sequence[T], low: T, high: T) -> tuple[tuple[T, T, T], ...]:
    """The five terms of one universe, VS to VL, as triangles (a, b, c) on [low, high].

    Args:
        k: The eleven parameters of the universe: k1..k11 of the inputs, or k12..k22 of the output.
        low: Lower end of the universe.
        high: Upper end of the universe.
    """
    return (
        (low, low, k[0]),
        (k[1], k[2], k[3]),
        (k[4], k[5], k[6]),
        (k[7], k[8], k[9]),
        (k[10], high, high),
    )


Rules = tuple[Row, Row, Row, Row, Row]
PAPER_RULES: Rules = (
    ("VL", "VL", "VL", "L", "L"),
    ("VL", "VL", "VL", "L", "M"),
    ("VL", "VL", "L", "M", "M"),
    ("VL", "VL", "M", "M", "S"),
    ("VL", "VL", "M", "S", "VS"),
)


SEARCHED: Literal["searched"] = "searched"
"""Used instead of a rule table: the search chooses the table too."""


def _rules(given: object) -> object:
    """The rule table for a name; anything else unchanged."""
    if given == "paper":
        return PAPER_RULES
    return tuple(row[::-1] for row in PAPER_RULES) if given == "reversed" else given


class GainConfig(Section):
    """[gain]: the error signal e, the input of the gain schedule."""

    signal: Signal = "measured"
    """How e is computed: "measured", from the vectors and landmarks, as a vehicle can do it, or
    "pose", from the true errors of attitude and position (an oracle, for simulation only)."""
    position_weight: Annotated[NonNegative, Tunable()] = 0.2
    """Weight of the position part [m] relative to the attitude part (0 to 1) in e [1/m]."""
    smoothing: Annotated[NonNegative, Tunable()] = 1.5
    """Time constant of the first-order low-pass filter of e [s]; 0 means none."""
    error_scale: Annotated[Positive, Tunable()] = 0.3
    """Divisor of e before it is clipped to [0, 1], in the unit of e."""
    rate: Rate = "per_sample"
    """The controller's second input: `|e_k - e_(k-1)|`, or this divided by the time between the
    samples."""
    rate_scale: Annotated[NonNegative, Tunable()] = 1.0
    """Factor on the rate (no unit, or [s]) before it is clipped to [0, 1]."""
    unknown: Annotated[Share | Literal["off"], Tunable()] = "off"
    """Unknown share of the biases at the start, on the scale of the controller's input e. e is at
    least this share, so that the gain stays high until the biases are learnt. "off": e is the error
    alone."""
    unknown_fall: Annotated[NonNegative, Tunable("unknown")] = 0.01
    """How fast the unknown share falls while vectors and landmarks are measured: its rate is this
    times the gain K [1/s] and the factor of `filter.bias_wait`."""
    unknown_rise: Annotated[Share, Tunable("unknown")] = 0.5
    """Lower limit of the unknown share, as a factor on the scaled error."""


class FuzzyConfig(Section):
    """[fuzzy]: Mamdani inference with min for AND and implication, max for aggregation."""

    centroid: Centroid = "exact"
    """How the centroid is computed: "exact", in closed form, or "sampled", from samples of the
    output universe."""
    sampled_points: Annotated[int, Field(strict=True, ge=3, le=100_001)] = 101
    """Number of samples of the output universe; only for the sampled centroid."""
    sampled_rule: SampledRule = "sum"
    """Weights of the samples: "sum", all equal, as in MATLAB, or "trapezoid", half at the two ends;
    only for the sampled centroid."""
    no_rule: NoRule = "hold"
    """The gain where no rule fires: "hold" keeps the last one; "midrange" is the offset + the
    middle of the output universe, as in MATLAB."""
    ordering: Flag = True
    """Whether parameters are sorted: within each triangle, then between the terms."""
    coverage: Flag = True
    """Whether gaps between the input terms, where no rule fires, are closed."""
    overlap: NonNegative = 0.01
    """Minimum overlap of neighbouring input terms after closing gaps, no unit (inputs are 0 to
    1)."""
    offset: NonNegative = 1.0
    """Added to the centroid [1/s]: the gain is K = offset + centroid; 1 in the paper."""
    rules: Annotated[Rules | Literal["searched"], BeforeValidator(_rules)] = PAPER_RULES
    """The rule table; rows are the rate, VL at the top to VS at the bottom; columns are the error,
    VL at the left to VS at the right. "paper" is the paper's (its V is L). "reversed" has the error
    axis reversed, for large residuals that are disturbances, which need a low gain. With "searched"
    the search chooses the 25 output terms too, besides k1..k22."""

    def _conflicts(self) -> Iterator[Violation]:
        if not self.ordering and self.centroid != "sampled":
            reason = (
                'allowed: "sampled", because ordering = false (the closed form needs ordered terms)'
            )
            yield Violation("centroid", reason, self.centroid)
        if not self.ordering and self.coverage:
            reason = "allowed: false, because ordering = false (the repair needs ordered terms)"
            yield Violation("coverage", reason, self.coverage)


def fitted_bounds(low: float, high: float) -> dict[str, tuple[float, ...]]:
    """The paper's bounds, lower and upper, with those of k12..k22 shifted and scaled to a range."""
    fitted = {}
    for key, side in (("lower", 0), ("upper", 1)):
        paper = [box[side] for box in _PAPER_BOXES]
        scaled = [low + (high - low) * k / 100 for k in paper[11:]]
        fitted[key] = (*paper[:11], *scaled)
    return fitted


class ParametersConfig(Section):
    """[parameters]: the boxes in which k1..k22 are searched, and the universe of the output."""

    lower: Bounds = tuple(low for low, _ in _PAPER_BOXES)
    """Lower bounds: k1..k11 in 0 to 1 (inputs, no unit), k12..k22 in the gain range [1/s]."""
    upper: Bounds = tuple(high for _, high in _PAPER_BOXES)
    """Upper bounds, in the same order and units."""
    gain_range: tuple[NonNegative, NonNegative] = (0.0, 100.0)
    """Universe of the output k_op; the gain is K = fuzzy.offset + its centroid [1/s]. If it is
    given without bounds, those of k12..k22 are the paper's, shifted and scaled to it."""
    also: tuple[AlsoTuned, ...] = DEFAULT_ALSO
    """Further numbers that are searched together with k1..k22; the noises of a Kalman filter. Of
    the defaults, those are left out that are set in the configuration or have no effect."""

    @model_validator(mode="before")
    @classmethod
    def _fit_the_boxes(cls, values: Any) -> Any:
        """Fit the bounds to the gain range, if only the range is given."""
        if not isinstance(values, Mapping) or "gain_range" not in values:
            return values
        try:
            low, high = (float(end) for end in values["gain_range"])
        except (TypeError, ValueError):
            return values  # the field's validation refuses it
        return fitted_bounds(low, high) | dict(values)

    def _conflicts(self) -> Iterator[Violation]:
        if self.gain_range[0] >= self.gain_range[1]:
            yield Violation(
                "gain_range", "allowed: a lower end below the upper end", self.gain_range
            )
            return
        for i, (name, low, high) in enumerate(zip(PARAMETERS, self.lower, self.upper, strict=True)):
            start, end = INPUT_RANGE if i < 11 else self.gain_range
            for key, value in (("lower", low), ("upper", high)):
                if not start <= value <= end:
                    reason = f"{name} is out of its universe; allowed: {start} to {end}"
                    yield Violation(f"{key}.{i}", reason, value)
            if low > high:
                reason = f"{name} has low > high; allowed: at most upper.{i} = {high}"
                yield Violation(f"lower.{i}", reason, low)

    def disorder(self) -> Iterator[Violation]:
        """Bounds for which sorting could move parameters out of their boxes.

        Sorting numbers keeps each of them inside its own interval if the lower ends of the
        intervals ascend and the upper ends do too. Each triangle is sorted, so that
        a <= b <= c, and then the a's, the b's and the c's from term to term.
        """
        allowed = "bounds that ascend within each triangle and from term to term"
        for key, bounds in (("lower", self.lower), ("upper", self.upper)):
            for part, universe in ((slice(0, 11), INPUT_RANGE), (slice(11, 22), self.gain_range)):
                names = _neighbours(triangles(PARAMETERS[part], "", ""))
                values = _neighbours(triangles(bounds[part], *universe))
                for (name, next_name), (value, next_value) in zip(names, values, strict=True):
                    if value > next_value:
                        yield Violation(
                            f"{key}.{PARAMETERS.index(name)}",
                            f"{name} comes before {next_name}, whose {key} bound is {next_value}; "
                            f"allowed: {allowed}, or fuzzy.ordering = false",
                            value,
                        )

    def gaps(self) -> Iterator[Violation]:
        """Bounds for which the coverage repair could not close a gap between two input terms.

        The repair moves the left end a of a term down to the right end c of the term before it,
        and both may be as low as their boxes go.
        """
        names = pairwise(triangles(PARAMETERS[:11], "", ""))
        values = pairwise(triangles(self.lower[:11], *INPUT_RANGE))
        for (before, after), (before_low, after_low) in zip(names, values, strict=True):
            if after_low[0] > before_low[2]:
                yield Violation(
                    f"lower.{PARAMETERS.index(after[0])}",
                    f"{after[0]} has to come down to {before[2]} to close a gap; allowed: at most "
                    f"{before_low[2]}, the lower bound of {before[2]}, or fuzzy.coverage = false",
                    after_low[0],
                )


def _neighbours(terms: Sequence[tuple[T, T, T]]) -> Iterator[tuple[T, T]]:
    """The pairs that sorting orders: within each triangle, and from term to term."""
    for numbers in (*terms, *zip(*terms, strict=True)):
        yield from pairwise(numbers)
