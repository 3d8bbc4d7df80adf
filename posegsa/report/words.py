"""Sentences that depend on the results."""

import math

import numpy as np

from posegsa.judging.evaluation import (
    BEHAVIOUR,
    CONSTANT,
    EKF,
    EKF_VECTORS,
    OPEN_LOOP,
    REPLAYED,
    SWITCH,
    TUNED,
    Description,
    Evaluation,
)
from posegsa.judging.result import TuneResult
from posegsa.report.numbers import cost, interval, number
from posegsa.search.population import CONFIGURED
from posegsa.words import counted


def verdict(evaluation: Evaluation) -> str:
    """A sentence that compares the tuned schedule with the best constant gains."""
    difference = evaluation.difference(CONSTANT)
    mean, low, high = difference
    against = f"the best constant gains on {counted(evaluation.scenarios, 'unseen scenario')}"
    if not (math.isfinite(low) and math.isfinite(high)):
        own, other = (evaluation.contenders[name].metrics.cost for name in (TUNED, CONSTANT))
        bad = [np.count_nonzero(~np.isfinite(costs)) for costs in (own, other)]
        if not any(bad):
            return f"The tuned schedule cannot be compared with {against}: there are too few."
        return (
            f"The mean cost of the tuned schedule cannot be compared with that of {against}: "
            f"{bad[0]} and {bad[1]} of their costs are infinite. Their medians are "
            f"{cost(float(np.median(own)))} and {cost(float(np.median(other)))}."
        )
    if low <= 0 <= high:
        return (
            f"The tuned schedule does not differ significantly from {against}: the 95 % interval "
            f"of the difference, {interval(difference)}, includes 0."
        )
    less = high < 0
    by, minimum, maximum = (-mean, -high, -low) if less else (mean, low, high)
    constant = evaluation.cost(CONSTANT).mean
    share = f"{number(100 * by / constant, '.1f')}\u00a0%; " if constant > 0 else ""
    return (
        f"The tuned schedule costs {cost(by)} {'less' if less else 'more'} ({share}95 % interval "
        f"{cost(minimum)} to {cost(maximum)}) than {against}."
    )


def cost_words(result: TuneResult) -> str:
    """Sentences that explain the cost of a run."""
    if result.cost != CONFIGURED:
        return (
            f"The function {result.cost} computes the cost of a run from its errors over time; "
            "less is better."
        )
    settings, step = result.experiment.cost, result.experiment.scenario.sampling_time
    spans = [
        f"{number(first * step, 'g')} to {number(last * step, 'g')} s"
        for first, last in (settings.transient_window, settings.steady_window)
    ]
    return (
        "The cost of a run is a sum of errors over its samples, without a unit; less is better. "
        "The error of a sample is the attitude error, from 0 (none) to 1 "
        f"(180\u00a0deg), plus {number(settings.position_weight, 'g')} for each metre of "
        f"position error. Its weight is {number(settings.transient_weight, 'g')} from {spans[0]} "
        f"and {number(settings.steady_weight, 'g')} from {spans[1]}."
    )


def worse_words(evaluation: Evaluation) -> str:
    """Where the tuned filter's errors are larger than those of the best constant gains, if any."""
    tuned, constant = (evaluation.contenders[name].metrics for name in (TUNED, CONSTANT))
    worse = []
    for head, form, of in BEHAVIOUR:
        own, other = (float(np.mean(np.asarray(of(metrics)))) for metrics in (tuned, constant))
        if own > other:
            name, _, unit = head.replace("\n", " ").partition(" [")
            unit = f" {unit.rstrip(']')}" if unit else ""
            worse.append(
                f"{name[:1].lower()}{name[1:]} ({number(own, form)} against "
                f"{number(other, form)}{unit})"
            )
    if not worse:
        return ""
    listed = "; ".join(worse)
    return (
        f"The tuned filter is worse than the best constant gains in: {listed}. The search "
        "minimises only the cost; quantities that are not part of it, for example the errors of "
        "the estimated biases, may get worse."
    )


