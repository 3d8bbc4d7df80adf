"""The figure of a check of a recording: each sensor, and its difference from the truth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posegsa.figures import style
from posegsa.figures.style import finite, styled
from posegsa.recordings.data_check import DataCheck
from posegsa.recordings.delays import predicted
from posegsa.recordings.relations import quantities

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = style.BLUE, style.VERMILION, style.GREEN
DRAWN = 20000
"""Largest number of samples that are drawn."""
LARGEST = 99.5
"""Percentile of the drawn values that determines the range of an axis."""


@styled
def plot_check(check: DataCheck) -> Figure:
    """Components of each sensor over time [s], beside them their difference from the truth.

    That is their difference from what the truth predicts; without a truth there is none. Of a long
    recording every n-th sample is drawn.
    """
    q = quantities(check.recording, whole=True)
    off = {one.sensor: one.measured - one.expected for one in predicted(q)}
    units = {one.name: one.unit for one in check.sensors}
    drawn = {"angular_velocity": q.gyroscope}
    drawn |= {} if q.velocity is None else {"velocity": q.velocity}
    drawn |= {vector.name: vector.body for vector in q.vectors}
    drawn |= {f"landmark {j}": y for j, y in enumerate(q.landmarks)}
    columns = 2 if off else 1
    figure, axes = style.grid(len(drawn), columns, 0.8 + 1.1 * len(drawn), sharex=True)
    for row, (name, values) in zip(axes, drawn.items(), strict=True):
        unit = units[name]
        row[0].set_ylabel("" if unit == "its own" else f"[{unit}]")
        _plot(row[0], q.time, values, name.replace("_", " "))
        if off:
            missing = np.full_like(values, np.nan)
            _plot(row[1], q.time, off.get(name, missing), "difference from the truth")
    for column in axes.T:
        style.finish_time(list(column), q.time)
    style.legend_above(figure, axes[0, 0])
    return figure


def _plot(ax: Axes, time: np.ndarray, values: np.ndarray, title: str) -> None:
    """The components of values (K, 3) in a panel."""
    some = slice(None, None, math.ceil(len(time) / DRAWN))
    shown = finite(values)
    for k, (axis, colour) in enumerate(zip("xyz", COLOURS, strict=True)):
        ax.plot(time[some], shown[some, k], ".", label=axis, color=colour, markersize=1.5)
    known = np.abs(shown[np.isfinite(shown)])
    largest = float(np.percentile(known, LARGEST)) if known.size else 0.0
    if largest > 0:
        ax.set_ylim(-1.2 * largest, 1.2 * largest)
    ax.set_title(title, loc="left")
