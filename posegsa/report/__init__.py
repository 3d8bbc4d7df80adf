"""One page that shows a result: a single HTML file that needs no network and runs no script."""

from collections.abc import Mapping
from importlib.resources import files
from string import Template

from posegsa.judging.evaluation import TUNED
from posegsa.judging.result import TuneResult
from posegsa.report import headline, sections
from posegsa.report.markup import cost, element, join


def report_html(result: TuneResult, pictures: Mapping[str, bytes]) -> str:
    """A result as one HTML page.

    Args:
        result: The result.
        pictures: Its figures as PNG files, by name.
    """
    here = files(__name__)
    page = Template((here / "page.html").read_text(encoding="utf-8"))
    held_out = cost(result.evaluation.cost(TUNED).mean)
    return page.substitute(
        title=element("title", f"Tuned gain schedule: held-out cost {held_out}"),
        style=(here / "style.css").read_text(encoding="utf-8"),
        about=sections.about(result),
        sections=join(
            [
                headline.warnings(result),
                headline.headline(result),
                sections.what_was_run(result),
                sections.contenders(result, pictures),
                sections.schedule(result, pictures),
                sections.trust(result),
                sections.one_run(pictures),
                sections.search(pictures),
                sections.configuration(result),
                sections.environment(result),
            ],
            "\n",
        ),
    )
