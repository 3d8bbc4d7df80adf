"""The rows of the tables of the tuned schedule and of its simulations."""

import numpy as np

from posegsa import config
from posegsa.judging.result import Result
from posegsa.judging.trust import PERTURBATION
from posegsa.report.numbers import cost, number, percent
from posegsa.search.search_spaces import rule_indices

Noted = tuple[str, list[tuple[str, str]]]
"""A row: its header, and for each cell its text and a note."""


def terms(result: Result, part: slice, ends: tuple[float, float]) -> list[Noted]:
    """The corners of terms, VS to VL, each with the name of its parameter.

    Args:
        result: Of a fuzzy schedule.
        part: The parameters of these terms.
        ends: The range of the terms.
    """
    low, high = (f"{end:g}" for end in ends)
    corners = config.triangles([number(k, ".5g") for k in result.parameters[part]], low, high)
    names = config.triangles(config.PARAMETERS[part], "fixed", "fixed")
    return [
        (term, list(zip(row, named, strict=True)))
        for term, row, named in zip(config.TERMS, corners, names, strict=True)
    ]


def rules(result: Result) -> list[Noted]:
    """The output term of each rule with its weight; a row is a rate, a column an error."""
    table = result.tuned.fuzzy.rules
    assert table != config.SEARCHED  # a tuned experiment has a table of rules
    judged = result.on_scenarios
    assert judged is not None
    assert judged.trust.rule_weights is not None
    targets, rows = rule_indices(table), []
    each = zip(config.TERMS, targets, judged.trust.rule_weights, strict=True)
    for rate, row, weights in each:
        outputs = [config.TERMS[i] for i in row]
        shown = [number(weight, ".2g") for weight in weights]
        rows.append((f"Rate {rate}", list(zip(outputs, shown, strict=True))))
    return rows


def simulations(result: Result) -> list[tuple[str, str, str]]:
    """Ways of simulating the training scenarios, with their mean costs and deviations.

    The deviation is relative to the cost in the run's own precision.
    """
    assert result.on_scenarios is not None
    trust, own = result.on_scenarios.trust, result.experiment.run.dtype
    costs = {"float32": trust.cost_float32, "float64": trust.cost_float64}
    reference = np.float64(costs[own])
    costs[f"{own}, initial pose changed by {PERTURBATION:g}"] = trust.cost_perturbed
    return [
        (
            f"{name} (used in the run)" if name == own else name,
            cost(value, ".4f"),
            percent(value / reference - 1, "+.2g"),
        )
        for name, value in costs.items()
    ]
