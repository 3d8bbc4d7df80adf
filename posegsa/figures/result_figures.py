"""All figures of a result."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from typing import TYPE_CHECKING

import jax

from posegsa.arguments import check_type
from posegsa.figures import (
    evaluation_figures,
    recorded_figures,
    schedule_figures,
    search,
    style,
    trajectory_figures,
)
from posegsa.figures.figure_choice import chosen_figures
from posegsa.judging.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = (
    *evaluation_figures.FIGURES,
    *recorded_figures.FIGURES,
    *schedule_figures.FIGURES,
    *trajectory_figures.FIGURES,
    *search.FIGURES,
)
NAMES = tuple(each.name for each in FIGURES)


class Figures(dict[str, "Figure"]):
    """Figures by name. A notebook shows them."""

    def _repr_html_(self) -> str:
        pictures = (b64encode(style.png(figure)).decode("ascii") for figure in self.values())
        return "".join(
            f'<img style="max-width: 100%" alt="{name}" src="data:image/png;base64,{png}">'
            for name, png in zip(self, pictures, strict=True)
        )


def draw(result: Result, figures: Iterable[str] | None = None) -> Figures:
    """The figures of a result by name, without those that have nothing to show.

    Args:
        result: From `tune`, `evaluate` or `configured`.
        figures: Names of the figures to draw; by default all.

    Raises:
        ArgumentError: The result has the wrong type, or there is no figure with such a name.
    """
    check_type("result", result, Result)
    names = chosen_figures(figures, NAMES)
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        drawn = {each.name: each.draw(result) for each in FIGURES if each.name in names}
    return Figures({name: figure for name, figure in drawn.items() if figure is not None})
