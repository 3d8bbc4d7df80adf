"""The figures of an evaluation: what schedules cost on unseen scenarios, and when they err.

Each function returns a `matplotlib.figure.Figure` of its own, in the look that `figure_style` sets.
"""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from posegsa.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    PURPLE,
    TICK_SIZE,
    VERMILION,
    WIDTH,
    Style,
    colour_bar,
    far_apart,
    finish_time,
    finite,
    legend_above,
    panels,
    style_ticks,
    styled,
    term_names,
    time_parts,
)
from posegsa.judging.evaluation import CONSTANT, ORACLE, RANDOM, SMOOTH, TUNED, Evaluation
from posegsa.judging.metrics import Bands, Metrics
from posegsa.judging.trust import Trust

NAMES = ("costs", "bands", "angles")
"""Names of the figures of an evaluation; it may lack some."""
ANGLE_SPREAD = 1.0
"""Least range of initial angles over which cost is worth drawing [deg]."""

_STYLES: dict[str, Style] = {
    TUNED: {"color": BLUE, "linestyle": "-"},
    CONSTANT: {"color": VERMILION, "linestyle": (0, (4, 1.5))},
    ORACLE: {"color": GREEN, "linestyle": "-."},
    RANDOM: {"color": PURPLE, "linestyle": (0, (7, 1.5))},
    SMOOTH: {"color": BLACK, "linestyle": (0, (1, 1))},
}
_OTHER: Style = {"color": "0.4", "linestyle": "-"}
_MARKERS = {TUNED: "o", CONSTANT: "s", ORACLE: "D"}
_COMPARED = (TUNED, CONSTANT, ORACLE)  # more curves than these hide each other
_GOLDEN = 0.6180339887498949  # its multiples modulo 1 spread points evenly, in any number


def evaluation_figures(evaluation: Evaluation) -> dict[str, Figure]:
    """The figures of an evaluation by name: costs, bands, and angles where these differ."""
    figures = {"costs": plot_costs(evaluation), "bands": plot_bands(evaluation)}
    if angles_differ(evaluation):
        figures["angles"] = plot_angles(evaluation)
    return figures


def angles_differ(evaluation: Evaluation) -> bool:
    """Whether the scenarios start at different attitude errors, by ANGLE_SPREAD at least."""
    angles = _metrics(evaluation, TUNED).initial_angle
    return bool(np.ptp(angles) >= ANGLE_SPREAD)


@styled
def plot_costs(evaluation: Evaluation) -> Figure:
    """Held-out cost of every contender, and the paired differences from the tuned schedule.

    A point is a scenario; bars span 5 to 95 % and 25 to 75 % of them, with the median between; the
    diamond is the mean with its 95 % interval. Infinite costs are counted beside the name and left
    out of all but the mean. The second panel has the mean of tuned minus each other contender on
    the same scenarios, with its 95 % interval.
    """
    names = list(evaluation.contenders)
    others = [name for name in names if name != TUNED]
    rows = (len(names), len(others) + 0.4)
    figure, (ax, *below) = panels(
        2 if others else 1, 1.2 + 0.5 * sum(rows), ratios=rows, share=False
    )
    drawn = []
    for row, name in enumerate(names):
        costs = _metrics(evaluation, name).cost
        drawn.append(costs[np.isfinite(costs)])
        _plot_distribution(ax, row, drawn[-1], _style(name)["color"])
        mean, low, high = evaluation.cost(name)
        if np.isfinite(mean):
            _plot_interval(ax, row, mean, low, high)
    _name_rows(ax, [_counted(name, evaluation) for name in names])
    _scale_costs(ax, "x", np.concatenate(drawn))
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
            panel.annotate(text, (1, row), (6, 0), va="center", size=TICK_SIZE, **end)
        _name_rows(panel, [_wrapped(name) for name in others])
        if not panel.collections and len(panel.lines) == 1:  # no difference is finite
            panel.set_xticks([0])
        panel.set_xlabel("Tuned minus this, cost [-]; below 0 tuned is better")
    return figure


