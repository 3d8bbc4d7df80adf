"""Sentences that depend on the results."""

import math

import numpy as np

from posegsa.judging.description import TITLES, Description
from posegsa.judging.evaluation import (
    BEHAVIOUR,
    EKF,
    EKF_VECTORS,
    OPEN_LOOP,
    REPLAYED,
    SWITCH,
    Evaluation,
    called,
)
from posegsa.judging.on_recordings import OnRecordings, mean_errors
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.result import Result
from posegsa.report.numbers import cost, interval, number
from posegsa.search.population import CONFIGURED
from posegsa.words import counted


def verdict(judged: OnScenarios) -> str:
    """A sentence that compares the judged filter with the one that it is always compared with."""
    evaluation, beside = judged.evaluation, judged.beside
    own_filter = _starting(evaluation)
    difference = evaluation.difference(beside)
    mean, low, high = difference
    against = f"{called(beside)} on {counted(evaluation.scenarios, 'unseen scenario')}"
    if not (math.isfinite(low) and math.isfinite(high)):
        own, other = (evaluation.contenders[name].metrics.cost for name in (evaluation.own, beside))
        bad = [np.count_nonzero(~np.isfinite(costs)) for costs in (own, other)]
        if not any(bad):
            return f"{own_filter} cannot be compared with {against}: there are too few."
        return (
            f"The mean cost of {called(evaluation.own)} cannot be compared with that of {against}: "
            f"{bad[0]} and {bad[1]} of their costs are infinite. Their medians are "
            f"{cost(float(np.median(own)))} and {cost(float(np.median(other)))}."
        )
    if low <= 0 <= high:
        return (
            f"{own_filter} does not differ significantly from {against}: the 95 % interval "
            f"of the difference, {interval(difference)}, includes 0."
        )
    less = high < 0
    by, minimum, maximum = (-mean, -high, -low) if less else (mean, low, high)
    constant = evaluation.cost(beside).mean
    share = f"{number(100 * by / constant, '.1f')}\u00a0%; " if constant > 0 else ""
    return (
        f"{own_filter} costs {cost(by)} {'less' if less else 'more'} ({share}95 % interval "
        f"{cost(minimum)} to {cost(maximum)}) than {against}."
    )


def recorded_errors(on: OnRecordings) -> dict[str, str]:
    """The errors of a filter and of the compared filters on the same recordings, by name."""
    label = "held out" if on.held_out else "tuned on"
    each = {f"This filter, {label}": on.held_out or on.training}
    each |= {f"{name}, {label}": scores for name, scores in on.baselines.items() if on.held_out}
    found = {}
    for name, scores in each.items():
        if scores:
            mean = mean_errors(scores)
            position = "" if mean.position is None else f", {number(100 * mean.position, '.3g')} cm"
            found[name] = f"{number(mean.total, '.3g')} deg{position}"
    return found


def cost_words(result: Result) -> str:
    """Sentences that explain the cost of a run."""
    search = result.search
    if search is not None and search.cost != CONFIGURED:
        return (
            f"The function {search.cost} computes the cost of a run from its errors over time; "
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


def worse_words(judged: OnScenarios) -> str:
    """Which errors of the judged filter are larger than those of the compared filter, if any."""
    contenders, beside = judged.evaluation.contenders, judged.beside
    tuned, constant = (contenders[name].metrics for name in (judged.evaluation.own, beside))
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
        f"{_starting(judged.evaluation)} is worse than {called(beside)} in: {listed}. The search "
        "minimises only the cost; quantities that are not part of it, for example the errors of "
        "the estimated biases, may get worse."
    )


def better_words(judged: OnScenarios) -> str:
    """Which other contenders, except the compared filter, are better than the judged one, if any.

    The mean counts as better if the interval of the paired differences excludes 0, the median if it
    is lower in the digits shown.
    """
    evaluation = judged.evaluation
    own, lower = evaluation.summary(evaluation.own), _lower_medians(evaluation)
    found = []
    for name in evaluation.contenders:
        if name in (evaluation.own, judged.beside):
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
    own_filter = called(evaluation.own)
    return f"Other filters are better than {own_filter} on these scenarios: {'; '.join(found)}."


def _starting(evaluation: Evaluation) -> str:
    """The name of the judged filter, for the start of a sentence."""
    words = called(evaluation.own)
    return words[:1].upper() + words[1:]


def _clearly_better(evaluation: Evaluation) -> list[str]:
    """Contenders whose mean cost is significantly lower than that of the judged filter."""
    others = (name for name in evaluation.contenders if name != evaluation.own)
    return [name for name in others if evaluation.difference(name).low > 0]


def _lower_medians(evaluation: Evaluation) -> list[str]:
    """Contenders whose median cost is lower than that of the judged filter in the digits shown."""
    own = evaluation.summary(evaluation.own).median
    medians = {name: evaluation.summary(name).median for name in evaluation.contenders}
    return [name for name, each in medians.items() if each < own and cost(each) != cost(own)]


def _instead(names: list[str]) -> str:
    """Advice if these filters are better than the judged one."""
    advice = f"These have a lower mean cost: {'; '.join(names)}. "
    if any(name in (REPLAYED, OPEN_LOOP, SWITCH) for name in names):
        advice += (
            "Gains that depend only on time are simpler and need no error signal. They suit a "
            "filter that starts as in these scenarios, and do not react to later errors. "
        )
    if any(name in (EKF, EKF_VECTORS) for name in names):
        advice += "`--set filter.kind=kalman` tunes a Kalman filter. "
    return (
        f"{advice}Their parameters are in `result.json`. The filter of this page can still be "
        "exported: `posegsa export RUN --format c`."
    )


def next_words(result: Result) -> list[str]:
    """Advice on next steps; each item is one or more sentences, with code between backticks."""
    judged = result.on_scenarios
    assert judged is not None
    evaluation, beside = judged.evaluation, judged.beside
    steps = []
    if result.warnings():
        steps.append("Read the warnings above first: they say why these numbers may mislead.")
    better = _clearly_better(evaluation)
    if any(name != beside for name in better):
        steps.append(_instead(better))
    elif evaluation.difference(beside).high < 0:
        steps.append(
            f"{_starting(evaluation)} is better than {called(beside)}: export it as C with "
            "`posegsa export RUN --format c`, or run it on your own recordings with "
            "`posegsa replay RUN FILE`."
        )
    else:
        steps.append(
            f"{_starting(evaluation)} is not better than {called(beside)}: search longer "
            "(`search.iterations`) or with more training scenarios, or take the simpler one: "
            f"{filter_words(evaluation.contenders[beside].filter)}."
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
    simple = [f"{name} = {each[0]:.4g}" for name, each in found.numbers.items() if len(each) == 1]
    match found.kind:
        case "fuzzy":
            own = f"fuzzy, k1 to k{len(found.numbers['k'])}"
        case "open loop":
            time = found.numbers["time"]
            own = f"{len(time)} knots of K(t) from {time[0]:.3g} to {time[-1]:.4g} s, open loop"
        case kind if simple:
            own = f"{kind}: {', '.join(simple)}"
        case kind:
            own = TITLES.get(kind, kind)
    return "; ".join([own, *(f"{key} = {value:.4g}" for key, value in found.also.items())])
