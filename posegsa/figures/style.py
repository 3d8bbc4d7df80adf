"""The common style of all figures, for print and screen.

Figures are made without pyplot and without changing global state, and do not depend on the user's
matplotlib settings. Curves differ in colour (based on the palette of Okabe and Ito) and in line
style or width, so that they can be distinguished in greyscale and by colour-blind readers.
Quantities without a unit are marked [-].
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
"""Width of a figure [in]: a page with one column, or both columns of two."""
START = EARLY
"""Duration of the start of a run that figures show enlarged [s]."""
LOG_RATIO = 10.0
"""Costs that differ by more than this factor are drawn on a logarithmic axis."""
ATTITUDE_ERROR, POSITION_ERROR = "Attitude error [deg]", "Position error [m]"

BLACK, BLUE, GREEN, VERMILION = "#000000", "#0072B2", "#009E73", "#D55E00"
PURPLE, SKY, ORANGE, BROWN = "#AA4499", "#56B4E9", "#E69F00", "#661100"
Style = dict[str, Any]
"""Keyword arguments for a curve or a patch."""
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
    {"color": BLACK, "linestyle": "-"},
    {"color": VERMILION, "linestyle": (0, (1, 2))},
)
"""Distinguishable curves, the clearest first."""


def curve(i: int) -> Style:
    """The i-th of any number of curves: after `CURVES`, their colours with other line styles."""
    times, which = divmod(i, len(CURVES))
    dashes = CURVES[(which + times) % len(CURVES)]
    return {"color": CURVES[which]["color"], "linestyle": dashes["linestyle"]}


FONT_SIZE, TICK_SIZE = 11, 10
_LEGEND, _HANDLE = 85, 8  # characters in a line of a legend, and in its sample of a curve
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
    import matplotlib.style  # slow to import, so only when a figure is drawn

    with matplotlib.style.context(["default", _STYLE]):
        yield


styled = _look()
"""Decorator: matplotlib's defaults with the style above, while a figure is built."""


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
    """A figure of panels in a column, by default with a shared x axis."""
    figure, axes = grid(count, 1, height, **{"sharex": True, **keywords})
    return figure, list(axes[:, 0])


def style_ticks(ax: Axes) -> None:
    """Style ticks explicitly: matplotlib creates them when it draws, without the style above."""
    ax.tick_params(labelsize=TICK_SIZE, color="0.3", length=3.5, width=0.8)
    ax.tick_params(which="minor", color="0.3", length=2, width=0.6)


def ticks(intervals: int, **keywords: Any) -> MaxNLocator:
    """A locator of ticks at round numbers; arguments as of `MaxNLocator`."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(intervals, **keywords)


def legend_above(figure: Figure, ax: Axes) -> None:
    """A legend above all panels; entries with the same name are merged."""
    handles, labels = ax.get_legend_handles_labels()
    entries = dict(zip(labels, handles, strict=True))
    widths = [len(label) + _HANDLE for label in entries]
    columns = len(widths) if sum(widths) <= _LEGEND else max(1, _LEGEND // max(widths))
    figure.legend(entries.values(), entries.keys(), loc="outside upper center", ncols=columns)


def colour_bar(figure: Figure, drawn: ScalarMappable, ax: Axes, label: str) -> Colorbar:
    """A colour bar next to a panel."""
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
    """The samples (N,) of each panel: the first START and all; only all for a short run."""
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

    If few powers of ten are shown there are numbers between them, fewer on a horizontal axis.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator

    few = values.max() < 300 * values.min()
    between = (1, 3) if axis is axis.axes.xaxis else (1, 2, 5)
    axis.set_major_locator(LogLocator(subs=between if few else (1,), numticks=6))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(lambda *_: ""))


def plain_both_sides(axis: Axis) -> None:
    """Few plain numbers, -10 and not -10^1, on an axis that is logarithmic on both sides of 0."""
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


def error_panel(ax: Axes, label: str, errors: np.ndarray) -> None:
    """Label a panel of errors (...), and scale and rule its y axis."""
    ax.set_ylabel(label)
    ax.grid(axis="y", color="0.88", linewidth=0.6)
    scale_errors(ax, errors)


def finish_time(axes: Sequence[Axes], time: np.ndarray) -> None:
    """Label the time axis of the last panel, with a margin to show what happens at the start."""
    axes[-1].set_xlabel("Time [s]")
    margin = 0.01 * (time[-1] - time[0])
    if margin > 0:
        axes[-1].set_xlim(time[0] - margin, time[-1] + margin)


def finite(values: ArrayLike) -> np.ndarray:
    """Values as an array with NaN, which interrupts a line, where they are not finite."""
    numbers = np.asarray(values, np.float64)
    return np.where(np.isfinite(numbers), numbers, np.nan)


def png(figure: Figure) -> bytes:
    """A figure as a PNG file at the resolution for print."""
    file = io.BytesIO()
    with _look():  # `savefig` reads the settings too
        engine = figure.get_layout_engine()
        if engine is not None:  # lay out once here; `savefig` would lay out and draw twice
            engine.execute(figure)
            figure.set_layout_engine("none")
        figure.savefig(file, format="png", dpi=DPI)
        figure.set_layout_engine(engine)
    return file.getvalue()
