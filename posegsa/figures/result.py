"""The figures of a tuning run, for print and screen.

Each function returns a `matplotlib.figure.Figure` of its own, in the look that `figure_style` sets.
"""

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from posegsa.arguments import check_type
from posegsa.figures.evaluation import evaluation_figures, plot_rules
from posegsa.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    PURPLE,
    SKY,
    TICK_SIZE,
    VERMILION,
    Style,
    colour_bar,
    far_apart,
    finish_time,
    finite,
    legend_above,
    panels,
    styled,
    term_names,
    time_parts,
)
from posegsa.judging.result import TuneResult
from posegsa.judging.trajectory import Trajectory
from posegsa.model.fuzzy import FuzzyController
from posegsa.optimisers import History

_RESOLUTION = 401  # points along each side of the control surface
_NO_RULE = "no rule fires"

_TERM_STYLES: tuple[Style, ...] = (
    {"color": BLACK, "linestyle": "-"},
    {"color": BLUE, "linestyle": "--"},
    {"color": GREEN, "linestyle": "-."},
    {"color": VERMILION, "linestyle": (0, (1, 1))},
    {"color": PURPLE, "linestyle": (0, (7, 1.5))},
)
_TRUE: Style = {"label": "true", "color": BLACK, "linewidth": 1.8}
_ESTIMATED: Style = {"label": "estimated", "color": VERMILION, "linestyle": (0, (4, 2))}


@styled
def plot_input_terms(controller: FuzzyController) -> Figure:
    """Input terms VS to VL over the scaled error and rate, 0 to 1; gaps between them are marked."""
    check_type("controller", controller, FuzzyController)
    figure, (ax,) = panels(1, 3.2)
    _plot_terms(ax, np.asarray(controller.input_terms), (0.0, 1.0))
    ax.set_xlabel("Scaled error, scaled rate [-]")
    gaps = _gaps(controller)
    for start, end in gaps:
        ax.axvspan(start, end, **_hatched())
    if gaps:
        legend_above(figure, ax)
    return figure


@styled
def plot_output_terms(controller: FuzzyController) -> Figure:
    """Output terms VS to VL over the controller's output k_op [1/s]; the gain is 1 + centroid."""
    check_type("controller", controller, FuzzyController)
    figure, (ax,) = panels(1, 3.2)
    _plot_terms(ax, np.asarray(controller.output_terms), controller.output_range)
    ax.set_xlabel(r"Output $k_\mathrm{op}$ [1/s];  gain $K = 1 + $ centroid")
    return figure


@styled
def plot_surface(controller: FuzzyController) -> Figure:
    """Control surface: gain K [1/s] over the scaled error and rate, 0 to 1.

    The axes go by the square root, because a filter spends its time at small errors. Where no rule
    fires the surface is blank and hatched; the legend says what the gain is there.
    """
    check_type("controller", controller, FuzzyController)
    figure, (ax,) = panels(1, 4.3)
    axis = np.linspace(0.0, 1.0, _RESOLUTION) ** 2
    gain = np.asarray(_gains(controller, axis), np.float64)
    gaps = _gaps(controller)
    idle = np.zeros(axis.shape, bool)
    for start, end in gaps:
        idle |= (start <= axis) & (axis <= end)
    gain = np.ma.masked_array(gain, idle | idle[:, None])

    ax.set_xscale("function", functions=(_root, _square))
    ax.set_yscale("function", functions=(_root, _square))
    ax.set(xlim=(0, 1), ylim=(0, 1))
    mesh = ax.pcolormesh(axis, axis, gain, cmap="cividis", shading="nearest", rasterized=True)
    colour_bar(figure, mesh, ax, "Gain $K$ [1/s]")
    if gain.count():
        _plot_contours(ax, axis, gain)
    low, high = controller.output_range
    held, middle = "the last gain is held", f"$K$ = {1 + 0.5 * (low + high):g} 1/s"
    meaning = held if controller.no_rule == "hold" else middle
    for start, end in gaps:
        ax.axvspan(start, end, zorder=3, **_hatched(meaning))
        ax.axhspan(start, end, zorder=3, **_hatched(meaning))
    if gaps:
        legend_above(figure, ax)
    for side in (ax.xaxis, ax.yaxis):
        side.set_ticks((0, 0.01, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1))
        side.set_major_formatter("{x:g}")
    ax.set(xlabel="Scaled error [-]", ylabel="Scaled rate, per sample [-]")
    return figure


