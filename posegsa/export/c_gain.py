"""The controller alone as one C99 file without includes, allocation or state.

The code repeats the operations of `posegsa.model.fuzzy` one by one. So both agree up to rounding
even where only a few rules fire weakly and the gain depends on differences of small heights.
Unlike the rest of the filter (`export.c_header`) it is not traced: loops over tables of 25 rules
and 5 terms are shorter and easier to read than a thousand statements. The code is in `controller.c`
and `centroid_*.c`, which the whole filter uses too.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from posegsa.arguments import check_type
from posegsa.config import PARAMETERS, TERMS, Experiment, ObserverConfig
from posegsa.errors import ArgumentError
from posegsa.export.c_text import (
    NAME,
    check_name,
    comment,
    origin,
    renamed,
    settings_of,
    templates,
    worth,
    wrapped,
)
from posegsa.judging.known_sensors import KnownSensors
from posegsa.judging.result import Result
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.schedules import FuzzyGain

_NO_RULE = {"hold": "last_gain", "midrange": "posegsa_initial_gain()"}
_END_WEIGHT = {"sum": 1.0, "trapezoid": 0.5}

_FORMULAS = {
    "measured": """\
    attitude = 3 / (8 sum_i s_i) sum_i s_i |R_est v_i^B - v_i^I|^2   [no unit]
        over the vectors i measured in this sample, with weights s_i; without any, its last value;
        0 before the first
    position = sum_i w_i |T_est y_i - p_i| / sum_i w_i   [m]
        over the landmarks i measured in this sample, with weights w_i; without any, as above""",
    "pose": """\
    attitude = tr(I - R_err) / 4, R_err = R_est R^T   [0 to 1, no unit]
    position = |P_est - R_err P|   [m]""",
}
_SYMBOLS = {
    "measured": "R_est: estimated attitude, body to inertial frame; T_est y = R_est y + P_est [m]; "
    "v_i^B: vector as the filter uses it, body frame; v_i^I: the same vector, inertial frame; y_i: "
    "landmark as measured, body frame [m]; p_i: its position, inertial frame [m]. In this run:",
    "pose": "An oracle, for simulation only: R (body to inertial frame) and P [m] are the TRUE "
    "attitude and position, R_est and P_est the estimated ones. A vehicle does not have them.",
}


def export_c_gain(result: Result, name: str = NAME) -> str:
    """C99 file with the controller alone, `posegsa_gain`, for your own filter.

    It computes in `POSEGSA_REAL`, which is double unless the compiler defines it as float. The
    comment at its top explains how the inputs are computed, with units, and how good the schedule
    is.

    Args:
        result: The tuned schedule.
        name: Prefix of all names in the file.

    Raises:
        ArgumentError: Not a result, a result without a fuzzy gain, or a name that is invalid in C.
    """
    check_type("result", result, Result)
    check_name(name)
    experiment, controller = result.tuned, result.controller
    parameters = zip(PARAMETERS, result.parameters.tolist(), strict=True)
    text = (
        templates()
        .get_template("gain.c")
        .render(
            origin=comment(origin(result)),
            costs=comment(worth(result)),
            inference=comment(
                [FuzzyGain.formula, *settings_of(experiment.fuzzy, without=["rules"])]
            ),
            signal=comment(signal_in_words(result)),
            filter=comment(settings_of(experiment.filter)),
            parameters=comment(wrapped(", ".join(f"{which}={k!r}" for which, k in parameters))),
            linkage="",
            **controller_values(controller),
        )
    )
    return renamed(text, name)


def controller_values(controller: FuzzyController) -> dict[str, object]:
    """The values for the template `controller.c`."""
    low, high = map(float, controller.output_range)
    return {
        "centroid": f"centroid_{controller.centroid}.c",
        "points": controller.sampled_points,
        "end_weight": _END_WEIGHT[controller.sampled_rule],
        "low": repr(low),
        "high": repr(high),
        "inputs": len(controller.input_terms),
        "outputs": len(controller.output_terms),
        "input_terms": _terms(controller.input_terms),
        "output_terms": _terms(controller.output_terms),
        "rules": _rows([map(str, row) for row in controller.rules], "rate "),
        # Computed in double and rounded later, as in JAX.
        "initial_gain": repr(controller.middle_gain),
        "offset": repr(controller.offset),
        "no_rule": _NO_RULE[controller.no_rule],
    }


def _terms(terms: object) -> str:
    """Terms as rows of a C table; a float32 is written such that reading it as float is exact."""
    values = np.asarray(terms).tolist()
    return _rows([[f"POSEGSA_C({x!r})" for x in term] for term in values])


def _rows(rows: Sequence[Iterable[str]], of: str = "") -> str:
    """Rows of a C table; five rows are labelled with the names of their terms."""
    texts = ["{" + ", ".join(row) + "}," for row in rows]
    if len(texts) == len(TERMS):
        texts = [f"{text} /* {of}{name} */" for text, name in zip(texts, TERMS, strict=True)]
    return "\n".join(f"    {text}" for text in texts)


def signal_in_words(result: Result) -> list[str]:
    """How the inputs are computed from measurements, with the run's constants."""
    gain = result.tuned.gain
    smoothed = (
        f"e = before + dt / ({gain.smoothing!r} s + dt) (now - before)   [smoothed; dt: the time "
        "since the last sample]"
    )
    return [
        *_FORMULAS[gain.signal].splitlines(),
        f"    now = attitude + {gain.position_weight!r} x position",
        f"    {smoothed if gain.smoothing > 0 else 'e = now'}",
        f"    error = e / {gain.error_scale!r}",
        *_unknown(result),
        f"    rate = |e - before|{' / dt' if gain.rate == 'per_second' else ''} "
        f"x {gain.rate_scale!r}",
        "    before: e of the previous sample; at the first sample before = now, so that rate is 0",
        *wrapped(_SYMBOLS[gain.signal]),
        *((*_known(result), *_believed(result)) if gain.signal == "measured" else ()),
        *settings_of(gain),
    ]


