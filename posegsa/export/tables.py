"""The schedule and its control surface as JSON and CSV.

Numbers are written with enough digits that reading them at the run's precision gives them exactly.
"""

from typing import Any

import jax
import numpy as np

from posegsa.arguments import check_type, check_whole
from posegsa.config import PARAMETERS, TERMS
from posegsa.judging.result import Result
from posegsa.model.schedules import SCHEDULES
from posegsa.settings.plain import decimal, json_text, plain
from posegsa.version import VERSION

SCHEMA = 2
"""Version of the layout of the JSON; it changes when a key changes its meaning."""

RESOLUTION = 101
"""Points along each input of the control surface."""

_OF_A_CONTROLLER = (
    "Terms are [left foot, peak, right foot], shared by both inputs. Rows of rules and of the "
    "control surface are the rate, columns the error, both ascending. Inputs are clipped to "
    "[0, 1]. Where no rule fires, 'hold' keeps the last gain; the control surface shows "
    "initial_gain_1_s there."
)


def export_json(result: Result) -> str:
    """The filter with its numbers, what it is worth, and its control surface if it has one.

    Reading a number at the run's dtype gives it exactly. A number that is not finite is a string,
    as in result.json.
    """
    check_type("result", result, Result)
    tuned, found = result.tuned, result.filter
    observer = found.kind in SCHEDULES
    what = f"A {found.title}; its numbers are in filter."
    about = f"Pose filter on SE(3). {SCHEDULES[found.kind].formula if observer else what}"
    numbers = {name: each for name, each in found.numbers.items() if name != "rules"}
    if "k" in numbers:
        numbers = dict(zip(PARAMETERS, ([k] for k in numbers["k"]), strict=True))
    on = result.on_recordings
    data = {
        "schema": SCHEMA,
        "about": f"{about} {_OF_A_CONTROLLER}" if found.kind == "fuzzy" else about,
        "version": VERSION,
        "tuned_with": result.version,
        "dtype": tuned.run.dtype,
        "kind": found.kind,
        "numbers": numbers,
        "tuned_too": result.also,
        "controller": _controller(result) if found.kind == "fuzzy" else None,
        "gain": tuned.gain if observer else None,
        "filter": tuned.filter,
        "vector_weights": [one.weight for one in tuned.scenario.vectors],
        "landmark_weights": [one.weight for one in tuned.scenario.landmarks],
        "sensors": None if on is None or on.sensors is None else on.sensors._asdict(),
        "costs": costs(result),
        "training_recordings": [] if on is None else on.training,
        "held_out_recordings": [] if on is None else on.held_out,
        "warnings": result.warnings(),
    }
    if found.kind == "fuzzy":
        error, rate, gains = _surface(result, RESOLUTION)
        data["control_surface"] = {"error": error, "rate": rate, "gain_1_s": gains}
    return json_text(plain(data)) + "\n"


def _controller(result: Result) -> dict[str, Any]:
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        controller = result.controller
        return {
            "input_terms": dict(zip(TERMS, np.asarray(controller.input_terms), strict=True)),
            "output_terms_1_s": dict(zip(TERMS, np.asarray(controller.output_terms), strict=True)),
            "rules": [[TERMS[output] for output in row] for row in controller.rules],
            "rule_indices": controller.rules,
            "output_range_1_s": controller.output_range,
            "centroid": controller.centroid,
            "sampled_points": controller.sampled_points,
            "sampled_rule": controller.sampled_rule,
            "no_rule": controller.no_rule,
            "offset_1_s": controller.offset,
            "initial_gain_1_s": float(controller.initial_gain()),
        }


def export_csv(result: Result, resolution: int = RESOLUTION) -> str:
    """The control surface as CSV, one row for each point: error, rate (both 0 to 1), gain.

    Each input has `resolution` points. Where no rule fires and the filter would hold the last gain,
    the table has the initial gain.

    Raises:
        ArgumentError: Not a result, a result without a fuzzy gain, or a resolution that is not a
            whole number from 2 to 10000.
    """
    check_type("result", result, Result)
    check_whole("resolution", resolution, 2, 10_000)
    errors, rates, gains = (decimal(a).tolist() for a in _surface(result, resolution))
    lines = ["error,rate,gain_1_s"]
    for rate, row in zip(rates, gains, strict=True):
        lines += [f"{error!r},{rate!r},{gain!r}" for error, gain in zip(errors, row, strict=True)]
    return "\n".join(lines) + "\n"


def _surface(result: Result, resolution: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors, rates and gains (rate, error) at the run's precision."""
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        error, rate, gains = result.controller.surface(resolution)
        return np.asarray(error), np.asarray(rate), np.asarray(gains)


def costs(result: Result) -> dict[str, dict[str, Any]]:
    """Costs of the tuned filter and of the one compared with it, with 95 % intervals of the means.

    By name; empty where the filter was not run on scenarios.
    """
    if (judged := result.on_scenarios) is None:
        return {}
    found = {}
    for name, training in judged.training.items():
        mean, *ends = judged.evaluation.cost(name)
        contender = judged.evaluation.contenders[name]
        found[name] = {
            "numbers": contender.filter.numbers if name != judged.evaluation.own else {},
            "training_scenarios": len(training),
            "training_mean": float(np.mean(training)),
            "held_out_scenarios": len(contender.metrics.cost),
            "held_out_mean": mean,
            "held_out_interval": ends,
            "held_out_worst": float(np.max(contender.metrics.cost)),
        }
    return found
