"""Sentences that depend on what was found."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from posegsa.judging.evaluation import CONSTANT, TUNED, Evaluation
from posegsa.report.numbers import cost, interval, number
from posegsa.words import counted


def verdict(evaluation: Evaluation) -> str:
    """Whether the tuned schedule beats the best constant gain, in a sentence."""
    difference = evaluation.difference(CONSTANT)
    mean, low, high = difference
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
        return (
            f"The tuned schedule cannot be told apart from {against}: the 95 % interval of their "
            f"difference, {interval(difference)}, includes 0."
        )
    less = high < 0
    by, minimum, maximum = (-mean, -high, -low) if less else (mean, low, high)
    constant = evaluation.cost(CONSTANT).mean
    share = f"{number(100 * by / constant, '.1f')}\u00a0%; " if constant > 0 else ""
    return (
        f"The tuned schedule costs {cost(by)} {'less' if less else 'more'} ({share}95 % interval "
        f"{cost(minimum)} to {cost(maximum)}) than {against}."
    )


def schedule_words(found: Mapping[str, Any]) -> str:
    """What a contender's schedule is, by its own parameters."""
    match found:
        case {"gain": float(gain)}:
            return f"K = {gain:.4g} 1/s"
        case {"low": low, "high": high, "half": half}:
            return f"K from {low:.4g} to {high:.4g} 1/s, half-way at a scaled error of {half:.3g}"
        case {"time": [first, *_, last] as knots}:
            return f"{len(knots)} knots of K(t) from {first:.3g} to {last:.4g} s, open loop"
        case {"k": list(k)}:
            return f"fuzzy, k1 to k{len(k)}"
    return ", ".join(f"{key} = {value}" for key, value in found.items())
