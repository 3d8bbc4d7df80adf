"""All figures of a result."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax

from posegsa.arguments import check_type
from posegsa.figures import evaluation, schedule, search, trajectory
from posegsa.judging.result import TuneResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = (*evaluation.FIGURES, *schedule.FIGURES, *trajectory.FIGURES, *search.FIGURES)


def draw(result: TuneResult) -> dict[str, Figure]:
    """The figures of a result by name; those that have nothing to show are left out."""
    check_type("result", result, TuneResult)
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        drawn = {each.name: each.draw(result) for each in FIGURES}
    return {name: figure for name, figure in drawn.items() if figure is not None}
