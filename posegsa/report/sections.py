"""The sections of the report, each a function from the result to HTML."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from posegsa import config
from posegsa.figures import evaluation as evaluation_figures
from posegsa.figures import schedule as schedule_figures
from posegsa.figures.captioned import ResultFigure
from posegsa.judging.evaluation import ORACLE, TUNED, Evaluation
from posegsa.judging.metrics import (
    DIVERGED_ATTITUDE,
    DIVERGED_POSITION,
    SETTLED_ATTITUDE,
    SETTLED_POSITION,
    Metrics,
)
from posegsa.judging.result import TuneResult
from posegsa.judging.trust import PERTURBATION, SENSITIVE, Trust
from posegsa.report.markup import (
    DASH,
    INFINITE,
    Html,
    cost,
    details,
    element,
    figure,
    interval,
    join,
    number,
    paragraph,
    section,
    table,
)
from posegsa.search.build import rule_indices
from posegsa.words import counted, toml

_COSTS: tuple[tuple[str, Callable[[Evaluation, str], str]], ...] = (
    ("Mean", lambda e, name: cost(e.cost(name).mean)),
    ("95 % interval", lambda e, name: interval(*e.cost(name)[1:], ".2f")),
    ("Median", lambda e, name: cost(np.median(_costs(e, name)))),
    ("95th percentile", lambda e, name: cost(np.quantile(_costs(e, name), 0.95, method="lower"))),
    ("Worst", lambda e, name: cost(np.max(_costs(e, name)))),
    ("Tuned minus this", lambda e, name: _other(name, cost(e.difference(name).mean, "+.2f"))),
    ("95 % interval", lambda e, name: _other(name, interval(*e.difference(name)[1:]))),
    ("Diverged", lambda e, name: _percent(np.mean(e.contenders[name].metrics.diverged))),
)
_BEHAVIOUR: tuple[tuple[str, Callable[[Metrics], str]], ...] = (
    ("Transient part", lambda m: cost(np.mean(m.transient))),
    ("Steady part", lambda m: cost(np.mean(m.steady))),
    ("Attitude settled [s]", lambda m: number(np.median(m.settling_attitude))),
    ("Position settled [s]", lambda m: number(np.median(m.settling_position))),
    ("Steady attitude RMS [deg]", lambda m: number(np.mean(m.rms_attitude))),
    ("Steady position RMS [cm]", lambda m: number(100 * np.mean(m.rms_position), ".1f")),
    ("Bias error, angular [rad/s]", lambda m: number(np.mean(m.bias_angular), ".3f")),
    ("Bias error, linear [m/s]", lambda m: number(np.mean(m.bias_linear), ".3f")),
)
"""Columns of the tables of contenders: head, and what stands in a cell."""


def contenders(result: TuneResult, pictures: Mapping[str, bytes]) -> Html:
    """All contenders side by side, as tables and figures."""
    evaluation = result.evaluation
    each = evaluation.contenders
    costs = table(
        f"Cost on {counted(evaluation.scenarios, 'held-out scenario')}, no unit",
        ("Contender", *(head for head, _ in _COSTS)),
        [(name, *(cell(evaluation, name) for _, cell in _COSTS)) for name in each],
        class_="contenders",
        own=TUNED,
    )
    behaviour = table(
        "Where the cost comes from, and the errors behind it",
        ("Contender", *(head for head, _ in _BEHAVIOUR)),
        [(name, *(cell(of.metrics) for _, cell in _BEHAVIOUR)) for name, of in each.items()],
        class_="contenders",
        own=TUNED,
    )
    found = table(
        "What each contender is",
        ("Contender", "Schedule"),
        [(name, schedule_words(contender.schedule)) for name, contender in each.items()],
        class_="contenders text",
    )
    angle = np.median(each[TUNED].metrics.initial_angle)
    same = (
        f"All scenarios start at an attitude error of {number(angle, '.1f')} deg, so that cost "
        "against initial angle has nothing to show."
    )
    return section(
        "Held-out evaluation",
        costs,
        behaviour,
        paragraph(
            "Parts of the cost, RMS and bias errors are means over scenarios, settling times "
            f"medians. Settled: the attitude error stays under {SETTLED_ATTITUDE:g} deg, the "
            f"position error under {SETTLED_POSITION:g} m; {INFINITE} is never. RMS: over the "
            "cost's steady window. Bias error: at the end. Diverged: the cost is not finite, or "
            f"the mean error of the last second is above {DIVERGED_ATTITUDE:g} deg or "
            f"{DIVERGED_POSITION:g} m. {DASH}: no value, because a cost is not finite.",
            class_="note",
        ),
        found,
        *([] if ORACLE in each else [_MORE]),
        *([] if evaluation_figures.angles_differ(evaluation) else [paragraph(same, class_="note")]),
        figures(evaluation_figures.FIGURES, pictures),
    )


_MORE = paragraph(
    element("code", "posegsa evaluate"),
    " adds random search, a smooth schedule and the oracle to the contenders.",
    class_="note",
)


def schedule(result: TuneResult, pictures: Mapping[str, bytes]) -> Html:
    """The tuned schedule: parameters as terms, rules with their weight, figures."""
    half = len(config.PARAMETERS) // 2
    low, high = result.experiment.parameters.gain_range
    heads = ("Term", "Left foot", "Peak", "Right foot")
    tables = [
        table(title, heads, _terms(result.parameters[part], config.PARAMETERS[part], *ends))
        for title, part, ends in (
            ("Input terms, of scaled error and scaled rate [-]", slice(half), config.INPUT_RANGE),
            ("Output terms [1/s]; gain K = 1 + centroid", slice(half, None), (low, high)),
        )
    ]
    return section(
        "The tuned schedule",
        element("div", join(tables), class_="figures"),
        _rules(result),
        figures(schedule_figures.FIGURES, pictures),
    )


def trust(result: TuneResult) -> Html:
    """Numerical sensitivity and coverage."""
    found, own = result.trust, result.experiment.run.dtype
    costs = {"float32": found.cost_float32, "float64": found.cost_float64}
    simulated = {f"{name} (the run's own)" if name == own else name: c for name, c in costs.items()}
    simulated[f"{own}, start changed by {PERTURBATION:g}"] = found.cost_perturbed
    with np.errstate(all="ignore"):
        away = np.array(list(simulated.values())) / np.float64(costs[own]) - 1
    rows = [
        (name, cost(value, ".4f"), _percent(difference, "+.2g"))
        for (name, value), difference in zip(simulated.items(), away, strict=True)
    ]
    within = f"{100 * SENSITIVE:g} %"
    said = (
        f"Sensitive: these costs differ by more than {within}, or are not finite. The simulation "
        "is chaotic with this schedule; do not trust its costs."
        if found.sensitive
        else f"Not sensitive: the costs agree within {within}."
    )
    return section(
        "Trust checks",
        paragraph(element("strong", said) if found.sensitive else said),
        table(
            "Mean training cost of the tuned schedule",
            ("Simulated in", "Cost", "Difference"),
            rows,
        ),
        paragraph(_coverage(found)),
    )


def _coverage(found: Trust) -> str:
    """How much of the inputs the rules cover, and how many of them are used."""
    covered = (
        f"No rule fires for {_percent(found.uncovered)} of all pairs of scaled error and rate."
        if found.uncovered > 0
        else "Some rule fires for every pair of scaled error and rate."
    )
    weights = found.rule_weights
    rate, error = np.unravel_index(np.argmax(weights), weights.shape)
    never = np.count_nonzero(~(weights > 0))
    return (
        f"{covered} Over one held-out trajectory {never} of {weights.size} rules never fire; the "
        f"heaviest is that of error {config.TERMS[error]} and rate {config.TERMS[rate]}, with a "
        f"mean firing strength of {number(weights[rate, error], '.2g')}."
    )


def configuration(result: TuneResult) -> Html:
    """Every setting with its meaning, and all of them as TOML, which `posegsa tune` runs again."""
    settings = [
        (name, join([element("code", toml(value))]), description)
        for name, value, description in result.experiment.described()
    ]
    text = element("pre", element("code", config.to_toml(result.experiment)), tabindex="0")
    return section(
        "Configuration",
        details(
            "Every setting and what it means",
            table("Settings", ("Key", "Value", "Meaning"), settings, class_="text"),
        ),
        details("The whole experiment as TOML, every default included", text),
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


def _other(name: str, cell: str) -> str:
    """A cell that says something of the other contenders only."""
    return "" if name == TUNED else cell


def _costs(evaluation: Evaluation, name: str) -> np.ndarray:
    return evaluation.contenders[name].metrics.cost


def _percent(share: float | np.floating, form: str = ".1f") -> str:
    return f"{number(100 * share, form)} %"


def figures(described: Iterable[ResultFigure], pictures: Mapping[str, bytes]) -> Html:
    """Those of some figures that there are, PNG files by name."""
    shown = [figure(each, pictures[each.name]) for each in described if each.name in pictures]
    return element("div", join(shown, "\n"), class_="figures")


def _with_small(text: str, small: str) -> Html:
    return join([text, " ", element("small", small)])


def _terms(values: np.ndarray, names: tuple[str, ...], low: float, high: float) -> list[list[str]]:
    """Rows of a table of five terms: each corner with the parameter that it is."""
    corners = config.triangles([number(v, ".5g") for v in values], f"{low:g}", f"{high:g}")
    labels = config.triangles(names, "fixed", "fixed")
    return [
        [term, *map(_with_small, row, of_row)]
        for term, row, of_row in zip(config.TERMS, corners, labels, strict=True)
    ]


def _rules(result: TuneResult) -> Html:
    """The rule table with the weight of each rule."""
    targets = rule_indices(result.experiment.fuzzy.rules)
    rows = [
        [
            f"Rate {term}",
            *(
                _with_small(config.TERMS[target], number(weight, ".2g"))
                for target, weight in zip(row, weights, strict=True)
            ),
        ]
        for term, row, weights in zip(config.TERMS, targets, result.trust.rule_weights, strict=True)
    ]
    heads = ("Rule: output term, weight", *(f"Error {term}" for term in config.TERMS))
    return table(
        "Rules, and the mean firing strength of each over one held-out trajectory, 0 to 1",
        heads,
        rows,
    )
