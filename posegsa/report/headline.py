"""The top of the report: warnings, a verdict, and the numbers that matter most."""

import math

import numpy as np

from posegsa.judging.evaluation import CONSTANT, TUNED, Evaluation, Interval
from posegsa.judging.result import TuneResult
from posegsa.report.markup import (
    Html,
    cost,
    element,
    interval,
    join,
    number,
    paragraph,
    section,
)
from posegsa.words import counted


def warnings(result: TuneResult) -> Html:
    """What a reader must know before trusting the result; nothing where there is nothing."""
    items = [element("li", each[:1].upper() + each[1:]) for each in result.warnings()]
    return section("Warnings", element("ul", *items), class_="warnings") if items else Html()


def headline(result: TuneResult) -> Html:
    """The numbers that matter most, training beside held-out."""
    evaluation = result.evaluation
    difference = evaluation.difference(CONSTANT)
    unbroken = f"95 % interval {interval(*difference[1:])}".replace(" ", "\u00a0")
    in_training = [
        f"in training {cost(float(np.mean(costs)))} on {counted(len(costs), 'scenario')}"
        for costs in (result.training_costs, result.constant_training_costs)
    ]
    in_training[1] += f" with K = {result.constant_gain:.4g} 1/s"
    tiles = [
        ("Held out: tuned", *_mean(evaluation.cost(TUNED)), in_training[0]),
        ("Held out: best constant", *_mean(evaluation.cost(CONSTANT)), in_training[1]),
        ("Tuned minus best constant", cost(difference.mean, "+.2f"), "", unbroken),
    ]
    bad = np.count_nonzero(evaluation.contenders[TUNED].metrics.diverged)
    of = f"of {counted(evaluation.scenarios, 'scenario')}"
    tiles.append(("Held out: diverged", str(bad), "", of))
    return section(
        "Result",
        paragraph(verdict(evaluation), class_="verdict"),
        element("dl", join((_tile(*tile) for tile in tiles), "\n"), class_="headline"),
    )


def verdict(evaluation: Evaluation) -> str:
    """Whether the tuned schedule beats the best constant gain, in a sentence."""
    mean, low, high = evaluation.difference(CONSTANT)
    against = f"the best constant gain on {counted(evaluation.scenarios, 'unseen scenario')}"
    if not (math.isfinite(low) and math.isfinite(high)):
        own, other = (evaluation.contenders[name].metrics.cost for name in (TUNED, CONSTANT))
        bad = [np.count_nonzero(~np.isfinite(costs)) for costs in (own, other)]
        if not any(bad):
            return f"The tuned schedule cannot be compared with {against}: they are too few."
        return (
            f"The mean cost of the tuned schedule cannot be compared with that of {against}: "
            f"{bad[0]} and {bad[1]} of their costs are infinite. Their medians are "
            f"{cost(float(np.median(own)))} and {cost(float(np.median(other)))}."
        )
    if low <= 0 <= high:
        ends = interval(low, high)
        return (
            f"The tuned schedule cannot be told apart from {against}: the 95 % interval of their "
            f"difference, {ends}, includes 0."
        )
    less = high < 0
    by, minimum, maximum = (-mean, -high, -low) if less else (mean, low, high)
    constant = evaluation.cost(CONSTANT).mean
    share = f"{number(100 * by / constant, '.1f')}\u00a0%; " if constant > 0 else ""
    return (
        f"The tuned schedule costs {cost(by)} {'less' if less else 'more'} ({share}95 % interval "
        f"{cost(minimum)} to {cost(maximum)}) than {against}."
    )


def _tile(name: str, value: str, beside: str, below: str) -> Html:
    return element(
        "div",
        element("dt", name),
        element("dd", value, " ", element("span", beside, class_="beside"), class_="value"),
        element("dd", below),
    )


def _mean(of: Interval) -> tuple[str, str]:
    """A mean, and half of its interval's length."""
    half = 0.5 * (of.high - of.low)
    return cost(of.mean), f"\u00b1 {cost(half)}" if math.isfinite(half) else ""
