"""The sections of the report, each a function from the result to HTML."""

from collections.abc import Iterable, Mapping

import numpy as np

from posegsa import config
from posegsa.figures import evaluation as evaluation_figures
from posegsa.figures import schedule as schedule_figures
from posegsa.figures.captioned import ResultFigure
from posegsa.judging.evaluation import SWITCH, TUNED, Description
from posegsa.judging.metrics import (
    DIVERGED_ATTITUDE,
    DIVERGED_POSITION,
    SETTLED_ATTITUDE,
    SETTLED_POSITION,
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
    join,
    number,
    paragraph,
    section,
    table,
)
from posegsa.search.build import rule_indices
from posegsa.words import counted, toml


def contenders(result: TuneResult, pictures: Mapping[str, bytes]) -> Html:
    """All contenders side by side, as tables and figures."""
    evaluation = result.evaluation
    each = evaluation.contenders
    captions = (
        f"Cost on {counted(evaluation.scenarios, 'held-out scenario')}, no unit",
        "Where the cost comes from, and the errors behind it",
    )
    numbers = [
        table(caption, head, rows, class_="contenders", own=TUNED)
        for caption, (head, *rows) in zip(captions, evaluation.tables(cost), strict=True)
    ]
    found = table(
        "What each contender is",
        ("Contender", "Schedule"),
        [(name, filter_words(contender.filter)) for name, contender in each.items()],
        class_="contenders text",
    )
    notes = []
    if SWITCH not in each:
        more = " adds the time switch, other schedules and Kalman filters to the contenders."
        notes.append(paragraph(element("code", "posegsa evaluate"), more, class_="note"))
    if not evaluation_figures.angles_differ(evaluation):
        angle = number(np.median(each[TUNED].metrics.initial_angle), ".1f")
        same = (
            f"All scenarios start at an attitude error of {angle} deg, so that cost against "
            "initial angle has nothing to show."
        )
        notes.append(paragraph(same, class_="note"))
    return section(
        "Held-out evaluation",
        *numbers,
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
        *notes,
        figures(evaluation_figures.FIGURES, pictures),
    )


def schedule(result: TuneResult, pictures: Mapping[str, bytes]) -> Html:
    """The tuned schedule: parameters as terms, rules with their weight, figures."""
    half, gains = len(config.PARAMETERS) // 2, result.experiment.parameters.gain_range
    inputs = "Input terms, of scaled error and scaled rate [-]"
    outputs = "Output terms [1/s]; gain K = 1 + centroid"
    tables = (
        _terms(inputs, result, slice(half), config.INPUT_RANGE),
        _terms(outputs, result, slice(half, None), gains),
    )
    return section(
        "The tuned schedule",
        element("div", *tables, class_="figures"),
        _rules(result),
        figures(schedule_figures.FIGURES, pictures),
    )


def trust(result: TuneResult) -> Html:
    """Numerical sensitivity and coverage."""
    found, own = result.trust, result.experiment.run.dtype
    simulated = {"float32": found.cost_float32, "float64": found.cost_float64}
    reference = simulated[own]
    simulated[f"{own}, start changed by {PERTURBATION:g}"] = found.cost_perturbed
    rows = []
    for name, value in simulated.items():
        with np.errstate(all="ignore"):
            away = np.float64(value) / reference - 1
        said = f"{name} (the run's own)" if name == own else name
        rows.append((said, cost(value, ".4f"), _percent(away, "+.2g")))
    within = f"{100 * SENSITIVE:g} %"
    if found.sensitive:
        verdict = element(
            "strong",
            f"Sensitive: these costs differ by more than {within}, or are not finite. The "
            "simulation is chaotic with this schedule; do not trust its costs.",
        )
    else:
        verdict = f"Not sensitive: the costs agree within {within}."
    heads = ("Simulated in", "Cost", "Difference")
    return section(
        "Trust checks",
        paragraph(verdict),
        table("Mean training cost of the tuned schedule", heads, rows),
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


def filter_words(found: Description) -> str:
    """What a contender is, by its own numbers."""
    numbers = {name: values[0] for name, values in found.numbers.items() if len(values) == 1}
    match found.kind:
        case "fuzzy":
            words = f"fuzzy, k1 to k{len(found.numbers['k'])}"
        case "open loop":
            time = found.numbers["time"]
            words = f"{len(time)} knots of K(t) from {time[0]:.3g} to {time[-1]:.4g} s, open loop"
        case kind:
            words = f"{kind}: " + ", ".join(f"{name} = {n:.4g}" for name, n in numbers.items())
    also = [f"{key} = {value:.4g}" for key, value in found.also.items()]
    return "; ".join([words, *also])


def _percent(share: float | np.floating, form: str = ".1f") -> str:
    return f"{number(100 * share, form)} %"


def figures(described: Iterable[ResultFigure], pictures: Mapping[str, bytes]) -> Html:
    """Those of some figures that there are, PNG files by name."""
    shown = [figure(each, pictures[each.name]) for each in described if each.name in pictures]
    return element("div", join(shown, "\n"), class_="figures")


def _with_small(text: str, small: str) -> Html:
    return join([text, " ", element("small", small)])


def _terms(caption: str, result: TuneResult, part: slice, ends: tuple[float, float]) -> Html:
    """A table of five terms: each corner with the parameter that it is."""
    low, high = (f"{end:g}" for end in ends)
    values = [number(value, ".5g") for value in result.parameters[part]]
    corners = config.triangles(values, low, high)
    names = config.triangles(config.PARAMETERS[part], "fixed", "fixed")
    rows = [
        [term, *map(_with_small, row, named)]
        for term, row, named in zip(config.TERMS, corners, names, strict=True)
    ]
    return table(caption, ("Term", "Left foot", "Peak", "Right foot"), rows)


def _rules(result: TuneResult) -> Html:
    """The rule table with the weight of each rule."""
    targets, rows = rule_indices(result.experiment.fuzzy.rules), []
    for term, row, weights in zip(config.TERMS, targets, result.trust.rule_weights, strict=True):
        outputs = [config.TERMS[i] for i in row]
        shown = [number(weight, ".2g") for weight in weights]
        rows.append([f"Rate {term}", *map(_with_small, outputs, shown)])
    return table(
        "Rules, and the mean firing strength of each over one held-out trajectory, 0 to 1",
        ("Rule: output term, weight", *(f"Error {term}" for term in config.TERMS)),
        rows,
    )
