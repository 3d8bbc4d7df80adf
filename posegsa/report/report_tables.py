"""The rows of the tables of the tuned schedule and of its simulations."""

import numpy as np

from posegsa import config
from posegsa.judging.result import Result
from posegsa.judging.trust import PERTURBATION
from posegsa.report.numbers import number
from posegsa.search.search_spaces import rule_indices

Noted = tuple[str, list[tuple[str, str]]]
"""A row: its header, and for each cell its text and a note."""


def input_terms(result: Result) -> list[Noted]:
    """The corners of the input terms, VS to VL, each with the name of its parameter."""
    return _terms(result, slice(11), config.INPUT_RANGE)


def output_terms(result: Result) -> list[Noted]:
    """The corners of the output terms, VS to VL, each with the name of its parameter."""
    return _terms(result, slice(11, None), result.experiment.parameters.gain_range)


def _terms(result: Result, part: slice, ends: tuple[float, float]) -> list[Noted]:
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


def simulations(result: Result) -> list[tuple[str, float, float]]:
    """Ways of simulating the training scenarios, with their mean costs and deviations.

    The deviation is relative to the cost in the run's own precision.
    """
    assert result.on_scenarios is not None
    trust, own = result.on_scenarios.trust, result.experiment.run.dtype
    costs = {"float32": trust.cost_float32, "float64": trust.cost_float64}
    reference = np.float64(costs[own])
    costs[f"{own}, initial pose changed by {PERTURBATION:g}"] = trust.cost_perturbed
    return [
        (f"{name} (used in the run)" if name == own else name, cost, cost / reference - 1)
        for name, cost in costs.items()
    ]
