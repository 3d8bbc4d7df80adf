"""The schedule as one C99 file that includes nothing, allocates nothing and remembers nothing.

The code mirrors `posegsa.model.fuzzy` operation by operation, so that both agree to rounding even
where few rules fire, and weakly: there a gain depends on differences of small heights. It stands in
`gain.c` and `centroid_*.c`; each `$name` in them is filled in here.
"""

import textwrap
from collections.abc import Collection, Iterable, Sequence
from functools import partial
from importlib.resources import files
from string import Template

import numpy as np

from posegsa.arguments import check_type
from posegsa.config import PARAMETERS, TERMS, Experiment
from posegsa.export.tables import INFERENCE, costs
from posegsa.judging.result import VERSION, TuneResult
from posegsa.settings.fields import Section
from posegsa.words import counted, text_table, toml

_wrapped = partial(textwrap.wrap, width=96, break_long_words=False, break_on_hyphens=False)
"""Lines of the comment's text."""
_NO_RULE = {"hold": "last_gain", "midrange": "posegsa_initial_gain()"}
_END_WEIGHT = {"sum": 1.0, "trapezoid": 0.5}

_FORMULAS = {
    "measured": """\
    attitude = 3 / (8 sum_i s_i) sum_i s_i |R_est v_i^B - v_i^I|^2   [no unit]
        over the vectors i measured in this sample, s_i their weights; without any its last value,
        0 at first
    position = sum_i w_i |T_est y_i - p_i| / sum_i w_i   [m]
        over the landmarks i measured in this sample, w_i their weights; likewise""",
    "pose": """\
    attitude = tr(I - R_err) / 4, R_err = R_est R^T   [0 to 1, no unit]
    position = |P_est - R_err P|   [m]""",
}
_SYMBOLS = {
    "measured": "R_est: estimated attitude, body to inertial frame; T_est y = R_est y + P_est [m]; "
    "v_i^B: vector as the filter uses it, body frame; v_i^I: the same vector, inertial frame; y_i: "
    "landmark as measured, body frame [m]; p_i: its place, inertial frame [m]. In the run's "
    "scenario:",
    "pose": "An oracle, for simulation only: R (body to inertial frame) and P [m] are the TRUE "
    "attitude and position, R_est and P_est the estimated ones. A vehicle does not have them.",
}


def export_c(result: TuneResult) -> str:
    """A C99 file with `posegsa_gain` and `posegsa_initial_gain`.

    It computes in `POSEGSA_REAL`, which is double unless it is defined as float when compiling.
    Its head comment says how the inputs are formed, in which units, and what the schedule is worth.
    """
    check_type("result", result, TuneResult)
    experiment, controller = result.tuned, result.controller
    run, search = experiment.run, experiment.search
    low, high = map(float, controller.output_range)
    origin = (
        f"Written by posegsa {VERSION}. Tuned with posegsa {result.version} in {run.dtype}: "
        f"{search.optimiser}, {search.size_in_words()}, seed {run.seed}."
    )
    parameters = zip(PARAMETERS, result.parameters.tolist(), strict=True)
    here = files("posegsa.export")
    centroid = Template((here / f"centroid_{controller.centroid}.c").read_text("utf-8"))
    return Template((here / "gain.c").read_text("utf-8")).substitute(
        origin=_comment(_wrapped(origin)),
        costs=_comment(_costs(result)),
        inference=_comment([INFERENCE, *_settings(experiment.fuzzy, without=["rules"])]),
        signal=_comment(_signal(experiment)),
        filter=_comment(_settings(experiment.filter)),
        parameters=_comment(_wrapped(", ".join(f"{name}={k!r}" for name, k in parameters))),
        centroid=centroid.substitute(
            points=controller.sampled_points,
            end_weight=_END_WEIGHT[controller.sampled_rule],
            low=repr(low),
            high=repr(high),
        ),
        inputs=len(controller.input_terms),
        outputs=len(controller.output_terms),
        input_terms=_terms(controller.input_terms),
        output_terms=_terms(controller.output_terms),
        rules=_rows([map(str, row) for row in controller.rules], [f"rate {t}" for t in TERMS]),
        # As JAX has it: formed in double, then rounded.
        initial_gain=repr(controller.offset + 0.5 * (low + high)),
        offset=repr(controller.offset),
        no_rule=_NO_RULE[controller.no_rule],
    )


