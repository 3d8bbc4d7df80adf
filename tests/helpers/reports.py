"""A result with everything in it, and its report as a reader finds it."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from helpers.evaluations import ANGLES, TIME, description, endurance, evaluation, trust
from helpers.experiments import BASE
from helpers.pictures import history, trajectory
from posegsa import config
from posegsa.judging.evaluation import TUNED, Contender
from posegsa.judging.metrics import Bands, Metrics
from posegsa.judging.result import TuneResult
from posegsa.report import report_html
from posegsa.search.population import cost_name

# In order and without gaps, so that the repairs leave them as they are.
PARAMETERS = np.array(
    [
        *(0.1, 0.05, 0.1, 0.2, 0.15, 0.2, 0.3, 0.2, 0.4, 0.8, 0.6),
        *(10.0, 5.0, 15.0, 30.0, 20.0, 35.0, 50.0, 40.0, 60.0, 70.0, 65.0),
    ]
)
PICTURE = b"\x89PNG\r\n\x1a\n not more than that"
VOID = {"meta", "img", "br"}


def result(*settings: str, **values) -> TuneResult:
    return TuneResult(
        **{
            "experiment": config.override(config.Experiment(), [*BASE, *settings]),
            "cost": cost_name(None),
            "best_cost": 41.25,
            "parameters": PARAMETERS,
            "also": {},
            "training_costs": np.array([41.0, 41.5]),
            "constant_gain": 53.5,
            "constant_training_costs": np.array([44.0, 46.0]),
            "evaluation": evaluation(),
            "endurance": endurance(),
            "trust": trust(),
            "evaluations": 960,
            "non_finite": 0,
            "compile_seconds": 5.0,
            "search_seconds": 0.25,
            "history": history(),
            "trajectory": trajectory(),
            "environment": {"jax": "0.10", "device": "1 x cpu"},
            "version": "1.2.3",
            **values,
        }
    )


def consistent(samples: int = 61, **values) -> TuneResult:
    """A result whose parts fit together as those of a tuned one do: it can be saved and loaded.

    Args:
        samples: Of its trajectory and error bands, up to 61; with fewer there are 3 scenarios.
        values: Fields that are to be something else.
    """
    given = evaluation(initial_angle=ANGLES)
    scenarios = 40 if samples == len(TIME) else 3
    contenders = {
        name: Contender(
            Metrics(*(each[:scenarios] for each in one.metrics)),
            Bands(*(band[:, :samples] for band in one.bands)),
            one.filter,
        )
        for name, one in given.contenders.items()
    }
    contenders[TUNED] = contenders[TUNED]._replace(filter=description("fuzzy", k=PARAMETERS))
    return result(
        *("scenario.sampling_time=0.25", f"scenario.duration={0.25 * samples}"),
        *("cost.transient_window=[0, 1]", f"cost.steady_window=[2, {samples - 1}]"),
        "run.training_scenarios=2",
        **{
            "best_cost": float(history().best[-1]),
            "evaluation": replace(given, time=TIME[:samples], contenders=contenders),
            "trajectory": trajectory(samples, time=TIME[:samples]),
            **values,
        },
    )


class Page(HTMLParser):
    """What a reader finds in a page; refuses elements that are not closed in their order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict]] = []
        self.elements: list[tuple[str, dict]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append((tag, dict(attrs)))
        if tag == "table":
            self.rows: list[list[str]] = []
        elif tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        inside = [tag for tag, _ in self.open]
        if "style" in inside:
            return
        self.texts.append(data)
        if "caption" in inside:
            self.tables[data] = self.rows
        elif "td" in inside or "th" in inside:
            self.rows[-1][-1] += data

    @property
    def text(self) -> str:
        return spaced(" ".join(self.texts))

    def table(self, caption: str) -> list[list[str]]:
        (found,) = (rows for name, rows in self.tables.items() if name.startswith(caption))
        return [[spaced(cell) for cell in row] for row in found]


def spaced(text: str) -> str:
    """A text as a browser shows it: spaces and ends of lines in a row are one space."""
    return re.sub(r"[ \n]+", " ", text).strip(" ")


def page(given: TuneResult | None = None, pictures=None) -> Page:
    return Page(report_html(given or result(), pictures or {"costs": PICTURE}))


def values(cell: str) -> list[float]:
    """The numbers in a cell."""
    cell = cell.replace("\u2212", "-").replace("\u221e", "inf")
    return [float(found) for found in re.findall(r"[-+]?(?:inf|\d[\d.]*(?:e[-+]\d+)?)", cell)]
