"""A filter tuned on recordings, or made by hand, as JSON."""

from typing import Any

import jax
import numpy as np

from posegsa.config import PARAMETERS, TERMS
from posegsa.judging.recorded import RecordingResult
from posegsa.model.schedules import FuzzyGain
from posegsa.settings.plain import json_text, plain
from posegsa.version import VERSION

SCHEMA = 1
"""Version of the layout; it changes when a key changes its meaning."""
INFERENCE = (
    "K = offset + centroid [1/s] by Mamdani inference: min for AND and implication, max for "
    "aggregation."
)
FORMULAS = {
    "fuzzy": INFERENCE,
    "constant": "K = gain [1/s]",
    "smooth": "K = low + (high - low) e^2 / (e^2 + half^2) [1/s], e: the scaled error in [0, 1]",
    "switch": "K = before [1/s] until time [s], then K = after [1/s]",
    "open loop": "K = exp of log_gain [log 1/s] interpolated linearly over time [s]",
}
"""The formula of each kind of schedule, with the names of its numbers."""


def recorded_json(result: RecordingResult) -> str:
    """The schedule, its filter, and its errors on recordings, as JSON."""
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        schedule = result.schedule
        controller: dict[str, Any] | None = None
        if isinstance(schedule, FuzzyGain):
            terms = schedule.controller
            controller = {
                "input_terms": dict(zip(TERMS, np.asarray(terms.input_terms), strict=True)),
                "output_terms_1_s": dict(zip(TERMS, np.asarray(terms.output_terms), strict=True)),
                "rules": [[TERMS[output] for output in row] for row in terms.rules],
                "output_range_1_s": terms.output_range,
                "offset_1_s": terms.offset,
                "centroid": terms.centroid,
                "no_rule": terms.no_rule,
                "initial_gain_1_s": float(terms.initial_gain()),
            }
    numbers = dict(result.filter.numbers)
    if "k" in numbers:
        numbers = dict(zip(PARAMETERS, ([k] for k in numbers["k"]), strict=True))
    tuned = result.tuned
    data = {
        "schema": SCHEMA,
        "about": f"Gain schedule of a pose filter on SE(3). {FORMULAS[result.filter.kind]}",
        "version": VERSION,
        "tuned_with": result.version,
        "dtype": tuned.run.dtype,
        "kind": result.filter.kind,
        "numbers": numbers,
        "controller": controller,
        "gain": tuned.gain,
        "filter": tuned.filter,
        "vector_weights": [one.weight for one in tuned.scenario.vectors],
        "landmark_weights": [one.weight for one in tuned.scenario.landmarks],
        "tuned_too": result.filter.also,
        "sensors": None if result.sensors is None else result.sensors._asdict(),
        "training": result.training,
        "held_out": result.held_out,
        "warnings": result.warnings(),
    }
    return json_text(plain(data)) + "\n"