def better_words(evaluation: Evaluation) -> str:
    """Which contenders, except the best constant gains, are better than the tuned schedule, if any.

    The mean counts as better if the interval of the paired differences excludes 0, the median if it
    is lower in the digits shown.
    """
    own, lower = evaluation.summary(TUNED), _lower_medians(evaluation)
    found = []
    for name in evaluation.contenders:
        if name in (TUNED, CONSTANT):
            continue
        this, difference = evaluation.summary(name), evaluation.difference(name)
        parts = []
        if difference.low > 0:
            ends = f"{cost(difference.low)} to {cost(difference.high)}"
            parts.append(f"{cost(difference.mean)} on average (95 % interval {ends})")
        if name in lower:
            parts.append(f"a lower median ({cost(this.median)} against {cost(own.median)})")
        if parts:
            found.append(f"{name} by {' and '.join(parts)}")
    if not found:
        return ""
    return (
        f"Other filters are better than the tuned schedule on these scenarios: {'; '.join(found)}."
    )


def _clearly_better(evaluation: Evaluation) -> list[str]:
    """Contenders whose mean cost is significantly lower than that of the tuned schedule."""
    others = (name for name in evaluation.contenders if name != TUNED)
    return [name for name in others if evaluation.difference(name).low > 0]


def _lower_medians(evaluation: Evaluation) -> list[str]:
    """Contenders whose median cost is lower than that of the tuned schedule in the digits shown."""
    own = evaluation.summary(TUNED).median
    medians = {name: evaluation.summary(name).median for name in evaluation.contenders}
    return [name for name, each in medians.items() if each < own and cost(each) != cost(own)]


def _instead(names: list[str]) -> str:
    """Advice if these filters are better than the tuned schedule."""
    advice = f"These have a lower mean cost: {'; '.join(names)}. "
    if any(name in (REPLAYED, OPEN_LOOP, SWITCH) for name in names):
        advice += (
            "Gains that depend only on time are simpler and need no error signal. They suit a "
            "filter that starts as in these scenarios, and do not react to later errors. "
        )
    if any(name in (EKF, EKF_VECTORS) for name in names):
        advice += "The Kalman filter is `posegsa.KalmanFilter`. "
    return (
        f"{advice}Their parameters are in `evaluation.json`. The tuned schedule can still be "
        "exported: `posegsa export RUN --format c`."
    )


def next_words(result: TuneResult) -> list[str]:
    """Advice on next steps; each item is one or more sentences, with code between backticks."""
    evaluation = result.evaluation
    steps = []
    if result.warnings():
        steps.append("Read the warnings above first: they say why these numbers may mislead.")
    better = _clearly_better(evaluation)
    if any(name != CONSTANT for name in better):
        steps.append(_instead(better))
    elif evaluation.difference(CONSTANT).high < 0:
        steps.append(
            "The schedule is better than constant gains: export the whole filter as C with "
            "`posegsa export RUN --format c`, or run it on your own recordings with "
            "`posegsa replay RUN FILE`."
        )
    else:
        steps.append(
            "The schedule is not better than constant gains: search longer (`search.iterations`) "
            "or with more training scenarios, or use the constant gain of "
            f"{number(result.constant_gain, '.4g')} 1/s."
        )
    if SWITCH not in evaluation.contenders:
        steps.append(
            "`posegsa evaluate RUN` evaluates it on many more scenarios, and compares it with "
            "simpler schedules and Kalman filters, which may be as good."
        )
    elif lower := _lower_medians(evaluation):
        steps.append(
            f"If rare failures do not matter, compare the medians: {'; '.join(lower)} "
            f"{'has' if len(lower) == 1 else 'have'} a lower one."
        )
    if any("RUN" in step for step in steps):
        steps.append("RUN is the folder of this page.")
    return steps


def filter_words(found: Description) -> str:
    """A contender described by its parameters."""
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
