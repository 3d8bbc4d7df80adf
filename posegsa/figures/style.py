"""The look that all figures share, for print and screen.

Figures are made without pyplot and without a trace in the process, and their look does not depend
on the user's settings. Curves differ in colour (after Okabe and Ito's palette) and in line style or
weight, to be told apart in grey print and by colour-blind readers. Quantities without a unit are
marked [-].
"""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib.style
import numpy as np
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from posegsa.config import TERMS

DPI = 200
"""Resolution for print [dots per inch]."""
START = 1.0
"""Length of the start of a run that figures show enlarged [s]."""
WIDTH = 6.5
"""Width of a figure [in]: one column of a page, or both of a two-column one."""
LOG_RATIO = 30.0
"""Costs that differ by more than this factor are drawn over a logarithmic axis."""

BLACK, BLUE, GREEN, VERMILION, PURPLE, SKY = (
    *("#000000", "#0072B2", "#009E73", "#D55E00"),
    *("#AA4499", "#56B4E9"),
)
Style = dict[str, Any]
"""Keywords of what draws a curve or a patch."""

FONT_SIZE, TICK_SIZE = 11, 10
_STYLE = {
    "font.size": FONT_SIZE,
    "axes.labelsize": FONT_SIZE,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "legend.fontsize": TICK_SIZE,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "hatch.linewidth": 0.6,
}
styled = matplotlib.style.context(["default", _STYLE])
"""Decorator: matplotlib's own defaults and the style above, while a figure is built."""


def panels(
    count: int, height: float, *, ratios: Sequence[float] = (), share: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure of panels below each other.

    Args:
        count: Number of panels.
        height: Height of the figure [in].
        ratios: Heights of the panels relative to each other; default equal.
        share: Whether they share the x axis.
    """
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(
        count, sharex=share, squeeze=False, height_ratios=ratios[:count] or None
    )[:, 0]
    for ax in axes:
        style_ticks(ax)
    figure.align_ylabels(axes)
    return figure, list(axes)


def style_ticks(ax: Axes) -> None:
    """Set the look of ticks, which are made when the figure is drawn, after the style has gone."""
    ax.tick_params(labelsize=TICK_SIZE, color="0.3", length=3.5, width=0.8)
    ax.tick_params(which="minor", color="0.3", length=2, width=0.6)


def legend_above(figure: Figure, ax: Axes) -> None:
    """A legend above all panels, where it hides nothing; entries of the same name are one."""
    handles, labels = ax.get_legend_handles_labels()
    entries = dict(zip(labels, handles, strict=True))
    figure.legend(entries.values(), entries.keys(), loc="outside upper center", ncols=len(entries))


def colour_bar(figure: Figure, drawn: ScalarMappable, ax: Axes, label: str) -> None:
    """The scale of a panel's colours, beside it."""
    bar = figure.colorbar(drawn, ax=ax, pad=0.02)
    bar.set_label(label)
    style_ticks(bar.ax)


def term_names(count: int) -> Sequence[str]:
    """Names of so many terms of a fuzzy variable: VS to VL, or numbers where they are not five."""
    return TERMS if count == len(TERMS) else [str(i + 1) for i in range(count)]


def time_parts(time: np.ndarray) -> list[np.ndarray]:
    """Which samples (N,) panels show: the first START, enlarged, and all; of a short run all."""
    start, whole = time <= time[0] + START, np.full(len(time), True)
    enlarge = time[-1] - time[0] >= 2 * START and np.count_nonzero(start) > 2
    return [start, whole] if enlarge else [whole]


def far_apart(costs: np.ndarray) -> bool:
    """Whether finite costs (n,) differ by more than LOG_RATIO, and so need a logarithmic axis."""
    return costs.size > 0 and 0 < costs.min() * LOG_RATIO < costs.max()


def finish_time(axes: Sequence[Axes], time: np.ndarray) -> None:
    """The time axis below the last of some panels, with room for what happens at once."""
    axes[-1].set_xlabel("Time [s]")
    margin = 0.01 * (time[-1] - time[0])
    if margin > 0:
        axes[-1].set_xlim(time[0] - margin, time[-1] + margin)


def finite(values: ArrayLike) -> np.ndarray:
    """Values as an array with NaN, which breaks a line, for those that are not finite."""
    numbers = np.asarray(values, np.float64)
    return np.where(np.isfinite(numbers), numbers, np.nan)


def png(figure: Figure) -> bytes:
    """A figure as a PNG file at the resolution for print."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI)
    return file.getvalue()
