"""The figures of one simulation: pose, errors and gain over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from posegsa.figures import style
from posegsa.figures.captioned import ResultFigure, captioned
from posegsa.figures.style import Style, finite
from posegsa.judging.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURES: list[ResultFigure] = []
_BIASES = (
    "The difference of the curves after the first second is due to noise and biases of the sensors."
)

_TRUE: Style = {"label": "true", "color": style.BLACK, "linewidth": 1.8}
_EACH = (style.BLUE, style.VERMILION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
"""Colours of vectors."""
_ASKED: Style = {"label": "asked for", "color": style.SKY, "linewidth": 3.4}
"""The gain that a schedule asked for: wide, so that it is visible behind the gain used."""
_USED: Style = {"label": "used, after the limit", "color": style.BLACK, "linewidth": 0.9}
SETTLED = 0.2
"""Share of a run after which its errors determine the range of an axis."""
JUMP = 120.0
"""Change of an angle from one drawn sample to the next above which it jumps [deg]."""
_ERROR: Style = {"label": "error", "color": style.BLUE, "linewidth": 0.7}
_BAND: Style = {"label": "two sigma", "color": style.ORANGE, "alpha": 0.45, "linewidth": 0}
_ESTIMATED: Style = {"label": "estimated", "color": style.VERMILION, "linestyle": (0, (4, 2))}


@captioned(
    FIGURES,
    name="errors",
    title="Errors",
    caption="The fall at the start is the transient part of the cost, the level after it is the "
    "steady part. The position error is the one in the cost, |P_est - R_err P|; the distance "
    "|P_est - P| is in trajectory.csv.",
)
def plot_errors(trajectory: Trajectory) -> Figure:
    """Attitude error [deg] and position error [m] over time [s], on logarithmic axes."""
    figure, axes = style.panels(2, 4.4)
    errors = (finite(trajectory.attitude_error), finite(trajectory.position_error))
    labels = (style.ATTITUDE_ERROR, style.POSITION_ERROR)
    for ax, values, label in zip(axes, errors, labels, strict=True):
        ax.plot(trajectory.time, values, color=style.BLUE, linewidth=1.0)
        style.error_panel(ax, label, values)
    style.finish_time(axes, trajectory.time)
    return figure


@captioned(
    FIGURES,
    name="gain",
    title="Gain",
    caption="Where the two curves differ, the gain limit keeps the filter's step stable. If the "
    "gain jumps between a few levels, the schedule acts as a switch.",
)
def plot_gain(trajectory: Trajectory) -> Figure | None:
    """Gain [1/s] that the schedule requested, and after the gain limit, over time [s].

    The second panel enlarges the first second; a run shorter than two has the first panel only.
    None for a filter without a gain.
    """
    if np.isnan(trajectory.gain).all() and not np.isnan(trajectory.attitude_error).all():
        return None
    time = trajectory.time
    parts = style.time_parts(time)[::-1]
    figure, axes = style.panels(len(parts), 4.6 if len(parts) > 1 else 3.4, sharex=False)
    gains = finite(trajectory.gain), finite(trajectory.gain_used)
    for ax, part in zip(axes, parts, strict=True):
        draw_gains(ax, *((time[part], gain[part]) for gain in gains))
        style.finish_time([ax], time[part])
    style.legend_above(figure, axes[-1])
    return figure


@captioned(FIGURES, name="euler_angles", title="Attitude", caption=_BIASES)
def plot_euler(trajectory: Trajectory) -> Figure:
    """True and estimated roll, pitch and yaw [deg] over time [s], broken where they wrap."""
    return angles(trajectory.time, trajectory.euler, trajectory.euler_est)


@captioned(FIGURES, name="position", title="Position", caption=_BIASES)
def plot_position(trajectory: Trajectory) -> Figure:
    """True and estimated position [m] in the inertial frame over time [s]."""
    pair = trajectory.position, trajectory.position_est
    return positions(trajectory.time, *pair)


@captioned(
    FIGURES,
    name="uncertainty",
    title="Uncertainty",
    caption="The errors by axis, the attitude's in the body frame and the position's in the "
    "inertial frame, and twice the standard deviations that the filter gives itself. If these are "
    "right, 95 % of the errors are within. What is outside the panels is in trajectory.csv.",
)
def plot_uncertainty(trajectory: Trajectory) -> Figure | None:
    """Attitude errors [deg] and position errors [cm] with bands of two sigma over time [s].

    None for a filter without a covariance.
    """
    if np.isnan(trajectory.attitude_sigma).all():
        return None
    figure, axes = style.panels(6, 8.4)
    attitude = trajectory.attitude_parts, trajectory.attitude_sigma
    off = trajectory.position - trajectory.position_est
    position = 100 * off, 100 * trajectory.position_sigma
    settled = trajectory.time >= SETTLED * trajectory.time[-1]
    for i, ax in enumerate(axes):
        errors, sigmas = (finite(values[:, i % 3]) for values in (attitude if i < 3 else position))
        ax.fill_between(trajectory.time, -2 * sigmas, 2 * sigmas, **_BAND)
        ax.plot(trajectory.time, errors, **_ERROR)
        largest = np.nanmax(np.append(np.abs([errors, 2 * sigmas])[:, settled], 1e-9))
        ax.set_ylim(-1.3 * largest, 1.3 * largest)
        ax.set_ylabel(f"${'xyz'[i % 3]}$ {'[deg]' if i < 3 else '[cm]'}")
    for ax, what in zip(axes[::3], ("Attitude error", "Position error"), strict=True):
        ax.set_title(what, loc="left")
    style.finish_time(axes, trajectory.time)
    style.legend_above(figure, axes[0])
    return figure


@captioned(
    FIGURES,
    name="vector_biases",
    title="Biases of the vectors",
    caption="The error of each estimated bias. It falls while the body turns, down to a level "
    "that the noise of the vectors determines.",
)
def plot_vector_biases(trajectory: Trajectory) -> Figure | None:
    """Errors of the estimated biases of the vectors over time [s]; None if none are estimated."""
    errors = trajectory.vector_bias_error
    if errors.shape[1] == 0:
        return None
    figure, (ax,) = style.panels(1, 3.4)
    for i, values in enumerate(errors.T):
        label, colour = f"vector {i}", _EACH[i % len(_EACH)]
        ax.plot(trajectory.time, finite(values), label=label, color=colour, linewidth=1.2)
    style.error_panel(ax, "Error of the bias [vector's unit]", finite(errors))
    style.finish_time([ax], trajectory.time)
    style.legend_above(figure, ax)
    return figure


def angles(time: np.ndarray, true: np.ndarray | None, estimated: np.ndarray) -> Figure:
    """True and estimated roll, pitch and yaw (N, 3) [deg] over time (N,) [s], broken at wraps."""
    labels = [rf"{name} [deg]" for name in (r"Roll $\phi$", r"Pitch $\theta$", r"Yaw $\psi$")]
    ticks = [1, 1.5, 3, 4.5, 9, 10]
    return _true_and_estimated(time, (true, estimated), labels, ticks, _broken_at_wraps)


def positions(time: np.ndarray, true: np.ndarray | None, estimated: np.ndarray) -> Figure:
    """True and estimated positions (N, 3) [m] over time (N,) [s]."""
    labels = [f"${axis}$ [m]" for axis in "xyz"]
    return _true_and_estimated(time, (true, estimated), labels, [1, 2, 5, 10])


Curve = tuple[np.ndarray, np.ndarray]
"""Times (N,) [s] and values (N,)."""


def draw_gains(ax: Axes, asked: Curve, used: Curve) -> None:
    """The gain [1/s] that a schedule asked for, and after the gain limit, in a panel."""
    for curve, look in ((asked, _ASKED), (used, _USED)):
        if curve[0].size:
            ax.plot(*curve, **look)
    ax.set_ylabel("Gain $K$ [1/s]")
    ax.set_ylim(bottom=0)


def _true_and_estimated(
    time: np.ndarray,
    pair: tuple[np.ndarray | None, np.ndarray],
    labels: Sequence[str],
    ticks: Sequence[float],
    curve: Callable[[np.ndarray, np.ndarray], Curve] = lambda t, y: (t, y),
) -> Figure:
    """True and estimated components (N, 3), one panel each; `curve` maps (t, y) to a line.

    The true ones may be None.
    """
    figure, axes = style.panels(3, 5.2)
    for i, (ax, label) in enumerate(zip(axes, labels, strict=True)):
        estimated: Style = _ESTIMATED if pair[0] is not None else _ESTIMATED | {"linestyle": "-"}
        for values, look in zip(pair, (_TRUE, estimated), strict=True):
            if values is not None:
                ax.plot(*curve(time, finite(values[:, i])), **look)
        ax.set_ylabel(label)
        ax.yaxis.set_major_locator(style.ticks(5, steps=ticks))
    style.finish_time(axes, time)
    style.legend_above(figure, axes[0])
    return figure


def _broken_at_wraps(time: np.ndarray, angle: np.ndarray) -> Curve:
    """A curve of angles [deg] that leaves at +-180 and comes back on the other side.

    If neighbours differ by more than 180, the angle has wrapped. Three points are inserted between
    them, all at the time of the crossing: the end of the range, NaN, and its other end. These are
    NaN too where neighbours are more than JUMP apart even so, as where roll and yaw change over
    because the pitch passes 90: no line leads from one to the other.
    """
    step = np.abs(np.diff(angle))
    wrapped = step > 180
    jumped = np.where(wrapped, 360 - step, step) > JUMP
    before = np.flatnonzero(wrapped | jumped)
    after = before + 1
    end = np.where(jumped[before], np.nan, np.copysign(180.0, angle[before]))
    way_out, way_in = np.abs(end - angle[before]), np.abs(angle[after] + end)
    whole = way_out + way_in
    share = np.where(jumped[before], 0.5, way_out / np.where(whole > 0, whole, 1.0))
    crossing = time[before] + share * (time[after] - time[before])
    points = np.stack([end, np.full_like(end, np.nan), -end], axis=1)
    where = np.repeat(after, 3)
    return np.insert(time, where, np.repeat(crossing, 3)), np.insert(angle, where, points.ravel())
