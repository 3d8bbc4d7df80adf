"""The report of a filter on recordings."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.pages import PICTURE, Page, spaced
from helpers.results import description, history, result

import posegsa
from posegsa import config
from posegsa.figures.recorded_figures import plot_recorded_errors
from posegsa.judging.on_recordings import OnRecordings, RecordingScore
from posegsa.judging.result import FoundBy, Result
from posegsa.recordings.accuracy import Blocks, Rmse
from posegsa.report import report_html

pytestmark = pytest.mark.quick


def score(name: str, attitude: float, position: float) -> RecordingScore:
    """Of 20 s, with errors [deg], [m] that are the same throughout."""
    errors = {"judged": Rmse(attitude, 0.5 * attitude, 0.8 * attitude, position, 2000)}
    blocks = Blocks([attitude**2] * 4, [position**2] * 4)
    origin = {"velocity": "measured <wheels>"}, ["a gap"]
    return RecordingScore(name, 2000, 20.0, False, *origin, errors, "0" * 64, blocks)


def judged(**beside: RecordingScore) -> Result:
    held_out = [score("b.csv", 0.2, 0.03)] if beside else []
    return Result(
        experiment=config.load("kalman"),
        filter=description("kalman"),
        search=FoundBy(
            tuned_on="recordings",
            cost="configured",
            position_weight=100.0,
            best_cost=1.0,
            non_finite=0,
            compile_seconds=1.0,
            search_seconds=0.5,
            history=history(3),
        ),
        on_recordings=OnRecordings(
            training=[score("a.csv", 0.1, 0.02)],
            held_out=held_out,
            baselines={name: [each] for name, each in beside.items()},
        ),
        environment={"jax": "0.10"},
        version="1.2.3",
    )


def test_it_opens_with_the_verdict_in_degrees_and_centimetres():
    page = Page(report_html(judged(other=score("b.csv", 0.4, 0.05)), {}))
    text = page.text
    assert "Best on what was held out: this filter, 0.2 deg and 3 cm" in text
    assert text.index("Best on") < text.index("other, held out") < text.index("Configuration")
    assert "0.4 deg, 5 cm" in text
    assert "velocity: measured <wheels>" in text


def test_its_table_is_that_of_the_summary():
    found = judged(other=score("b.csv", 0.4, 0.05))
    page = Page(report_html(found, {}))
    assert found.on_recordings is not None
    heads, *rows = found.on_recordings.rows()
    shown = [[spaced(cell) for cell in row] for row in (heads, *rows)]
    assert page.table("Root mean") == shown


def test_it_says_that_nothing_was_held_out():
    text = Page(report_html(judged(), {})).text
    assert "No recording was held out" in text
    assert "0.1 deg, 2 cm" in text


def test_it_needs_nothing_else():
    page = Page(report_html(judged(), {"recorded_errors": PICTURE}))
    sources = [
        value
        for tag, attributes in page.elements
        for name, value in attributes.items()
        if name in ("src", "href", "srcset") or tag in ("script", "link")
    ]
    assert len(sources) == 1
    assert sources[0].startswith("data:image/png;base64,")


def test_a_result_on_scenarios_and_recordings_shows_both():
    both = replace(result(), on_recordings=judged().on_recordings)
    text = Page(report_html(both, {})).text
    assert "On recordings" in text
    assert "Held-out evaluation" in text


def test_a_saved_result_has_its_report_and_its_figures(tmp_path):
    folder = posegsa.save(judged(other=score("b.csv", 0.4, 0.05)), tmp_path / "run")
    assert (folder / "report.html").exists()
    found = {path.stem for path in (folder / "figures").iterdir()}
    assert found == {"recorded_errors", "convergence"}


def test_the_figure_has_the_errors_of_each_filter():
    recorded = judged(other=score("b.csv", 0.4, 0.05)).on_recordings
    assert recorded is not None
    figure = plot_recorded_errors(recorded)
    assert figure is not None
    for ax, values in zip(figure.axes, [(0.2, 0.4), (3.0, 5.0)], strict=True):
        for stairs, value in zip(ax.patches, values, strict=True):
            data = stairs.get_data()
            np.testing.assert_allclose(data.values, 4 * [value])
            np.testing.assert_allclose(data.edges, [0, 5, 10, 15, 20])