@styled
def plot_bands(evaluation: Evaluation) -> Figure:
    """Attitude error [deg], position error [m] and gain used [1/s] over time [s].

    Tuned schedule, best constant gain and oracle: the median over scenarios, and the band from 5 to
    95 % of them, of the runs with a finite cost. The left column enlarges the start.
    """
    time = evaluation.time
    parts = time_parts(time)
    figure = Figure(figsize=(WIDTH, 6.4), layout="constrained")
    axes = figure.subplots(
        len(Bands._fields),
        len(parts),
        sharey="row",
        squeeze=False,
        width_ratios=(2, 3) if len(parts) > 1 else None,
    )
    labels = ("Attitude error [deg]", "Position error [m]", "Gain used $K$ [1/s]")
    for row, (label, field) in enumerate(zip(labels, Bands._fields, strict=True)):
        errors = field != "gain"
        positive = False
        for ax, part in zip(axes[row], parts, strict=True):
            style_ticks(ax)
            for name in _compared(evaluation):
                band = finite(getattr(evaluation.contenders[name].bands, field))
                low, middle, high = band[:, part]
                style = _style(name)
                ax.fill_between(
                    time[part], low, high, color=style["color"], alpha=0.18, linewidth=0
                )
                ax.plot(time[part], middle, label=name, **style)
                positive |= bool((band > 0).any())
            ax.grid(axis="y", color="0.9", linewidth=0.6)
            finish_time([ax], time[part])
            if row < len(labels) - 1:
                ax.set_xlabel("")
                ax.tick_params(labelbottom=False)
        axes[row, 0].set_ylabel(label)
        if errors and positive:
            axes[row, 0].set_yscale("log", nonpositive="mask")
        elif not errors:
            axes[row, 0].set_ylim(bottom=0)
    figure.align_ylabels(axes[:, 0])
    legend_above(figure, axes[0, 0])
    return figure


@styled
def plot_angles(evaluation: Evaluation) -> Figure:
    """Cost against the attitude error at the start [deg]: scenarios, and their running median.

    Infinite costs are marked at the upper edge, at their angle, and counted in the legend. Where
    all scenarios start at the same angle the figure says so.
    """
    figure, (ax,) = panels(1, 3.8)
    drawn = []
    for name in _compared(evaluation):
        metrics = _metrics(evaluation, name)
        angle, cost = metrics.initial_angle, metrics.cost
        style, bad = _style(name), ~np.isfinite(metrics.cost)
        drawn.append(cost[~bad])
        points: Style = {"color": style["color"], "linestyle": "", "markeredgewidth": 0}
        ax.plot(angle, finite(cost), marker=_MARKERS[name], alpha=0.35, markersize=3, **points)
        label = f"{name} ({np.count_nonzero(bad)} infinite)" if bad.any() else name
        ax.plot(*_running_median(angle, cost), label=label, linewidth=2, **style)
        if bad.any():
            edge = ax.get_xaxis_transform()
            top = np.full(np.count_nonzero(bad), 0.99)
            ax.plot(angle[bad], top, marker="^", transform=edge, **points)
    if not angles_differ(evaluation):
        angle = np.median(_metrics(evaluation, TUNED).initial_angle)
        ax.set_title(f"All scenarios start at {angle:.1f} deg", size=TICK_SIZE)
    _scale_costs(ax, "y", np.concatenate(drawn))
    ax.set(xlabel="Attitude error at the start [deg]", ylabel="Cost [-]")
    ax.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
    legend_above(figure, ax)
    return figure