@styled
def plot_convergence(history: History) -> Figure:
    """Best cost so far, mean and worst cost of each iteration, and the costs that were not finite.

    Costs that are not finite are left out of the curves; a second panel counts them, if any.
    """
    failures = np.asarray(history.non_finite)
    iteration = np.arange(1, len(failures) + 1)
    marker = "o" if len(iteration) < 30 else None
    figure, (ax, *below) = panels(2 if failures.any() else 1, 3.6, ratios=(3, 1))
    curves: tuple[tuple[str, Array, Style], ...] = (
        ("best so far", history.best, {"color": BLUE, "linewidth": 2.2}),
        ("mean", history.mean, {"color": GREEN, "linestyle": "--"}),
        ("worst", history.worst, {"color": PURPLE, "linestyle": (0, (1, 1)), "linewidth": 1.2}),
    )
    for name, values, style in curves:
        ax.plot(iteration, finite(values), label=name, marker=marker, markersize=3, **style)
    costs = np.concatenate([finite(values) for _, values, _ in curves])
    if far_apart(costs[np.isfinite(costs)]):
        ax.set_yscale("log")
    ax.set_ylabel("Cost [-]")
    for panel in below:
        panel.bar(iteration, failures, width=1.0, color="0.35")
        panel.set_ylabel("Not\nfinite [-]")
        panel.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    last = (ax, *below)[-1]
    last.set_xlabel("Iteration [-]")
    last.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10], integer=True))
    ax.set_xlim(0.5, len(iteration) + 0.5)
    legend_above(figure, ax)
    return figure


@styled
def plot_euler(trajectory: Trajectory) -> Figure:
    """True and estimated roll, pitch and yaw [deg] over time [s], broken where they wrap."""
    figure, axes = panels(3, 5.2)
    for i, (ax, name) in enumerate(
        zip(axes, (r"Roll $\phi$", r"Pitch $\theta$", r"Yaw $\psi$"), strict=True)
    ):
        ax.plot(*_broken_at_wraps(trajectory.time, trajectory.euler[:, i]), **_TRUE)
        ax.plot(*_broken_at_wraps(trajectory.time, trajectory.euler_est[:, i]), **_ESTIMATED)
        ax.set_ylabel(f"{name} [deg]")
        ax.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 1.5, 3, 4.5, 9, 10]))
    finish_time(axes, trajectory.time)
    legend_above(figure, axes[0])
    return figure


@styled
def plot_position(trajectory: Trajectory) -> Figure:
    """True and estimated position [m] in the inertial frame over time [s]."""
    figure, axes = panels(3, 5.2)
    for i, (ax, name) in enumerate(zip(axes, "xyz", strict=True)):
        ax.plot(trajectory.time, finite(trajectory.position[:, i]), **_TRUE)
        ax.plot(trajectory.time, finite(trajectory.position_est[:, i]), **_ESTIMATED)
        ax.set_ylabel(f"${name}$ [m]")
        ax.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    finish_time(axes, trajectory.time)
    legend_above(figure, axes[0])
    return figure


@styled
def plot_errors(trajectory: Trajectory) -> Figure:
    """Attitude error [deg] and position error [m] over time [s], on logarithmic axes."""
    figure, axes = panels(2, 4.4)
    for ax, name, values in (
        (axes[0], "Attitude error [deg]", trajectory.attitude_error),
        (axes[1], "Position error [m]", trajectory.position_error),
    ):
        errors = finite(values)
        ax.plot(trajectory.time, errors, color=BLUE, linewidth=1.0)
        if (errors > 0).any():
            ax.set_yscale("log", nonpositive="mask")
        ax.set_ylabel(name)
        ax.grid(axis="y", color="0.88", linewidth=0.6)
    finish_time(axes, trajectory.time)
    return figure


@styled
def plot_gain(trajectory: Trajectory) -> Figure:
    """Gain [1/s] that the schedule asked for, and after the gain limit, over time [s].

    The second panel enlarges the first second; a run shorter than two has the first panel only.
    """
    time = trajectory.time
    parts = time_parts(time)[::-1]
    figure, axes = panels(len(parts), 4.6 if len(parts) > 1 else 3.4, share=False)
    for ax, part, width in zip(axes, parts, (0.5, 1.4), strict=False):
        for name, gain, style in (
            ("asked for", trajectory.gain, {"color": SKY, "linewidth": 2 * width}),
            ("used, after the limit", trajectory.gain_used, {"color": BLACK, "linewidth": width}),
        ):
            ax.plot(time[part], finite(gain)[part], label=name, **style)
        ax.set_ylabel("Gain $K$ [1/s]")
        ax.set_ylim(bottom=0)
        finish_time([ax], time[part])
    legend_above(figure, axes[0])
    return figure


def _plot_terms(ax: Axes, terms: np.ndarray, universe: tuple[float, float]) -> None:
    """Triangles (n, 3) over their universe, each named above its peak."""
    low, high = universe
    names = term_names(len(terms))
    order = np.argsort(terms[:, 1], kind="stable")
    places = np.empty(len(terms))
    places[order] = _apart(terms[order, 1], 0.055 * (high - low))
    for i, ((a, b, c), name, place) in enumerate(zip(terms, names, places, strict=True)):
        style = _TERM_STYLES[i % len(_TERM_STYLES)]
        ax.plot([a, b, c], [0, 1, 0], clip_on=False, linewidth=1.8, **style)
        ax.annotate(
            name,
            (b, 1.01),
            (place, 1.09),
            annotation_clip=False,
            ha="center",
            color=style["color"],
            arrowprops={"arrowstyle": "-", "linewidth": 0.7, "color": "0.5", "shrinkB": 0},
        )
    margin = 0.015 * (high - low)
    ax.set(xlim=(low - margin, high + margin), ylim=(0, 1), ylabel="Membership [-]")


