"""The figure of a comparison of optimisers: how fast each gets how far."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from posegsa.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    LOG_RATIO,
    PURPLE,
    SKY,
    VERMILION,
    WIDTH,
    Style,
    finite,
    panels,
    style_ticks,
    styled,
)
from posegsa.judging.comparison import OptimiserComparison

_STYLES: tuple[Style, ...] = (
    {"color": BLUE, "linestyle": "-", "linewidth": 2.2},
    {"color": BLACK, "linestyle": (0, (1, 1))},
    {"color": VERMILION, "linestyle": (0, (4, 1.5))},
    {"color": GREEN, "linestyle": "-."},
    {"color": PURPLE, "linestyle": (0, (7, 1.5))},
    {"color": SKY, "linestyle": "-"},
    {"color": "0.45", "linestyle": (0, (3, 1, 1, 1, 1, 1))},
    {"color": "#E69F00", "linestyle": "-", "linewidth": 1.0},
    {"color": "#661100", "linestyle": (0, (2, 2))},
    {"color": BLUE, "linestyle": (0, (1, 2))},
)
EARLY = 0.05
"""Share of the budget before which curves may leave the figure at the top."""

TITLE = 40
"""Characters in a line of a panel's title."""
LINE, HANDLE = 72, 7
"""Characters in a line of the legend, and those that a curve's sample takes."""


@styled
def plot_comparison(comparison: OptimiserComparison) -> Figure:
    """Best cost so far against evaluations: median and quartiles over repeats of each optimiser.

    A cost with its gradient counts as its price. Costs that differ by more than LOG_RATIO are drawn
    over a logarithmic axis; otherwise the first steps may leave the figure at the top.
    """
    figure, (ax,) = panels(1, 4.2)
    _draw(ax, comparison, "medium")
    _legend(figure, ax)
    return figure


@styled
def plot_comparisons(comparisons: Sequence[OptimiserComparison], across: int = 2) -> Figure:
    """The same for several comparisons of the same optimisers, a panel each."""
    down = -(-len(comparisons) // across)
    figure = Figure(figsize=(WIDTH, 0.8 + 2.4 * down), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for ax, comparison in zip(axes, comparisons, strict=False):
        style_ticks(ax)
        _draw(ax, comparison, "small")
    for ax in axes[len(comparisons) :]:
        ax.set_visible(False)
    _legend(figure, axes[0])
    return figure


def _draw(ax: Axes, comparison: OptimiserComparison, size: str) -> None:
    """Bands and medians of all optimisers."""
    bands, low, high, positive = {}, np.inf, -np.inf, np.inf
    for name in comparison.repeats:
        evaluations, quartiles = comparison.bands(name)
        lower, middle, upper = (finite(quartile) for quartile in quartiles)
        bands[name] = evaluations, lower, middle, upper
        late = evaluations >= EARLY * comparison.budget
        low = min(low, np.nanmin(lower, initial=np.inf))
        high = max(high, np.nanmax(upper[late], initial=-np.inf))
        positive = min(positive, np.nanmin(lower[lower > 0], initial=np.inf))
    logarithmic = low >= 0 and high > LOG_RATIO * positive
    for i, (name, (evaluations, lower, middle, upper)) in enumerate(bands.items()):
        style = _STYLES[i % len(_STYLES)]
        there = lower > 0 if logarithmic else np.isfinite(lower)  # a curve that gets to 0 ends
        band: Style = {"color": style["color"], "alpha": 0.15, "linewidth": 0, "step": "post"}
        ax.fill_between(evaluations, lower, upper, where=there.tolist(), **band)
        ax.step(evaluations, middle, where="post", label=name, **style)
    ax.set_xscale("log")
    if logarithmic:
        ax.set_yscale("log", nonpositive="mask")
    elif np.isfinite([low, high]).all() and high > low:
        margin = 0.05 * (high - low)
        ax.set_ylim(low - margin, high + margin)
    ax.set(xlabel="Evaluations [-]", ylabel="Best cost so far [-]")
    ax.set_title(textwrap.fill(comparison.subject, TITLE), size=size)


def _legend(figure: Figure, ax: Axes) -> None:
    """The names above all panels, in as few lines as they fit into."""
    handles, labels = ax.get_legend_handles_labels()
    across = max(1, LINE // (max(map(len, labels)) + HANDLE))
    figure.legend(handles, labels, loc="outside upper center", ncols=min(across, len(labels)))