def _believed(result: Result) -> list[str]:
    """What belief does to the weights, if the observer has it."""
    used = result.tuned.filter
    if not isinstance(used, ObserverConfig) or used.belief == "off":
        return []
    return wrapped(
        "These weights are divided by the factor of each sensor's belief (filter.belief_...), over "
        "the least factor of the vectors or of the landmarks. This file does not compute it."
    )


def _unknown(result: Result) -> list[str]:
    """How the unknown share of the biases raises the error, if it does."""
    gain, used = result.tuned.gain, result.tuned.filter
    if gain.unknown == "off":
        return []
    wait = used.bias_wait if isinstance(used, ObserverConfig) else "off"
    q = "1" if wait == "off" else f"1 / (1 + (now / {wait!r})^4), a factor on all bias laws"
    return [
        f"    unknown = max(unknown, {gain.unknown_rise!r} min(error, 1)), first {gain.unknown!r}",
        "    error = max(min(error, 1), unknown)",
        f"    after the sample unknown = unknown / (1 + {gain.unknown_fall!r} K q m dt)",
        "        K: after its limit; dt: the time to the next sample",
        "        m: 1/2 if a vector was measured, and 1/2 more if a landmark was",
        f"        q = {q}",
    ]


def _known(result: Result) -> list[str]:
    """The vectors and landmarks of the run, with their weights."""
    experiment = result.tuned
    used = experiment.filter
    assert isinstance(used, ObserverConfig)  # it has a controller
    try:
        sensors = result.known_sensors
    except ArgumentError:
        return ["  vectors and landmarks that differ between the training recordings"]
    vector_weights, cross_weight, landmark_weights = _weights(experiment, sensors)
    rows = [
        f"  v_{i}^I = {tuple(vector)}, weight {weight!r}"
        for i, (vector, weight) in enumerate(
            zip(sensors.vectors, vector_weights, strict=True), start=1
        )
    ]
    if used.cross_vector and len(sensors.vectors) > 1:
        rows.append(f"  v_{len(rows) + 1} = v_1 x v_2, weight {cross_weight!r}")
    if used.vector_bias == "estimated":
        rows += [
            "  its estimated bias c_i is subtracted from each measured vector first, body frame:",
            "      dc_i/dt = gamma_c (v_i^B as measured - c_i - R_est^T v_i^I) - leak c_i,",
            "      gamma_c, leak and bound: vector_bias_... below; R_est: before the step",
        ]
    if used.normalise_vectors:
        rows.append("  all v_i^B and v_i^I are normalised to length 1")
    rows += [
        f"  p_{i} = {tuple(landmark)} m, weight {weight!r}"
        for i, (landmark, weight) in enumerate(
            zip(sensors.landmarks, landmark_weights, strict=True), start=1
        )
    ]
    return rows


def _weights(
    experiment: Experiment, sensors: KnownSensors
) -> tuple[list[float], float, list[float]]:
    """Weights of the vectors, of the cross product and of the landmarks."""

    def of(given: Sequence[Any], factors: list[float]) -> list[float]:
        own = [one.weight for one in given[: len(factors)]]
        own += [1.0] * (len(factors) - len(own))
        return [weight * factor for weight, factor in zip(own, factors, strict=True)]

    both = min(sensors.vector_weights[:2], default=1.0)
    return (
        of(experiment.scenario.vectors, sensors.vector_weights),
        getattr(experiment.filter, "cross_vector_weight", 0.0) * both,
        of(experiment.scenario.landmarks, sensors.landmark_weights),
    )
