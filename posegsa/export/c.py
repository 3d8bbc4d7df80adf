"""The schedule as one C99 file that includes nothing, allocates nothing and remembers nothing.

The code mirrors `fuzzy` operation by operation, so that both agree to rounding even where few rules
fire, and weakly: there a gain depends on differences of small heights.
"""

import textwrap
from collections.abc import Iterable, Sequence
from string import Template

import numpy as np

from posegsa.arguments import check_type
from posegsa.config import PARAMETERS, TERMS, ScenarioConfig
from posegsa.export.c_source import (
    CENTROIDS,
    DECLARATIONS,
    GAIN,
    MEMBERSHIP,
    NAN_POLICY,
    NO_RULE,
    SAMPLED_CONSTANTS,
)
from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.result import VERSION, TuneResult
from posegsa.model.fuzzy import FuzzyController
from posegsa.settings.fields import Section

_WIDTH = 96
"""Columns of the comment's text."""


def export_c(result: TuneResult) -> str:
    """A C99 file with `posegsa_gain` and `posegsa_initial_gain`.

    It computes in `POSEGSA_REAL`, which is double unless it is defined as float when compiling.
    Its head comment says how the inputs are formed, in which units, and what the schedule is worth.
    """
    check_type("result", result, TuneResult)
    controller = result.controller
    return "\n".join([_comment(_head(result, controller)), _code(controller)])


# The code -----------------------------------------------------------------------------------------


def _code(controller: FuzzyController) -> str:
    low, high = controller.output_range
    parts = [
        DECLARATIONS,
        Template(SAMPLED_CONSTANTS).substitute(
            points=controller.points,
            end_weight=0.5 if controller.sampled_rule == "trapezoid" else 1.0,
            low=repr(float(low)),
            high=repr(float(high)),
        )
        if controller.centroid == "sampled"
        else "",
        MEMBERSHIP,
        CENTROIDS[controller.centroid],
        Template(GAIN).substitute(no_rule=NO_RULE[controller.no_rule]),
    ]
    return Template("\n".join(part for part in parts if part)).substitute(
        inputs=len(controller.input_terms),
        outputs=len(controller.output_terms),
        input_terms=_table(controller.input_terms),
        output_terms=_table(controller.output_terms),
        rules=_rows(
            (", ".join(map(str, row)) for row in controller.rules),
            [f"rate {name}" for name in TERMS],
        ),
        # As JAX has it: formed in double, then rounded.
        initial_gain=repr(1 + 0.5 * (low + high)),
    )


def _table(terms: object) -> str:
    """Terms as rows of a C table; a float32 is written so that reading it as float is exact."""
    values = np.asarray(terms).tolist()
    return _rows((", ".join(f"POSEGSA_C({x!r})" for x in term) for term in values), TERMS)


def _rows(rows: Iterable[str], names: Sequence[str]) -> str:
    return "\n".join(f"    {{{row}}}, /* {n} */" for row, n in zip(rows, names, strict=True))


# The head comment ---------------------------------------------------------------------------------


def _comment(lines: Sequence[str]) -> str:
    """A block comment; no line of it can end it early, or begin another."""
    safe = [line.replace("*/", "* /").replace("/*", "/ *").rstrip() for line in lines]
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in safe), " */", ""])


def _head(result: TuneResult, controller: FuzzyController) -> list[str]:
    experiment = result.experiment
    run, search = experiment.run, experiment.search
    return [
        "Fuzzy gain schedule of a pose filter on SE(3), as C99; also valid C++.",
        *_text(
            f"Written by posegsa {VERSION}. Tuned with posegsa {result.version} in {run.dtype}: "
            f"{search.optimiser}, {search.size_in_words()}, seed {run.seed}."
        ),
        "",
        *_costs(result),
        "",
        "WHAT IT COMPUTES",
        *_text(
            "posegsa_gain(error, rate, last_gain) is the gain K [1/s] that the filter multiplies "
            "its innovation with, before a limit of its own. error and rate have no unit and are "
            "clipped to [0, 1]; last_gain [1/s] is what the last call returned, "
            "posegsa_initial_gain() before the first. Mamdani inference: min for AND and "
            "implication, max for aggregation, K = 1 + "
            + _centroid_text(controller)
            + " of the output."
        ),
        *_text(f"Where no rule fires: {_NO_RULE_TEXT[controller.no_rule]}."),
        "",
        "HOW error AND rate ARE FORMED, once a sample, with the estimate before its update",
        *_signal(result),
        "",
        "USE",
        "    gain = posegsa_initial_gain();",
        "    for each sample: gain = posegsa_gain(error, rate, gain);",
        "",
        "INPUTS OUT OF THE ORDINARY",
        *_text(NAN_POLICY),
        "",
        "PRECISION",
        *_text(
            "POSEGSA_REAL is double; compile with -DPOSEGSA_REAL=float for single precision. "
            "No headers, no allocation, no state: it may be called from threads and interrupts."
        ),
        "",
        "THE FILTER IT WAS TUNED IN; in another one the gains may not fit",
        *_settings(experiment.filter),
        "",
        "PARAMETERS",
        *_text(
            ", ".join(
                f"{name}={value!r}"
                for name, value in zip(PARAMETERS, result.parameters.tolist(), strict=True)
            )
        ),
    ]


