"""Room for words: where the panels of a figure stand.

It takes the place of matplotlib's constrained layout, which measures all words four times by
drawing them, half of the time that a figure takes. Here they are measured by counting: their lines,
and the characters of the longest.
"""

import math
import re
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import LayoutEngine
from matplotlib.text import Annotation, Text

POINT = 1 / 72
"""[in]."""
CHARACTER, LINE = 0.63, 1.2
"""Width of a character, as wide as a digit, and height of a line, of their size."""
EDGE, TICK, NEXT = 0.05, 0.1, 0.06
"""Space to the figure's edge, from an axis to its numbers, and from these to its label [in]."""
_MATHEMATICS = re.compile(r"\\[a-zA-Z]+|[${}^_\\]")


class Room(LayoutEngine):
    """Margins and gaps of a grid of panels, as wide as the words in them need.

    `above` is the height of what stands above the first row beside titles and legend [in].
    """

    _adjust_compatible = True
    _colorbar_gridspec = True

    def __init__(self, above: float = 0.0) -> None:
        super().__init__()
        self.above = above

    def execute(self, fig: Figure) -> None:
        """Move the panels of a figure."""
        panels = [(ax, spec.get_topmost_subplotspec()) for ax, spec in _placed(fig)]
        if not panels:
            return
        grid = panels[0][1].get_gridspec()

        def need(of: Callable[[Axes], float], rows: int | None, columns: int | None) -> float:
            """The most that panels of a row, or of a column, need."""
            return max(
                (
                    of(ax)
                    for ax, at in panels
                    if rows in (None, at.rowspan.start) and columns in (None, at.colspan.start)
                ),
                default=0.0,
            )

        def gap(count: int, needs: Callable[[int, int], float]) -> float:
            return max((needs(i, j) for i, j in pairwise(range(count))), default=0.0)

        wide, high = fig.get_size_inches()
        left, right = need(_left, None, 0), need(_right, None, grid.ncols - 1)
        top = need(_top, 0, None) + sum(map(_legend, fig.legends)) + self.above
        bottom = need(_bottom, grid.nrows - 1, None)
        between = (
            gap(grid.ncols, lambda i, j: need(_right, None, i) + need(_left, None, j)),
            gap(grid.nrows, lambda i, j: need(_bottom, i, None) + need(_top, j, None)),
        )
        inside = wide - left - right - 2 * EDGE, high - top - bottom - 2 * EDGE
        each = [
            (length - (count - 1) * space) / count
            for length, count, space in zip(inside, (grid.ncols, grid.nrows), between, strict=True)
        ]
        if min(each) <= 0:  # no room for anything: as it is
            return
        fig.subplots_adjust(
            left=(EDGE + left) / wide,
            right=1 - (EDGE + right) / wide,
            bottom=(EDGE + bottom) / high,
            top=1 - (EDGE + top) / high,
            wspace=between[0] / each[0],
            hspace=between[1] / each[1],
        )


def _placed(figure: Figure) -> Iterable[tuple[Axes, Any]]:
    return [(ax, spec) for ax in figure.axes if (spec := ax.get_subplotspec()) is not None]


def _is_bar(ax: Axes) -> bool:
    """Whether it is the scale of another panel's colours."""
    return hasattr(ax, "_colorbar")


def _left(ax: Axes) -> float:
    return 0.0 if _is_bar(ax) else max(_beside(ax.yaxis, "labelleft"), NEXT + _half_number(ax))


def _right(ax: Axes) -> float:
    if _is_bar(ax):
        return _beside(ax.yaxis, "labelright")
    beside = [
        _width(text.get_text(), _points(text)) + text.xyann[0] * POINT
        for text in ax.texts
        if isinstance(text, Annotation) and text.xycoords == ("axes fraction", "data")
    ]
    return max([_half_number(ax), *beside])


def _half_number(ax: Axes) -> float:
    """How far the last number of the horizontal axis may stand out beside it."""
    numbers = _numbers(ax.xaxis, "labelbottom")
    return 0.5 * max((_width(text, _size(ax.xaxis)) for text in numbers), default=0.0)


def _bottom(ax: Axes) -> float:
    if _is_bar(ax):
        return 0.0
    numbers = _numbers(ax.xaxis, "labelbottom")
    lines = max((_lines(text) for text in numbers), default=0)
    return (TICK if numbers else NEXT) + lines * LINE * _size(ax.xaxis) * POINT + _label(ax.xaxis)


def _top(ax: Axes) -> float:
    """Its title, and half of the number at its upper end."""
    title = ax.get_title()
    height = _lines(title) * LINE * _points(ax.title) * POINT + NEXT if title else 0.0
    offset = LINE * _size(ax.yaxis) * POINT if ax.yaxis.get_major_formatter().get_offset() else 0.0
    return height + max(offset, 0.5 * _size(ax.yaxis) * POINT)


def _beside(axis: Axis, shown: str) -> float:
    """Width of a vertical axis' numbers and its label."""
    widest = max((_width(text, _size(axis)) for text in _numbers(axis, shown)), default=0.0)
    return (TICK + widest if widest else NEXT) + _label(axis)


def _label(axis: Axis) -> float:
    """Height of an axis' label, across its lines."""
    label = axis.get_label()
    text = label.get_text()
    return NEXT + _lines(text) * LINE * _points(label) * POINT if text else 0.0


def _numbers(axis: Axis, shown: str) -> list[str]:
    """What stands at an axis' ticks within what it shows, if these have words."""
    if not axis.get_tick_params(which="major").get(shown, True):
        return []
    low, high = sorted(axis.get_view_interval())
    slack = 1e-6 * (high - low)
    places = [at for at in axis.get_majorticklocs() if low - slack <= at <= high + slack]
    return axis.get_major_formatter().format_ticks(places)


def _size(axis: Axis) -> float:
    """Of the numbers of an axis [pt]."""
    size = axis.get_tick_params(which="major").get("labelsize", 10)
    return FontProperties(size=size).get_size_in_points()


def _points(text: Text) -> float:
    """Size of a text [pt]."""
    return float(text.get_fontsize())


def _legend(legend: Any) -> float:
    if not (entries := len(legend.get_texts())):
        return 0.0
    size = _points(legend.get_texts()[0])
    rows = math.ceil(entries / legend._ncols)
    return (1.5 * rows + 0.8) * size * POINT


def _lines(text: str) -> int:
    return text.count("\n") + 1


def _width(text: str, size: float) -> float:
    longest = max(len(line) for line in _MATHEMATICS.sub("", text).split("\n"))
    return longest * CHARACTER * size * POINT