def _terms(terms: object) -> str:
    """Terms as rows of a C table; a float32 is written so that reading it as float is exact."""
    values = np.asarray(terms).tolist()
    return _rows([[f"POSEGSA_C({x!r})" for x in term] for term in values], TERMS)


def _rows(rows: Iterable[Iterable[str]], names: Sequence[str]) -> str:
    named = zip(map(", ".join, rows), names, strict=True)
    return "\n".join(f"    {{{row}}}, /* {name} */" for row, name in named)


def _comment(lines: Iterable[str]) -> str:
    """Lines of a block comment; none of them can end it early, or begin another."""
    safe = (line.replace("*/", "* /").replace("/*", "/ *") for line in lines)
    return "\n".join(f" * {line}".rstrip() for line in safe)


def _costs(result: TuneResult) -> list[str]:
    names = {
        "tuned": "  this schedule",
        "constant": f"  best constant gain {result.constant_gain:.4g}/s",
    }
    found, rows = costs(result), [["Cost", "training", "held out", "95 % interval", "worst"]]
    for key, name in names.items():
        numbers = (found[key][of] for of in ("training_mean", "held_out_mean", "held_out_worst"))
        training, held_out, worst = (f"{number:.5g}" for number in numbers)
        interval = "[{:.5g}, {:.5g}]".format(*found[key]["held_out_interval"])
        rows.append([name, training, held_out, interval, worst])
    lines = text_table(rows).splitlines()
    lines += _wrapped(
        f"Means over {counted(len(result.training_costs), 'training scenario')} and over "
        f"{result.evaluation.scenarios} held-out ones, which the search has not seen; worst of the "
        "held-out ones."
    )
    for warning in result.warnings():
        lines += _wrapped(f"WARNING: {warning}.")
    return lines


def _signal(experiment: Experiment) -> list[str]:
    """How the inputs come from measurements, with the run's constants."""
    gain = experiment.gain
    smoothed = (
        f"e = before + dt / ({gain.smoothing!r} s + dt) (now - before)   [smoothed; dt: the time "
        "since the last sample]"
    )
    return [
        *_FORMULAS[gain.signal].splitlines(),
        f"    now = attitude + {gain.position_weight!r} x position",
        f"    {smoothed if gain.smoothing > 0 else 'e = now'}",
        f"    error = e / {gain.error_scale!r}",
        f"    rate = |e - before|{' / dt' if gain.rate == 'per_second' else ''} "
        f"x {gain.rate_scale!r}",
        "    before is e of the sample before, and now at the first sample: there rate is 0",
        *_wrapped(_SYMBOLS[gain.signal]),
        *(_known(experiment) if gain.signal == "measured" else []),
        *_settings(gain),
    ]


def _known(experiment: Experiment) -> list[str]:
    """The vectors and landmarks of the run, with their weights."""
    scenario, used = experiment.scenario, experiment.filter
    rows = [
        f"  v_{i}^I = {vector.direction}, weight {vector.weight!r}"
        for i, vector in enumerate(scenario.vectors, start=1)
    ]
    if used.cross_vector:
        rows.append(f"  v_{len(rows) + 1} = v_1 x v_2, weight {used.cross_vector_weight!r}")
    if used.vector_bias == "estimated":
        rows += [
            "  c_i, its estimated bias, is taken off each measured vector first, body frame:",
            "      dc_i/dt = gamma_c (v_i^B as measured - c_i - R_est^T v_i^I) - leak c_i,",
            "      gamma_c, leak and bound as vector_bias_... below, R_est before the step",
        ]
    if used.normalise_vectors:
        rows.append("  all of them at length one, v_i^B and v_i^I")
    rows += [
        f"  p_{i} = {landmark.position} m, weight {landmark.weight!r}"
        for i, landmark in enumerate(scenario.landmarks, start=1)
    ]
    return rows


def _settings(section: Section, without: Collection[str] = ()) -> list[str]:
    return [
        line
        for name, value, description in section.described()
        if name not in without
        for line in _wrapped(
            f"{name} = {toml(value)}. {description}",
            initial_indent="  ",
            subsequent_indent="      ",
        )
    ]