def _costs(result: TuneResult) -> list[str]:
    """What the schedule is worth, and whether to believe it."""
    rows = (
        (TUNED, "this schedule", result.training_costs),
        (
            CONSTANT,
            f"best constant gain {result.constant_gain:.4g}/s",
            result.constant_training_costs,
        ),
    )
    lines = [f"{'Cost':<30}{'training':>10}{'held out':>10}{'95 % interval':>22}{'worst':>10}"]
    for key, name, training in rows:
        mean, low, high = result.evaluation.cost(key)
        worst = np.max(result.evaluation.contenders[key].metrics.cost)
        interval = f"[{low:.5g}, {high:.5g}]"
        lines.append(
            f"  {name:<28}{np.mean(training):>10.5g}{mean:>10.5g}{interval:>22}{worst:>10.5g}"
        )
    lines += _text(
        f"Means over {len(result.training_costs)} training scenarios and over "
        f"{result.evaluation.scenarios} held-out ones, which the search has not seen; worst of the "
        "held-out ones."
    )
    if result.trust.sensitive:
        lines += _text(
            "WARNING: the training cost depends on rounding (float32, float64, a change of 1e-6 of "
            "the start) by more than 1 %."
        )
    return lines


_NO_RULE_TEXT = {
    "hold": "last_gain is held",
    "midrange": "1 + the middle of the output range",
}


def _centroid_text(controller: FuzzyController) -> str:
    if controller.centroid == "exact":
        return "the exact centroid (closed form)"
    how = {"sum": "summed alike", "trapezoid": "summed as trapezoids"}[controller.sampled_rule]
    return f"the centroid by {controller.points} samples ({how})"


def _signal(result: TuneResult) -> list[str]:
    """How the inputs come from measurements, with the run's constants."""
    gain, scenario = result.experiment.gain, result.experiment.scenario
    if gain.signal == "measured":
        parts = [
            "attitude = 3 / (8 sum_i s_i) sum_i s_i |R_est v_i^B - v_i^I|^2   [no unit]",
            "    over the vectors i measured in this sample, s_i their weights; 0 without any",
            "position = sum_i w_i |T_est y_i - p_i| / sum_i w_i   [m]",
            "    over the landmarks i measured in this sample, w_i their weights; 0 without any",
        ]
        symbols = (
            "R_est: estimated attitude, body to inertial frame; T_est y = R_est y + P_est [m]; "
            "v_i^B: vector as measured, body frame; v_i^I: the same vector, inertial frame"
            + ("; both at length one" if scenario.normalise_vectors else "")
            + "; y_i: landmark as measured, body frame [m]; p_i: its place, inertial frame [m]."
        )
        known = _known(scenario)
    else:
        parts = [
            "attitude = tr(I - R_err) / 4, R_err = R_est R^T   [0 to 1, no unit]",
            "position = |P_est - R_err P|   [m]",
        ]
        symbols = (
            "An oracle, for simulation only: R (body to inertial frame) and P [m] are the TRUE "
            "attitude and position, R_est and P_est the estimated ones. A vehicle does not have "
            "them."
        )
        known = []
    smoothed = "e = now"
    if gain.smoothing > 0:
        smoothed = (
            f"e = before + dt / ({gain.smoothing!r} s + dt) (now - before)   [smoothed; dt: the "
            "time since the last sample]"
        )
    return [
        *(f"    {line}" for line in parts),
        f"    now = attitude + {gain.position_weight!r} x position",
        f"    {smoothed}",
        f"    error = e / {gain.error_scale!r}",
        f"    rate = |e - before| x {gain.rate_scale!r}",
        "    before is e of the sample before, and now at the first sample: there rate is 0",
        *_text(symbols),
        *known,
        "The section [gain] of the run:",
        *_settings(gain),
    ]


def _known(scenario: ScenarioConfig) -> list[str]:
    """The vectors and landmarks of the run, with their weights."""
    rows = [
        f"  v_{i}^I = {vector.direction}, weight {vector.weight!r}"
        for i, vector in enumerate(scenario.vectors, start=1)
    ]
    if scenario.cross_vector:
        i = len(rows) + 1
        rows.append(f"  v_{i} = v_1 x v_2, weight {scenario.cross_vector_weight!r}")
    rows += [
        f"  p_{i} = {landmark.position} m, weight {landmark.weight!r}"
        for i, landmark in enumerate(scenario.landmarks, start=1)
    ]
    return ["In the run's scenario:", *rows]


def _settings(section: Section) -> list[str]:
    """Every field of a section of the configuration, with its value and description."""
    lines = []
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        described = " ".join((field.description or "").split())
        lines += _text(f"{name} = {value!r}. {described}", first="  ", further="      ")
    return lines


def _text(text: str, first: str = "", further: str = "") -> list[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=first,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
