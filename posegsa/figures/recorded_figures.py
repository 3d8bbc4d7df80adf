"""The figure of a filter on recordings: its errors over time, with those of other filters."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from posegsa.figures import style
from posegsa.figures.captioned import ResultFigure, captioned
from posegsa.judging.on_recordings import OnRecordings, RecordingScore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES: list[ResultFigure] = []
LINE = 80
"""Characters in a line of names below the figure."""


@captioned(
    FIGURES,
    name="recorded_errors",
    title="Errors over the recordings",
    caption="Root mean squares in blocks of about five seconds of what is judged, or shorter ones "
    "of a recording of less than 20 s; on what was held out, or, if nothing was, on what the "
    "filter was tuned on. Several recordings follow each other, with a line between them, and are "
    "numbered.",
)
def plot_recorded_errors(recorded: OnRecordings) -> Figure | None:
    """Attitude error [deg] and position error [cm] of each filter over judged time [s]."""
    own = recorded.held_out or recorded.training
    if not own:
        return None
    filters = {"this filter": own} | (recorded.baselines if recorded.held_out else {})
    positions = all(one.blocks.position is not None for one in own)
    labels = [style.ATTITUDE_ERROR, "Position error [cm]"][: 1 + positions]
    figure, axes = style.panels(len(labels), 1.6 + 1.5 * len(labels))
    for which, (ax, label) in enumerate(zip(axes, labels, strict=True)):
        drawn = []
        for (name, scores), look in zip(filters.items(), _looks(len(filters)), strict=True):
            time, errors = _steps(scores, which)
            ax.stairs(errors, time, baseline=None, label=name, **look)
            drawn.append(errors)
        known = np.concatenate(drawn)
        style.error_panel(ax, label, known[np.isfinite(known)])
        begins = np.cumsum([0.0, *(one.judged_seconds for one in own[:-1])])
        for number, begin in enumerate(begins if len(own) > 1 else (), start=1):
            ax.axvline(begin, color="0.6", linewidth=0.8)
            at = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            ax.annotate(str(number), (begin, 1.0), (3, -2), va="top", color="0.4", **at)
    style.finish_time(axes, np.array([0.0, sum(one.judged_seconds for one in own)]))
    names = "; ".join(f"{number}\u00a0{one.name}" for number, one in enumerate(own, start=1))
    names = f"\n{fill(names, LINE)}" if len(own) > 1 else ""
    axes[-1].set_xlabel(f"Judged time [s]{names}")
    style.legend_above(figure, axes[0])
    return figure


def _looks(count: int) -> list[style.Style]:
    """A line style for each filter; the first one is the widest."""
    each = [style.curve(i) for i in range(count)]
    return [look | {"linewidth": 2.2 if i == 0 else 1.2} for i, look in enumerate(each)]


def _steps(scores: Sequence[RecordingScore], which: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the blocks (n + 1,) [s], and errors in them (n,) [deg] or [cm]."""
    begin, ends, errors = 0.0, [np.zeros(1)], []
    for one in scores:
        squares = np.array(one.blocks[which], np.float64)
        seconds = one.judged_seconds
        ends.append(begin + seconds * np.arange(1, len(squares) + 1) / max(1, len(squares)))
        errors.append((100.0 if which else 1.0) * np.sqrt(squares))
        begin += seconds
    return np.concatenate(ends), style.finite(np.concatenate(errors))
