"""The report of a result: a single HTML file without network access or scripts.

`page.html` is that of a result on drawn scenarios, `recordings.html` that of one on recordings
alone; `head.html`, `recorded.html` and `ends.html` are in both, `parts.html` has macros for what
repeats. Python passes them the result and everything that a template cannot compute.
"""

from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from posegsa import config
from posegsa.figures import (
    evaluation_figures,
    recorded_figures,
    schedule_figures,
    trajectory_figures,
)
from posegsa.figures import search as search_figures
from posegsa.judging import metrics
from posegsa.judging.evaluation import CONSISTENCY_WORDS, KALMAN_SEARCH_WORDS, SWITCH, called
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.result import Result
from posegsa.judging.trust import SENSITIVE
from posegsa.report.numbers import cost, interval, number, percent, plus_minus
from posegsa.report.report_tables import rules, simulations, terms
from posegsa.report.sentences import (
    cost_words,
    filter_words,
    next_words,
    recorded_errors,
    worse_words,
)
from posegsa.words import counted, toml

if TYPE_CHECKING:
    from jinja2 import Environment


NO_FAMILY = config.FamilyConfig(attitude_error="off", position_error="off", random_phase=False)
"""A family whose scenarios differ only in their noise."""


# Costs may be 0, infinite or very large: do not warn about the arithmetic.
@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def report_html(result: Result, pictures: Mapping[str, bytes]) -> str:
    """A result as one HTML page; pictures are the PNG files of its figures by name."""
    judged, recorded = result.on_scenarios, result.on_recordings
    shown: dict[str, Any] = {
        "result": result,
        "experiment": result.experiment,
        "pictures": {name: b64encode(png).decode("ascii") for name, png in pictures.items()},
        "schedule_figures": schedule_figures.FIGURES,
        "search_figures": search_figures.FIGURES,
        "fuzzy": result.filter.kind == "fuzzy",
        "also": [
            (one, result.also[one.key]) for one in result.experiment.also if one.key in result.also
        ],
        "configuration": config.to_toml(result.experiment),
        "environment": {"posegsa": result.version} | result.environment,
    }
    if recorded is not None:
        shown |= {
            "recorded_verdict": recorded.verdict() or recorded.alone(),
            "recorded_errors": recorded_errors(recorded),
            "recorded_figures": recorded_figures.FIGURES,
        }
    shown |= {} if judged is None else _of_scenarios(result, judged)
    page = "recordings.html" if judged is None else "page.html"
    return templates().get_template(page).render(**shown)


def _of_scenarios(result: Result, judged: OnScenarios) -> dict[str, Any]:
    """What the page of a result on drawn scenarios shows of them."""
    fuzzy, gains = result.filter.kind == "fuzzy", result.experiment.parameters.gain_range
    return {
        "judged": judged,
        "evaluation": judged.evaluation,
        "CONSISTENCY_WORDS": CONSISTENCY_WORDS,
        "KALMAN_SEARCH_WORDS": KALMAN_SEARCH_WORDS,
        "beside": judged.beside,
        "cost_words": cost_words(result),
        "worse_words": worse_words(judged),
        "next_words": next_words(result),
        "no_family": list(NO_FAMILY.described()),
        "angles_differ": evaluation_figures.angles_differ(judged.evaluation),
        "evaluation_figures": evaluation_figures.FIGURES,
        "trajectory_figures": trajectory_figures.FIGURES,
        "input_terms": terms(result, slice(11), config.INPUT_RANGE) if fuzzy else [],
        "output_terms": terms(result, slice(11, None), gains) if fuzzy else [],
        "error_columns": [f"Error {term}" for term in config.TERMS],
        "rules": [] if judged.trust.rule_weights is None else rules(result),
        "simulations": simulations(result),
    }


@cache
def templates() -> "Environment":
    """The templates of this folder; all text is escaped, and an undefined name is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # not at `import posegsa`

    environment = Environment(
        loader=PackageLoader("posegsa", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    as_text = (called, cost, counted, interval, number, percent, plus_minus, filter_words, toml)
    environment.filters |= {function.__name__: function for function in as_text}
    environment.filters["median"] = np.median
    environment.globals |= {
        "SWITCH": SWITCH,
        "SENSITIVE": SENSITIVE,
        "metrics": metrics,
        "write_cost": cost,
    }
    return environment
