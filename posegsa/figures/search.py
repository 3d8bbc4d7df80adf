"""The figure of a search: its costs by iteration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jax import Array

from posegsa.figures import style
from posegsa.figures.captioned import ResultFigure, captioned
from posegsa.figures.style import Style, finite
from posegsa.optimisers import History

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES: list[ResultFigure] = []
HIGHEST = 100.0
"""Multiple of the largest mean cost up to which the worst ones are shown."""


@captioned(
    FIGURES,
    name="convergence",
    title="Convergence",
    caption="If the best cost still falls at the end, more iterations may help. These are "
    "training costs; the held-out cost measures the result. A worst cost of more than 100 times "
    "the largest mean is above the figure.",
)
def plot_convergence(history: History, unit: str = "-") -> Figure:
    """Best cost so far, mean and worst training cost of each iteration of the search.

    `unit` is that of the cost: [deg] on recordings, [-] on scenarios.
    The curves leave out costs that are not finite; a second panel counts them, if there are any.
    """
    failures = np.asarray(history.non_finite)
    iteration = np.arange(1, len(failures) + 1)
    marker = "o" if len(iteration) < 30 else None
    ratios = (3, 1) if failures.any() else (1,)
    figure, (ax, *below) = style.panels(len(ratios), 3.6, height_ratios=ratios)
    curves: tuple[tuple[str, Array, Style], ...] = (
        ("best so far", history.best, {"color": style.BLUE, "linewidth": 2.2}),
        ("mean", history.mean, {"color": style.GREEN, "linestyle": "--"}),
        ("worst", history.worst, {"color": style.PURPLE, "linestyle": (0, (1, 1))}),
    )
    for name, values, look in curves:
        ax.plot(iteration, finite(values), label=name, marker=marker, markersize=3, **look)
    costs = np.concatenate([values for _, values, _ in curves])
    style.scale_costs(ax, "y", costs[np.isfinite(costs)])
    mean, worst = finite(history.mean), finite(history.worst)
    if np.isfinite(mean).any():  # otherwise a few worst costs would flatten the rest
        highest = HIGHEST * np.nanmax(mean)
        if np.nanmax(worst, initial=0.0) > highest:
            ax.set_ylim(top=highest)
    ax.set_ylabel(f"Cost [{unit}]")
    for panel in below:
        panel.bar(iteration, failures, width=1.0, color="0.35")
        panel.set_ylabel("Not\nfinite [-]")
        panel.yaxis.set_major_locator(style.ticks(3, integer=True))
    last = (ax, *below)[-1]
    last.set_xlabel("Iteration [-]")
    last.xaxis.set_major_locator(style.ticks(8, steps=[1, 2, 5, 10], integer=True))
    ax.set_xlim(0.5, len(iteration) + 0.5)
    style.legend_above(figure, ax)
    return figure