def _apart(places: np.ndarray, distance: float) -> np.ndarray:
    """Ascending places moved as little and as evenly as needed to be at least `distance` apart."""
    steps = distance * np.arange(len(places))
    right = np.maximum.accumulate(places - steps) + steps
    left = np.minimum.accumulate((places - steps)[::-1])[::-1] + steps
    return 0.5 * (right + left)


@jax.jit
def _gains(controller: FuzzyController, axis: ArrayLike) -> Array:
    """Gains (rate, error) [1/s]; compiled, so that a sampled centroid's samples take no memory."""
    over_error = jax.vmap(controller, in_axes=(0, None))
    return jax.vmap(over_error, in_axes=(None, 0))(axis, axis)


def _gaps(controller: FuzzyController) -> list[tuple[float, float]]:
    """Intervals of [0, 1] that no input term covers.

    Every pair of input terms has a rule: none fires just where the error or the rate is in a gap.
    """
    terms = np.clip(np.asarray(controller.input_terms, np.float64), 0, 1)
    gaps, covered = [], 0.0
    for foot, _, end in sorted(terms.tolist()):
        if foot > covered:
            gaps.append((covered, foot))
        covered = max(covered, end)
    if covered < 1:
        gaps.append((covered, 1.0))
    return gaps


def _root(x: np.ndarray) -> np.ndarray:
    """Square root with the sign of x."""
    return np.copysign(np.sqrt(np.abs(x)), x)


def _square(x: np.ndarray) -> np.ndarray:
    """Inverse of `_root`."""
    return np.copysign(np.square(x), x)


def _hatched(meaning: str = "") -> Style:
    """Look and legend entry of a region where no rule fires."""
    label = f"{_NO_RULE}: {meaning}" if meaning else _NO_RULE
    look = {"facecolor": "white", "edgecolor": "0.35", "hatch": "////", "linewidth": 0.6}
    return {"label": label, **look}


def _plot_contours(ax: Axes, axis: np.ndarray, gain: np.ma.MaskedArray) -> None:
    """Contour lines of a surface (y, x), each level labelled once, where its line is longest."""
    low, high = gain.min(), gain.max()
    levels = [level for level in MaxNLocator(7).tick_values(low, high) if low < level < high]
    if not levels:
        return
    colours = ["white" if level < 0.5 * (low + high) else "black" for level in levels]
    lines = ax.contour(axis, axis, gain, levels=levels, colors=colours, linewidths=0.8)
    taken = np.empty((0, 2))
    for level, segments in zip(levels, lines.allsegs, strict=True):
        longest = max(segments, key=len, default=np.empty((0, 2)))
        if len(longest) == 0:
            continue
        # Away from the borders and from the labels that stand, as seen on the axes.
        seen = _root(longest)
        room = np.minimum(seen, 1 - seen).min(axis=1)
        for label in taken:
            room = np.minimum(room, np.abs(seen - label).max(axis=1))
        best = np.argmax(room)
        taken = np.vstack([taken, seen[best]])
        ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
        style: Style = {"size": TICK_SIZE, "ha": "center", "va": "center", "bbox": ground}
        x, y = longest[best]
        ax.text(x, y, f"{level:g}", zorder=4, **style)


def _broken_at_wraps(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve of angles [deg] that leaves at +-180 and comes back on the other side.

    Where neighbours differ by more than 180 the way round is the shorter one. Three points are put
    between them, all at the time of the crossing: the end of the range, NaN, and its other end.
    """
    angle = finite(angle)
    before = np.flatnonzero(np.abs(np.diff(angle)) > 180)
    after = before + 1
    end = np.copysign(180.0, angle[before])
    way_out, way_in = np.abs(end - angle[before]), np.abs(angle[after] + end)
    whole = way_out + way_in
    share = way_out / np.where(whole > 0, whole, 1.0)
    crossing = time[before] + share * (time[after] - time[before])
    points = np.stack([end, np.full_like(end, np.nan), -end], axis=1)
    where = np.repeat(after, 3)
    return np.insert(time, where, np.repeat(crossing, 3)), np.insert(angle, where, points.ravel())


def draw(result: TuneResult) -> dict[str, Figure]:
    """The figures of a result by name: the paper's five, convergence, schedule, evaluation."""
    check_type("result", result, TuneResult)
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        controller = result.controller
        return {
            "input_terms": plot_input_terms(controller),
            "output_terms": plot_output_terms(controller),
            "euler_angles": plot_euler(result.trajectory),
            "position": plot_position(result.trajectory),
            "errors": plot_errors(result.trajectory),
            "convergence": plot_convergence(result.history),
            "gain": plot_gain(result.trajectory),
            "control_surface": plot_surface(controller),
            "rules": plot_rules(result.trust),
            **evaluation_figures(result.evaluation),
        }
