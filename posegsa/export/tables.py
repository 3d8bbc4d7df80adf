"""The schedule and its control surface as JSON and CSV.

Numbers are written with enough digits that reading them at the run's precision gives them exactly.
"""

from typing import Any

import jax
import numpy as np

from posegsa.arguments import check_type, check_whole
from posegsa.config import PARAMETERS, TERMS
from posegsa.export.recorded import INFERENCE, recorded_json
from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.settings.plain import decimal, json_text, plain
from posegsa.version import VERSION

SCHEMA = 1
"""Version of the layout of the JSON; it changes when a key changes its meaning."""

RESOLUTION = 101
"""Points along each input of the control surface."""

_ABOUT = (
    f"Gain schedule of a pose filter on SE(3). {INFERENCE} Terms are [left foot, peak, right "
    "foot], shared by both inputs. Rows of rules and of the control surface are the rate, columns "
    "the error, both ascending. Inputs are clipped to [0, 1]. Where no rule fires, 'hold' keeps "
    "the last gain; the control surface shows initial_gain_1_s there."
)


def export_json(result: TuneResult | RecordingResult) -> str:
    """The schedule, its costs and its control surface as JSON.

    Reading a number at the run's dtype gives it exactly. A cost that is not finite is a string, as
    in result.json. A result on recordings may have any gain: its JSON has the gain's formula and
    no control surface; `export_csv` writes that.
    """
    check_type("result", result, TuneResult, RecordingResult)
    if isinstance(result, RecordingResult):
        return recorded_json(result)
    experiment = result.tuned
    with jax.enable_x64(experiment.run.dtype == "float64"):
        controller = result.controller
        initial_gain = float(controller.initial_gain())
    error, rate, gains = _surface(result, RESOLUTION)
    data = {
        "schema": SCHEMA,
        "about": _ABOUT,
        "version": VERSION,
        "tuned_with": result.version,
        "dtype": experiment.run.dtype,
        "controller": {
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
            "initial_gain_1_s": initial_gain,
        },
        "gain": experiment.gain,
        "filter": experiment.filter,
        "tuned_too": result.also,
        "parameters": dict(zip(PARAMETERS, result.parameters, strict=True)),
        "costs": {**costs(result), "constant_gain_1_s": result.constant_gain},
        "sensitive": result.trust.sensitive,
        "warnings": result.warnings(),
        "control_surface": {"error": error, "rate": rate, "gain_1_s": gains},
    }
    return json_text(plain(data)) + "\n"


def export_csv(result: TuneResult | RecordingResult, resolution: int = RESOLUTION) -> str:
    """The control surface as CSV, one row for each point: error, rate (both 0 to 1), gain.

    Each input has `resolution` points. Where no rule fires and the filter would hold the last gain,
    the table has the initial gain.

    Raises:
        ArgumentError: Not a result, a result without a fuzzy gain, or a resolution that is not a
            whole number from 2 to 10000.
    """
    check_type("result", result, TuneResult, RecordingResult)
    check_whole("resolution", resolution, 2, 10_000)
    errors, rates, gains = (decimal(a).tolist() for a in _surface(result, resolution))
    lines = ["error,rate,gain_1_s"]
    for rate, row in zip(rates, gains, strict=True):
        lines += [f"{error!r},{rate!r},{gain!r}" for error, gain in zip(errors, row, strict=True)]
    return "\n".join(lines) + "\n"


def _surface(
    result: TuneResult | RecordingResult, resolution: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors, rates and gains (rate, error) at the run's precision."""
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        error, rate, gains = result.controller.surface(resolution)
        return np.asarray(error), np.asarray(rate), np.asarray(gains)


def costs(result: TuneResult) -> dict[str, dict[str, Any]]:
    """Costs of the schedule and of the best constant gain, with 95 % intervals of the means."""
    training = {TUNED: result.training_costs, CONSTANT: result.constant_training_costs}
    found = {}
    for key, name in (("tuned", TUNED), ("constant", CONSTANT)):
        mean, *ends = result.evaluation.cost(name)
        held_out = result.evaluation.contenders[name].metrics.cost
        found[key] = {
            "training_scenarios": len(training[name]),
            "training_mean": float(np.mean(training[name])),
            "held_out_scenarios": len(held_out),
            "held_out_mean": mean,
            "held_out_interval": ends,
            "held_out_worst": float(np.max(held_out)),
        }
    return found
