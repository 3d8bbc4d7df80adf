"""Sentences that depend on what was found."""

import math

import numpy as np

from posegsa.judging.evaluation import CONSTANT, TUNED, Description, Evaluation
from posegsa.report.numbers import cost, interval, number
from posegsa.words import counted


def verdict(evaluation: Evaluation) -> str:
    """Whether the tuned schedule beats the best constant gain, in a sentence."""
    difference = evaluation.difference(CONSTANT)
    mean, low, high = difference
    against = f"the best constant gains on {counted(evaluation.scenarios, 'unseen scenario')}"
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


def filter_words(found: Description) -> str:
    """What a contender is, by its own numbers."""
    match found.kind:
        case "fuzzy":
            own = f"fuzzy, k1 to k{len(found.numbers['k'])}"
        case "open loop":
            time = found.numbers["time"]
            own = f"{len(time)} knots of K(t) from {time[0]:.3g} to {time[-1]:.4g} s, open loop"
        case kind:
            numbers = found.numbers.items()
            own = f"{kind}: " + ", ".join(f"{name} = {each[0]:.4g}" for name, each in numbers)
    return "; ".join([own, *(f"{key} = {value:.4g}" for key, value in found.also.items())])
