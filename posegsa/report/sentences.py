"""Sentences that depend on the results."""

import numpy as np

from posegsa.judging.description import TITLES, Description
from posegsa.judging.evaluation import (
    BEHAVIOUR,
    EKF_CLOCK,
    OPEN_LOOP,
    REPLAYED,
    SWITCH,
    Evaluation,
    called,
)
from posegsa.judging.on_recordings import OnRecordings, mean_errors
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.result import Result
from posegsa.report.numbers import number
from posegsa.search.population import CONFIGURED


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


def _starting(evaluation: Evaluation) -> str:
    """The name of the judged filter, for the start of a sentence."""
    words = called(evaluation.own)
    return words[:1].upper() + words[1:]


def next_words(result: Result) -> list[str]:
    """Advice on next steps; each item is one or more sentences, with code between backticks."""
    judged = result.on_scenarios
    assert judged is not None
    evaluation, beside = judged.evaluation, judged.beside
    steps = []
    if result.warnings():
        steps.append("Read the warnings above first: they say why these numbers may mislead.")
    better = [name for name in evaluation.better if name != beside]
    if better:
        if any(name in (REPLAYED, OPEN_LOOP, SWITCH, EKF_CLOCK) for name in better):
            steps.append(
                "A schedule that depends only on time is simpler. It suits a filter that starts as "
                "in these scenarios, and does not react to later errors."
            )
        steps.append(
            "The parameters of the better filters are in `result.json`. The filter of this page "
            "can still be exported: `posegsa export RUN --format c`."
        )
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