@styled
def plot_rules(trust: Trust) -> Figure:
    """Mean firing strength of each rule over a trajectory, 0 to 1, by the terms of its inputs.

    Shades go by the square root, because the rules of small errors fire most of the time; a rule
    that never fires is left blank.
    """
    weights = np.asarray(trust.rule_weights, np.float64)
    figure, (ax,) = panels(1, 4.0)
    top = max(float(np.max(weights)), 1e-9)
    shown = np.ma.masked_array(weights, ~(weights > 0))
    image = ax.imshow(
        shown, cmap="cividis", norm=PowerNorm(0.5, 0, top), origin="lower", aspect="auto"
    )
    for (rate, error), weight in np.ndenumerate(weights):
        dark = 0 < weight < 0.3 * top
        text = f"{weight:.2g}" if weight > 0 else "never"
        colour = "white" if dark else "black" if weight > 0 else "0.5"
        ax.text(error, rate, text, ha="center", va="center", color=colour, size=TICK_SIZE)
    names = term_names(len(weights))
    ax.set_xticks(range(len(weights)), names)
    ax.set_yticks(range(len(weights)), names)
    ax.tick_params(length=0)
    ax.set(xlabel="Term of the scaled error [-]", ylabel="Term of the scaled rate [-]")
    colour_bar(figure, image, ax, "Mean firing strength [-]")
    return figure


def _metrics(evaluation: Evaluation, name: str) -> Metrics:
    return evaluation.contenders[name].metrics


def _style(name: str) -> Style:
    """Colour and line style of a contender, the same in all figures."""
    return _STYLES.get(name, _OTHER)


def _compared(evaluation: Evaluation) -> list[str]:
    """The contenders that are drawn as curves."""
    return [name for name in _COMPARED if name in evaluation.contenders]


def _wrapped(name: str) -> str:
    return textwrap.fill(name, 18)


def _counted(name: str, evaluation: Evaluation) -> str:
    """A contender's name, with the number of its costs that are not finite."""
    costs = _metrics(evaluation, name).cost
    bad = np.count_nonzero(~np.isfinite(costs))
    return _wrapped(name) + (f"\n({bad} of {len(costs)} infinite)" if bad else "")


def _name_rows(ax: Axes, names: list[str]) -> None:
    """Names for rows 0, 1, ... from the top."""
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)


def _plot_distribution(ax: Axes, row: int, costs: np.ndarray, colour: str) -> None:
    """Finite costs as points and quantile bars around a row."""
    if not costs.size:
        return
    spread = 0.2 * (2 * (_GOLDEN * np.arange(len(costs)) % 1) - 1)
    ax.scatter(costs, row + spread, s=5, color=colour, alpha=0.3, linewidth=0)
    low, first, median, third, high = np.quantile(costs, (0.05, 0.25, 0.5, 0.75, 0.95))
    ax.hlines(row, low, high, color=colour, linewidth=1.2)
    ax.hlines(row, first, third, color=colour, linewidth=5)
    ax.vlines(median, row - 0.2, row + 0.2, color=colour, linewidth=2)


def _plot_interval(ax: Axes, row: int, mean: float, low: float, high: float) -> None:
    """A mean and its interval in a row; the mean alone where there is no interval."""
    if np.isfinite(low) and np.isfinite(high):
        ax.plot([low, high], [row, row], color=BLACK, marker="|", markersize=11, zorder=3)
    ax.plot([mean], [row], "D", color="white", markeredgecolor=BLACK, markersize=4.5, zorder=4)


def _scale_costs(ax: Axes, axis: str, costs: np.ndarray) -> None:
    """A logarithmic axis for costs that differ by more than LOG_RATIO."""
    if far_apart(costs):
        ax.set(**{f"{axis}scale": "log"})


def _running_median(angle: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians of angle [deg] and of cost over neighbours by angle; NaN where that is infinite."""
    order = np.argsort(angle, kind="stable")
    width = min(len(angle), max(5, len(angle) // 10))
    width -= width % 2 == 0  # odd: the median is one of them
    windows = np.lib.stride_tricks.sliding_window_view
    middle = windows(angle[order], width)[:, width // 2]
    costs = np.where(np.isnan(cost), np.inf, cost)[order]
    return middle, finite(np.median(windows(costs, width), axis=1))
