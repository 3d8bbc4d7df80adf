"""The figure of a comparison of optimisers: best cost against evaluations."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from posegsa.figures import style
from posegsa.figures.style import Style, finite
from posegsa.judging.comparison import OptimiserComparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EARLY = 0.05
"""Share of the budget during which curves may be above the figure's upper end."""
TITLE = 40
"""Characters in a line of a panel's title."""


@style.styled
def plot_comparison(*comparisons: OptimiserComparison) -> Figure:
    """Best cost so far against evaluations: median and quartiles over repeats of each optimiser.

    Several comparisons of the same optimisers get one panel each. An evaluation with gradient
    counts as several. If costs differ by more than LOG_RATIO the axis is logarithmic; otherwise the
    first steps may be above its upper end.
    """
    across = min(2, len(comparisons))
    down = -(-len(comparisons) // across)
    figure, axes = style.grid(down, across, 0.8 + (3.4 if across == 1 else 2.4) * down)
    for ax in axes.flat[len(comparisons) :]:
        ax.set_visible(False)
    for ax, comparison in zip(axes.flat, comparisons, strict=False):
        _draw(ax, comparison)
    style.legend_above(figure, axes[0, 0])
    return figure


def _draw(ax: Axes, comparison: OptimiserComparison) -> None:
    """Bands and medians of all optimisers."""
    bands = {name: comparison.bands(name) for name in comparison.repeats}
    lower = finite(np.concatenate([quartiles[0] for _, quartiles in bands.values()]))
    late = [quartiles[2, n >= EARLY * comparison.budget] for n, quartiles in bands.values()]
    low = np.nanmin(lower, initial=np.inf)
    high = np.nanmax(finite(np.concatenate(late)), initial=-np.inf)
    positive = np.nanmin(lower[lower > 0], initial=np.inf)
    logarithmic = low >= 0 and high > style.LOG_RATIO * positive
    for i, (name, (evaluations, quartiles)) in enumerate(bands.items()):
        # A logarithmic axis cannot show a cost of 0: the curve ends there.
        shown = np.where(quartiles > 0, quartiles, np.nan) if logarithmic else quartiles
        look: Style = {**style.curve(i), "linewidth": 1.4 if i else 2.2}
        style.plot_band(ax, evaluations, shown, name, look, steps=True)
    ax.set_xscale("log")
    style.plain_numbers(ax.xaxis, np.concatenate([n for n, _ in bands.values()]))
    if logarithmic:
        ax.set_yscale("log", nonpositive="mask")
    elif np.isfinite([low, high]).all() and high > low:
        margin = 0.05 * (high - low)
        ax.set_ylim(low - margin, high + margin)
    ax.set(xlabel="Evaluations [-]", ylabel="Best cost so far [-]")
    ax.set_title(textwrap.fill(comparison.subject, TITLE), size="small")
