"""All figures of a result."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import jax

from posegsa.arguments import check_type
from posegsa.figures import evaluation_figures, schedule_figures, search, trajectory_figures
from posegsa.figures.figure_choice import chosen_figures
from posegsa.judging.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = (
    *evaluation_figures.FIGURES,
    *schedule_figures.FIGURES,
    *trajectory_figures.FIGURES,
    *search.FIGURES,
)
NAMES = tuple(each.name for each in FIGURES)


def draw(result: Result, figures: Iterable[str] | None = None) -> dict[str, Figure]:
    """The figures of a result by name, without those that have nothing to show.

    Args:
        result: From `tune` or `evaluate`.
        figures: Names of the figures to draw; by default all.

    Raises:
        ArgumentError: The result has the wrong type, or there is no figure with such a name.
    """
    check_type("result", result, Result)
    names = chosen_figures(figures, NAMES)
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        drawn = {each.name: each.draw(result) for each in FIGURES if each.name in names}
    return {name: figure for name, figure in drawn.items() if figure is not None}
