"""The look that all figures share, for print and screen.

Figures are made without pyplot and without a trace in the process, and their look does not depend
on the user's settings. Curves differ in colour (after Okabe and Ito's palette) and in line style or
weight, to be told apart in grey print and by colour-blind readers. Quantities without a unit are
marked [-].
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

from posegsa.judging.evaluation import EARLY

DPI = 200
"""Resolution for print [dots per inch]."""
WIDTH = 6.5
"""Width of a figure [in]: one column of a page, or both of a two-column one."""
START = EARLY
"""Length of the start of a run that figures show enlarged [s]."""
LOG_RATIO = 30.0
"""Costs that differ by more than this factor are drawn over a logarithmic axis."""
ATTITUDE_ERROR, POSITION_ERROR = "Attitude error [deg]", "Position error [m]"

BLACK, BLUE, GREEN, VERMILION = "#000000", "#0072B2", "#009E73", "#D55E00"
PURPLE, SKY, ORANGE, BROWN = "#AA4499", "#56B4E9", "#E69F00", "#661100"
Style = dict[str, Any]
"""Keywords of what draws a curve or a patch."""
CURVES: tuple[Style, ...] = (
    {"color": BLUE, "linestyle": "-"},
    {"color": BLACK, "linestyle": (0, (1, 1))},
    {"color": VERMILION, "linestyle": (0, (4, 1.5))},
    {"color": GREEN, "linestyle": "-."},
    {"color": PURPLE, "linestyle": (0, (7, 1.5))},
    {"color": SKY, "linestyle": "-"},
    {"color": "0.45", "linestyle": (0, (3, 1, 1, 1, 1, 1))},
    {"color": ORANGE, "linestyle": "-"},
    {"color": BROWN, "linestyle": (0, (2, 2))},
    {"color": BLUE, "linestyle": (0, (1, 2))},
)
"""Curves that can be told apart, the clearest first."""

FONT_SIZE, TICK_SIZE = 11, 10
_LEGEND, _HANDLE = 85, 8  # characters in a line of a legend, and those that a curve's sample takes
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


@contextmanager
def _look() -> Iterator[None]:
    import matplotlib.style  # here and in other functions, as long as it takes: when one draws

    with matplotlib.style.context(["default", _STYLE]):
        yield


styled = _look()
"""Decorator: matplotlib's own defaults and the style above, while a figure is built."""


def grid(rows: int, columns: int, height: float, **keywords: Any) -> tuple[Figure, np.ndarray]:
    """A figure of this height [in] and its panels (rows, columns); keywords as of `subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **keywords)
    for ax in axes.flat:
        style_ticks(ax)
    figure.align_ylabels(axes[:, 0])
    return figure, axes


def panels(count: int, height: float, **keywords: Any) -> tuple[Figure, list[Axes]]:
    """A figure of panels below each other that share the x axis, unless told otherwise."""
    figure, axes = grid(count, 1, height, **{"sharex": True, **keywords})
    return figure, list(axes[:, 0])


def style_ticks(ax: Axes) -> None:
    """Set the look of ticks, which are made when the figure is drawn, after the style has gone."""
    ax.tick_params(labelsize=TICK_SIZE, color="0.3", length=3.5, width=0.8)
    ax.tick_params(which="minor", color="0.3", length=2, width=0.6)


def ticks(intervals: int, **keywords: Any) -> MaxNLocator:
    """Places for ticks at round numbers, at most so many intervals; keywords as of its class."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(intervals, **keywords)


def legend_above(figure: Figure, ax: Axes) -> None:
    """A legend above all panels, where it hides nothing; entries of the same name are one."""
    handles, labels = ax.get_legend_handles_labels()
    entries = dict(zip(labels, handles, strict=True))
    widths = [len(label) + _HANDLE for label in entries]
    columns = len(widths) if sum(widths) <= _LEGEND else max(1, _LEGEND // max(widths))
    figure.legend(entries.values(), entries.keys(), loc="outside upper center", ncols=columns)


def colour_bar(figure: Figure, drawn: ScalarMappable, ax: Axes, label: str) -> Colorbar:
    """The scale of a panel's colours, beside it."""
    bar = figure.colorbar(drawn, ax=ax, pad=0.025, fraction=0.03, aspect=30)
    bar.set_label(label)
    style_ticks(bar.ax)
    return bar


def plot_band(
    ax: Axes, x: np.ndarray, band: np.ndarray, label: str, style: Style, *, steps: bool = False
) -> None:
    """A curve and the band around it: low, middle and high values (3, n) over x (n,)."""
    low, middle, high = finite(band)
    filled: Style = {"step": "post"} if steps else {}
    ax.fill_between(x, low, high, color=style["color"], alpha=0.16, linewidth=0, **filled)
    ax.plot(x, middle, label=label, drawstyle="steps-post" if steps else None, **style)


def time_parts(time: np.ndarray) -> list[np.ndarray]:
    """Which samples (N,) panels show: the first START, enlarged, and all; of a short run all."""
    start, whole = time <= time[0] + START, np.full(len(time), True)
    enlarge = time[-1] - time[0] >= 2 * START and np.count_nonzero(start) > 2
    return [start, whole] if enlarge else [whole]


def scale_costs(ax: Axes, axis: str, costs: np.ndarray) -> None:
    """A logarithmic axis, "x" or "y", for finite costs (n,) that differ by more than LOG_RATIO."""
    if costs.size and 0 < costs.min() * LOG_RATIO < costs.max():
        ax.set(**{f"{axis}scale": "log"})
        plain_numbers(ax.xaxis if axis == "x" else ax.yaxis, costs)


def plain_numbers(axis: Axis, values: np.ndarray) -> None:
    """Plain numbers on a logarithmic axis, 0.1 and not 10^-1, for values above 0.

    Between powers of ten too where few of these are shown, at 3 where numbers stand side by side.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator

    few = values.max() < 300 * values.min()
    between = (1, 3) if axis is axis.axes.xaxis else (1, 2, 5)
    axis.set_major_locator(LogLocator(subs=between if few else (1,), numticks=6))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(lambda *_: ""))


def plain_both_sides(axis: Axis) -> None:
    """Plain numbers, -10 and not -10^1, at few places of an axis logarithmic on both sides of 0."""
    from matplotlib.ticker import FuncFormatter, NullLocator, SymmetricalLogLocator

    places = axis.get_major_locator()
    assert isinstance(places, SymmetricalLogLocator)
    places.set_params(numticks=7)
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def scale_errors(ax: Axes, errors: np.ndarray) -> None:
    """A logarithmic y axis for errors (...), unless none is above 0."""
    if (errors > 0).any():
        ax.set_yscale("log", nonpositive="mask")
        plain_numbers(ax.yaxis, errors[errors > 0])


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
    with _look():  # `savefig` reads the settings too
        figure.savefig(file, format="png", dpi=DPI)
    return file.getvalue()
