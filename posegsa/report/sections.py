"""The sections of the report, each a function from the result to HTML."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from posegsa import config
from posegsa.figures.evaluation import NAMES, angles_differ
from posegsa.judging.evaluation import ORACLE, TUNED, Contender, Evaluation
from posegsa.judging.metrics import (
    DIVERGED_ATTITUDE,
    DIVERGED_POSITION,
    SETTLED_ATTITUDE,
    SETTLED_POSITION,
)
from posegsa.judging.result import TuneResult
from posegsa.judging.trust import PERTURBATION, SENSITIVE, Trust
from posegsa.report.figures import ONE_RUN, SCHEDULE, SEARCH, figures
from posegsa.report.markup import (
    DASH,
    INFINITE,
    Html,
    cost,
    element,
    interval,
    join,
    number,
    paragraph,
    section,
    table,
)
from posegsa.report.words import what_was_run as words
from posegsa.search.build import rule_indices
from posegsa.words import counted


def about(result: TuneResult) -> Html:
    """The line under the title."""
    run = result.experiment.run
    return paragraph(f"posegsa {result.version}, seed {run.seed}, {run.dtype}", class_="about")


def what_was_run(result: TuneResult) -> Html:
    """The run in words."""
    rows = [(name, text) for name, text in words(result)]
    return section(
        "What was run",
        table("The run in words", ("Part", "Description"), rows, class_="text"),
    )


def contenders(result: TuneResult, pictures: Mapping[str, bytes]) -> Html:
    """All contenders side by side, as tables and figures."""
    evaluation = result.evaluation
    each = evaluation.contenders.items()
    costs = table(
        f"Cost on {counted(evaluation.scenarios, 'held-out scenario')}, no unit",
        (
            *("Contender", "Mean", "95 % interval", "Median", "95th percentile", "Worst"),
            *("Tuned minus this", "95 % interval", "Diverged"),
        ),
        [(name, *_cost_cells(name, evaluation)) for name, _ in each],
        class_="contenders",
        own=TUNED,
    )
    behaviour = table(
        "Where the cost comes from, and the errors behind it",
        (
            *("Contender", "Transient part", "Steady part"),
            *("Attitude settled [s]", "Position settled [s]"),
            *("Steady attitude RMS [deg]", "Steady position RMS [cm]"),
            *("Bias error, angular [rad/s]", "Bias error, linear [m/s]"),
        ),
        [(name, *_behaviour_cells(contender)) for name, contender in each],
        class_="contenders",
        own=TUNED,
    )
    found = table(
        "What each contender is",
        ("Contender", "Schedule"),
        [(name, schedule_words(contender.schedule)) for name, contender in each],
        class_="contenders text",
    )
    angle = np.median(evaluation.contenders[TUNED].metrics.initial_angle)
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
        *([] if ORACLE in evaluation.contenders else [_MORE]),
        *([] if angles_differ(evaluation) else [paragraph(same, class_="note")]),
        figures(NAMES, pictures),
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
        figures(SCHEDULE, pictures),
    )


def trust(result: TuneResult) -> Html:
    """Numerical sensitivity and coverage."""
    found, own = result.trust, result.experiment.run.dtype
    costs = {"float32": found.cost_float32, "float64": found.cost_float64}
    start = f"{own}, start changed by {PERTURBATION:g}"
    rows = [
        (name + (" (the run's own)" if name == own else ""), value)
        for name, value in {**costs, start: found.cost_perturbed}.items()
    ]
    with np.errstate(all="ignore"):
        away = [
            100 * (np.float64(value) - costs[own]) / np.float64(costs[own]) for _, value in rows
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
            [
                (name, cost(value, ".4f"), f"{number(d, '+.2g')} %")
                for (name, value), d in zip(rows, away, strict=True)
            ],
        ),
        paragraph(_coverage(found)),
    )


def _coverage(found: Trust) -> str:
    """How much of the inputs the rules cover, and how many of them are used."""
    covered = (
        f"No rule fires for {number(100 * found.uncovered, '.1f')} % of all pairs of scaled error "
        "and rate."
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


def one_run(result: TuneResult, pictures: Mapping[str, bytes]) -> Html:
    """One held-out scenario over time."""
    return section("One held-out scenario", figures(ONE_RUN, pictures))


def search(pictures: Mapping[str, bytes]) -> Html:
    """How the search went."""
    return section("The search", figures(SEARCH, pictures))


def configuration(result: TuneResult) -> Html:
    """The whole experiment as TOML, which `posegsa tune` runs again."""
    text = element("pre", element("code", config.to_toml(result.experiment)), tabindex="0")
    title = element("summary", "The whole experiment as TOML, every default included")
    return section("Configuration", element("details", title, text))


def environment(result: TuneResult) -> Html:
    """Versions and device."""
    rows = list(({"posegsa": result.version} | result.environment).items())
    return section(
        "Environment", table("Where the run was made", ("Part", "Version"), rows, class_="text")
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


def _cost_cells(name: str, evaluation: Evaluation) -> list[str]:
    metrics, mean = evaluation.contenders[name].metrics, evaluation.cost(name)
    cells = [
        cost(mean.mean),
        interval(*mean[1:], ".2f"),
        cost(float(np.median(metrics.cost))),
        cost(float(np.quantile(metrics.cost, 0.95, method="lower"))),
        cost(float(np.max(metrics.cost))),
    ]
    if name == TUNED:
        cells += ["", ""]
    else:
        difference = evaluation.difference(name)
        cells += [cost(difference.mean, "+.2f"), interval(*difference[1:])]
    return [*cells, f"{number(100 * float(np.mean(metrics.diverged)), '.1f')} %"]


def _behaviour_cells(contender: Contender) -> list[str]:
    m = contender.metrics
    return [
        cost(float(np.mean(m.transient))),
        cost(float(np.mean(m.steady))),
        number(float(np.median(m.settling_attitude))),
        number(float(np.median(m.settling_position))),
        number(float(np.mean(m.rms_attitude))),
        number(100 * float(np.mean(m.rms_position)), ".1f"),
        number(float(np.mean(m.bias_angular)), ".3f"),
        number(float(np.mean(m.bias_linear)), ".3f"),
    ]


def _terms(values: np.ndarray, names: tuple[str, ...], low: float, high: float) -> list[list[str]]:
    """Rows of a table of five terms: each corner with the parameter that it is."""
    corners = config.triangles([number(v, ".5g") for v in values], f"{low:g}", f"{high:g}")
    labels = config.triangles(names, "fixed", "fixed")
    return [
        [
            term,
            *(
                join([corner, " ", element("small", label)])
                for corner, label in zip(row, of_row, strict=True)
            ),
        ]
        for term, row, of_row in zip(config.TERMS, corners, labels, strict=True)
    ]


def _rules(result: TuneResult) -> Html:
    """The rule table with the weight of each rule."""
    targets = rule_indices(result.experiment.fuzzy.rules)
    rows = [
        [
            f"Rate {term}",
            *(
                join([config.TERMS[target], " ", element("small", number(weight, ".2g"))])
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
