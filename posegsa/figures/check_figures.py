"""The figure of a check of a recording: each sensor's difference from the truth over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posegsa.figures import style
from posegsa.figures.style import finite, styled
from posegsa.recordings.data_check import DataCheck
from posegsa.recordings.delays import predicted
from posegsa.recordings.relations import quantities

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGEST = 99.5
"""Percentile of the drawn values that determines the range of an axis."""


@styled
def plot_check(check: DataCheck) -> Figure:
    """Components of each sensor's difference from its prediction by the truth, over time [s].

    Without a truth, the measurements themselves. Of a recording of many samples only some parts
    are drawn, those in which it turns most.
    """
    q = quantities(check.recording)
    drawn = [(one.sensor, one.unit, one.measured - one.expected) for one in predicted(q)]
    if not drawn:
        drawn = [("angular_velocity", "rad/s", q.gyroscope)]
        drawn += [] if q.velocity is None else [("velocity", "m/s", q.velocity)]
        drawn += [(vector.name, "", vector.body) for vector in q.vectors]
        drawn += [(f"landmark {j}", "m", y) for j, y in enumerate(q.landmarks)]
    figure, axes = style.panels(len(drawn), 0.8 + 1.1 * len(drawn))
    colours = (style.BLUE, style.VERMILION, style.GREEN)
    for ax, (name, unit, values) in zip(axes, drawn, strict=True):
        shown = finite(values)
        for k, (axis, colour) in enumerate(zip("xyz", colours, strict=True)):
            ax.plot(q.time, shown[:, k], ".", label=axis, color=colour, markersize=1.5)
        known = np.abs(shown[np.isfinite(shown)])
        largest = float(np.percentile(known, LARGEST)) if known.size else 0.0
        if largest > 0:
            ax.set_ylim(-1.2 * largest, 1.2 * largest)
        ax.set_ylabel(f"[{unit}]" if unit else "")
        ax.set_title(name.replace("_", " "), loc="left")
    style.finish_time(axes, q.time)
    style.legend_above(figure, axes[0])
    return figure
