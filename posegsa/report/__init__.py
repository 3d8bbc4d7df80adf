"""One page that shows a result: a single HTML file that needs no network and runs no script."""

from collections.abc import Mapping
from importlib.resources import files
from string import Template

import numpy as np

from posegsa.figures import search, trajectory
from posegsa.judging.evaluation import TUNED
from posegsa.judging.result import TuneResult
from posegsa.report import headline, sections
from posegsa.report.markup import cost, element, join, paragraph, section, table
from posegsa.report.words import what_was_run


@np.errstate(over="ignore", invalid="ignore")  # a filter may diverge to any number
def report_html(result: TuneResult, pictures: Mapping[str, bytes]) -> str:
    """A result as one HTML page, with its figures, PNG files by name."""
    here, run = files(__name__), result.experiment.run
    page = Template((here / "page.html").read_text(encoding="utf-8"))
    held_out = cost(result.evaluation.cost(TUNED).mean)
    made = {"posegsa": result.version} | result.environment
    shown = (
        headline.warnings(result),
        headline.headline(result),
        section(
            "What was run",
            table("The run in words", ("Part", "Description"), what_was_run(result), class_="text"),
        ),
        sections.contenders(result, pictures),
        sections.schedule(result, pictures),
        sections.trust(result),
        section("One held-out scenario", sections.figures(trajectory.FIGURES, pictures)),
        section("The search", sections.figures(search.FIGURES, pictures)),
        sections.configuration(result),
        section(
            "Environment",
            table("Where the run was made", ("Part", "Version"), made.items(), class_="text"),
        ),
    )
    return page.substitute(
        title=element("title", f"Tuned gain schedule: held-out cost {held_out}"),
        style=(here / "style.css").read_text(encoding="utf-8"),
        about=paragraph(f"posegsa {result.version}, seed {run.seed}, {run.dtype}", class_="about"),
        sections=join(shown, "\n"),
    )
