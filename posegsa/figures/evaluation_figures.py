"""The figures of an evaluation: costs on held-out scenarios, errors over time and by start."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from posegsa.figures import style
from posegsa.figures.captioned import ResultFigure, captioned
from posegsa.figures.style import Style, finite
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CLAIRVOYANT,
    CONSTANT,
    CONTENDERS,
    EKF_CLOCK,
    EKF_GATED,
    EKF_ITERATED,
    EKF_VECTORS,
    NOT_TUNED,
    SMOOTH,
    SWITCH,
    TUNED,
    UNTUNED,
    Evaluation,
)
from posegsa.judging.metrics import Bands, Metrics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURES: list[ResultFigure] = []

ANGLE_SPREAD = 1.0
"""Minimum range of initial angles for a figure over them [deg]."""

_LAST = (EKF_ITERATED, EKF_GATED, EKF_CLOCK)
"""They are never curves but rows with their names, so the others get the clearest styles."""
_STYLES: dict[str, Style] = {
    name: style.curve(i) for i, name in enumerate(sorted(CONTENDERS, key=_LAST.__contains__))
}
_STYLES |= {NOT_TUNED: _STYLES[TUNED], CLAIRVOYANT: {"color": "0.6", "linestyle": "-"}}
"""Colour and line style of each contender, the same in all figures."""
_MARKERS = {
    TUNED: "o",
    NOT_TUNED: "o",
    AS_CONFIGURED: "s",
    CONSTANT: "s",
    SWITCH: "D",
    SMOOTH: "v",
    EKF_VECTORS: "P",
    UNTUNED: "X",
}
"""The contenders that are drawn as curves, with their markers; more would hide each other."""
_BANDS = (TUNED, NOT_TUNED, CONSTANT, AS_CONFIGURED)
"""The contenders whose spread is drawn as a band; more would blend into one colour."""
_APART = 10.0
"""The axis of differences is logarithmic on both sides of 0 if the largest difference is more than
this factor times the median one."""
_AROUND = 7
"""Least number of scenarios on either side in a running median."""
_GOLDEN = 0.6180339887498949  # any number of its multiples modulo 1 is spread evenly


def angles_differ(evaluation: Evaluation) -> bool:
    """Whether the initial attitude errors of the scenarios spread by at least ANGLE_SPREAD."""
    angles = _metrics(evaluation, evaluation.own).initial_angle
    return bool(np.ptp(angles) >= ANGLE_SPREAD)


@captioned(
    FIGURES,
    name="costs",
    title="Held-out cost",
    caption="Each point is one scenario; thin bars span 5 to 95\u00a0% of them, thick bars 25 "
    "to 75\u00a0%, the stroke is the median and the diamond the mean with its 95\u00a0% "
    "interval. The overlap of the clouds says little, because all contenders ran on the same "
    "scenarios: compare the paired differences below. If an interval excludes 0, the contenders "
    "differ significantly. If one difference is far larger than the others, their axis is "
    "logarithmic on both sides of 0.",
)
def plot_costs(evaluation: Evaluation) -> Figure:
    """Cost of every contender on every held-out scenario, and mean paired differences.

    Infinite costs are counted next to the name and left out of all but the mean.
    """
    found = evaluation.costs
    names = list(found)
    others = [name for name in names if name != evaluation.own]
    rows = (len(names), len(others) + 0.4)
    ratios = rows if others else rows[:1]
    figure, (ax, *below) = style.panels(
        len(ratios), 1.2 + 0.5 * sum(rows), sharex=False, height_ratios=ratios
    )
    drawn, notes = [], {}
    for row, name in enumerate(names):
        costs = found[name]
        drawn.append(costs[np.isfinite(costs)])
        if bad := len(costs) - len(drawn[-1]):
            notes[name] = f"\n({bad} of {len(costs)} infinite)"
        _plot_distribution(ax, row, drawn[-1], _STYLES[name]["color"])
        if np.isfinite((cost := evaluation.cost(name)).mean):
            _plot_interval(ax, row, *cost)
    _name_rows(ax, names, notes)
    style.scale_costs(ax, "x", np.concatenate(drawn))
    ax.set_xlabel("Cost on held-out scenarios [-]")
    for panel in below:
        panel.axvline(0, color="0.6", linewidth=0.8)
        for row, name in enumerate(others):
            mean, low, high = evaluation.difference(name)
            text = "not finite"
            if np.isfinite(mean):
                _plot_interval(panel, row, mean, low, high)
                text = f"{mean:+.2f} [{low:+.2f}, {high:+.2f}]"
            end = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
            panel.annotate(text, (1, row), (6, 0), va="center", size=style.TICK_SIZE, **end)
        _name_rows(panel, others, {})
        _scale_differences(panel, [evaluation.difference(name).mean for name in others])
        if not panel.collections and len(panel.lines) == 1:  # no difference is finite
            panel.set_xticks([0])
        panel.set_xlabel(
            f"{evaluation.own.capitalize()} minus this, cost [-]; below 0 it is better"
        )
    return figure


@captioned(
    FIGURES,
    name="bands",
    title="Errors and gain over time",
    caption="Lines are medians over scenarios. The first filter and the best constant gains have "
    "bands from 5 to 95\u00a0%; of any other filter a thin line is the 95th percentile. A filter "
    "without a gain K is not in the panels of the gain, and other schedules are not drawn. The "
    "left shows which filter reduces the initial error first, the right which one stays lower "
    "afterwards. The gain shown is that after the gain limit. The position error is the one in "
    "the cost, |P_est - R_err P|, not the distance |P_est - P|. Runs without a finite cost are "
    "left out.",
)
def plot_bands(evaluation: Evaluation) -> Figure:
    """Median, and 5 to 95 % or 95 % alone, of attitude error, position error and gain over time.

    Only scenarios with a finite cost are included. The judged filter and the best constant gains
    have bands; the best time switch and the Kalman filter, whose bands would hide these, have
    lines. The left column enlarges the start.
    """
    time, bands = evaluation.time, {n: evaluation.contenders[n].bands for n in _drawn(evaluation)}
    parts = style.time_parts(time)
    labels = dict(
        zip(
            Bands._fields,
            (style.ATTITUDE_ERROR, style.POSITION_ERROR, "Gain used $K$ [1/s]"),
            strict=True,
        )
    )
    if not any(np.isfinite(each.gain).any() for each in bands.values()):
        del labels["gain"]  # none of these filters has one
    widths = (2, 3) if len(parts) > 1 else (1,)
    figure, axes = style.grid(
        len(labels), len(parts), 6.4, sharex="col", sharey="row", width_ratios=widths
    )
    for row, (field, label) in zip(axes, labels.items(), strict=True):
        row[0].set_ylabel(label)
        values = {name: np.asarray(getattr(band, field)) for name, band in bands.items()}
        for ax, part in zip(row, parts, strict=True):
            for name, band in values.items():
                if not np.isfinite(band).any():  # the gain of a filter without one
                    continue
                look = _STYLES[name] | {"zorder": 4 if name == evaluation.own else 3}
                if name in _BANDS:
                    style.plot_band(ax, time[part], band[:, part], name, look)
                else:
                    ax.plot(time[part], finite(band[1, part]), label=name, **look)
                    ax.plot(time[part], finite(band[2, part]), **look | {"linewidth": 0.7})
            ax.grid(axis="y", color="0.9", linewidth=0.6)
        if field == "gain":
            row[0].set_ylim(bottom=0)
        else:
            style.scale_errors(row[0], np.array(list(values.values())))
    for column, part in zip(axes.T, parts, strict=True):
        style.finish_time(column, time[part])
    if not set(bands) <= set(_BANDS):
        axes[0, 0].plot([], [], color=style.BLACK, linewidth=0.7, label="thin: 95 %")
    style.legend_above(figure, axes[0, 0])
    return figure


@captioned(
    FIGURES,
    name="angles",
    title="Cost against initial angle",
    caption="Points are scenarios, lines are running medians. If a curve rises towards 180 deg, "
    "the filter recovers slowly from large initial errors. Triangles at the upper edge are runs "
    "without a finite cost.",
)
def plot_angles(evaluation: Evaluation) -> Figure | None:
    """Cost against the attitude error at the start [deg]: scenarios, and their running median.

    Infinite costs are marked at the upper edge, at their angle, and counted in the legend. None
    if all scenarios start at the same angle.
    """
    if not angles_differ(evaluation):
        return None
    figure, (ax,) = style.panels(1, 3.8)
    shown = []
    # Not for a filter that starts from the sensors: its angle at the start is different.
    for name in (each for each in _drawn(evaluation) if each != UNTUNED):
        angle, cost = _metrics(evaluation, name).initial_angle, _metrics(evaluation, name).cost
        look, bad = _STYLES[name], ~np.isfinite(cost)
        shown.append(cost[~bad])
        points: Style = {"color": look["color"], "linestyle": "", "markeredgewidth": 0}
        alpha = _faint(0.35, len(cost))
        ax.plot(angle, finite(cost), marker=_MARKERS[name], alpha=alpha, markersize=3, **points)
        label = f"{name} ({np.count_nonzero(bad)} infinite)" if bad.any() else name
        order = 4 if name == evaluation.own else 3  # above the points; the judged filter on top
        ax.plot(*_running_median(angle, cost), linewidth=2, zorder=order, **look)
        if bad.any():
            edge = ax.get_xaxis_transform()
            top = np.full(np.count_nonzero(bad), 0.99)
            ax.plot(angle[bad], top, marker="^", transform=edge, **points)
        # In the legend, the line has the marker of its scenarios.
        ax.plot([], [], label=label, linewidth=2, marker=_MARKERS[name], markersize=5, **look)
    style.scale_costs(ax, "y", np.concatenate(shown))
    ax.set(xlabel="Attitude error at the start [deg]", ylabel="Cost [-]")
    ax.xaxis.set_major_locator(style.ticks(7, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
    style.legend_above(figure, ax)
    return figure


def _metrics(evaluation: Evaluation, name: str) -> Metrics:
    return evaluation.contenders[name].metrics


def _drawn(evaluation: Evaluation) -> list[str]:
    """The contenders that are drawn as curves."""
    there = [name for name in _MARKERS if name in evaluation.contenders]
    return [name for name in there if name != SMOOTH or CONSTANT not in there]


def _name_rows(ax: Axes, names: list[str], notes: dict[str, str]) -> None:
    """Label the rows 0, 1, ... from the top, some with a note below the name."""
    labels = [textwrap.fill(name, 18) + notes.get(name, "") for name in names]
    ax.set_yticks(range(len(names)), labels)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)


def _faint(alpha: float, points: int) -> float:
    """The opacity of points, lower for many points so that curves over them stay visible."""
    return alpha * min(1.0, (100 / max(points, 1)) ** 0.5)


def _plot_distribution(ax: Axes, row: int, costs: np.ndarray, colour: str) -> None:
    """Finite costs as points and quantile bars around a row."""
    if not costs.size:
        return
    spread = 0.2 * (2 * (_GOLDEN * np.arange(len(costs)) % 1) - 1)
    alpha = _faint(0.3, len(costs))
    ax.scatter(costs, row + spread, s=5, color=colour, alpha=alpha, linewidth=0)
    low, first, median, third = np.quantile(costs, (0.05, 0.25, 0.5, 0.75))
    high = np.quantile(costs, 0.95, method="higher")  # as in the table
    ax.hlines(row, low, high, color=colour, linewidth=1.2)
    ax.hlines(row, first, third, color=colour, linewidth=5)
    ax.vlines(median, row - 0.2, row + 0.2, color=colour, linewidth=2)


def _plot_interval(ax: Axes, row: int, mean: float, low: float, high: float) -> None:
    """A mean and its interval in a row; only the mean if there is no interval."""
    if np.isfinite(low) and np.isfinite(high):
        ax.plot([low, high], [row, row], color=style.BLACK, marker="|", markersize=11, zorder=3)
    ax.plot(
        [mean], [row], "D", color="white", markeredgecolor=style.BLACK, markersize=4.5, zorder=4
    )


def _scale_differences(ax: Axes, differences: list[float]) -> None:
    """Scale the axis so that a far larger difference does not squeeze the others."""
    away = np.abs(differences)[np.isfinite(differences)]
    middle = float(np.median(away)) if away.size else 0.0
    if 0 < middle * _APART < away.max():
        ax.set_xscale("symlog", linthresh=10.0 ** np.floor(np.log10(middle)))
        style.plain_both_sides(ax.xaxis)


def _running_median(angle: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles [deg] in order and the median of the costs around each; NaN where infinite."""
    order = np.argsort(angle, kind="stable")
    costs = np.where(np.isnan(cost), np.inf, cost)[order]
    half = max(_AROUND, len(angle) // 20)
    around = (costs[max(0, i - half) : i + half + 1] for i in range(len(costs)))
    return angle[order], finite(np.array([np.median(near) for near in around]))
