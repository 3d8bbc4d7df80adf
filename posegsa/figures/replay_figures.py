"""The figures of a replay over time: errors, attitude, biases, position, gain and uncertainty.

Lines are broken where the recording has a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np
from jax.typing import ArrayLike

from posegsa.figures import style
from posegsa.figures.style import finite, styled
from posegsa.figures.trajectory_figures import angles, draw_gains, plot_uncertainty, positions
from posegsa.judging.replayed import Replay, attitude_sigmas, roll_pitch_yaw
from posegsa.judging.trajectory import trajectory
from posegsa.recordings.bridging import gaps_in

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_POINTS = 4000
"""Maximum number of points in a curve; with more samples the maximum of each bin is drawn."""

REPLAY_FIGURES = ("attitude_errors", "attitude", "biases", "position", "gain", "uncertainty")
"""Names of the figures of a replay."""


def draw_replay(replay: Replay, figures: Sequence[str] = REPLAY_FIGURES) -> dict[str, Figure]:
    """Figures of a replay by name, without those that have nothing to show."""
    plots = (
        *(plot_attitude_errors, plot_attitude, plot_biases, plot_position, plot_gain),
        plot_replay_uncertainty,
    )
    drawn = {
        name: plot(replay)
        for name, plot in zip(REPLAY_FIGURES, plots, strict=True)
        if name in figures
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


@styled
def plot_attitude_errors(replay: Replay) -> Figure | None:
    """Total, heading and inclination errors [deg], and the position's [m], over time [s].

    Samples that are not judged are grey. None without a truth.
    """
    errors = replay.errors
    if errors is None:
        return None
    panels = [
        (name.capitalize(), "[deg]", values) for name, values in errors.attitude._asdict().items()
    ]
    if errors.position is not None:
        panels.append(("Position", "[m]", errors.position))
    figure, axes = style.panels(len(panels), 1.2 + 1.1 * len(panels))
    judged = errors.masks["judged"]
    for ax, (name, unit, values) in zip(axes, panels, strict=True):
        known = finite(values)
        time, all_of_it = _largest(errors.time, known)
        _, counted = _largest(errors.time, np.where(judged, known, np.nan))
        ax.plot(time, all_of_it, color="0.75", linewidth=0.8)
        ax.plot(time, counted, color=style.BLUE, linewidth=1.0)
        style.error_panel(ax, f"{name}\nerror {unit}", _without_zeros(ax, finite(all_of_it)))
    style.finish_time(axes, errors.time)
    return figure


@styled
def plot_attitude(replay: Replay) -> Figure:
    """True and estimated roll, pitch and yaw [deg] over time [s]."""
    recording, some = replay.recording, _Some(replay.recording.time)
    truth = recording.truth
    true = None if truth is None else some.of(truth.rotation, roll_pitch_yaw)
    return angles(some.time, true, some.of(replay.estimates.rotation, roll_pitch_yaw))


@styled
def plot_biases(replay: Replay) -> Figure | None:
    """Estimated biases of gyroscope [deg/s] and velocity [m/s], and standard deviations [deg].

    None if nothing of this is estimated.
    """
    recording, some = replay.recording, _Some(replay.recording.time)
    bias = some.of(replay.estimates.bias)
    shown: dict[str, tuple[np.ndarray, Sequence[str]]] = {}
    shown["Gyroscope bias [deg/s]"] = np.degrees(bias[:, :3]), "xyz"
    if not recording.attitude_only:
        shown["Velocity bias [m/s]"] = bias[:, 3:], "xyz"
    shown = {label: each for label, each in shown.items() if np.nan_to_num(each[0]).any()}
    if (sigmas := attitude_sigmas(replay.estimates)) is not None:
        sigmas = some.of(sigmas)
        shown["Standard\ndeviation [deg]"] = sigmas, ("heading", "inclination")
    if not shown:
        return None
    figure, axes = style.panels(len(shown), 1.2 + 1.6 * len(shown))
    for ax, (label, (values, names)) in zip(axes, shown.items(), strict=True):
        for column, name, look in zip(values.T, names, style.CURVES, strict=False):
            ax.plot(some.time, finite(column), label=name, **look, linewidth=1.2)
        ax.set_ylabel(label)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.95), ncols=len(names))
        if values is sigmas:
            style.scale_errors(ax, finite(values))
    style.finish_time(axes, recording.time)
    return figure


@styled
def plot_position(replay: Replay) -> Figure | None:
    """True and estimated position [m] over time [s]; None if it is not estimated."""
    recording, estimates = replay.recording, replay.estimates
    if recording.attitude_only:
        return None
    some = _Some(recording.time)
    truth = None if recording.truth is None else recording.truth.position
    true = None if truth is None else some.of(truth)
    return positions(some.time, true, some.of(estimates.position))


@styled
def plot_gain(replay: Replay) -> Figure | None:
    """Gain [1/s] that the schedule requested, and after the gain limit, over time [s].

    The latter is drawn only where a vector or landmark is measured, because the limit depends on
    them. None if the gain is constant.
    """
    recording, estimates = replay.recording, replay.estimates
    m = recording.measurements
    weights = np.concatenate([m.vector_weights, m.landmark_weights], axis=1)
    seen = (np.asarray(weights) > 0).any(axis=1)
    asked, used = finite(estimates.gain), finite(estimates.gain_used[seen])
    both = np.concatenate([asked, used])
    both = both[np.isfinite(both)]
    if both.size == 0 or np.ptp(both) <= 1e-5 * both.max():  # up to rounding
        return None
    figure, (ax,) = style.panels(1, 3.0)
    draw_gains(ax, _largest(recording.time, asked), _largest(recording.time[seen], used))
    style.finish_time([ax], replay.recording.time)
    style.legend_above(figure, ax)
    return figure


def plot_replay_uncertainty(replay: Replay) -> Figure | None:
    """Errors of attitude [deg] and position [cm] by axis with bands of two sigma over time [s].

    None without a true position, or for a filter without a covariance.
    """
    truth, some = replay.recording.truth, _Some(replay.recording.time)
    if truth is None or truth.position is None or replay.estimates.covariance is None:
        return None
    drawn = jax.tree.map(some.of, replay.estimates)
    vectors = np.zeros(drawn.vector_bias.shape[1:])  # their true biases are not drawn
    # Differences in double precision: a position in single precision may be off by centimetres.
    off = some.of(truth.position - np.asarray(replay.estimates.position, np.float64))
    drawn = drawn._replace(position=np.zeros_like(off))
    return plot_uncertainty(trajectory(some.of(truth.rotation), off, drawn, vectors))


class _Some:
    """The samples that are drawn, about MAX_POINTS, with NaN in each gap."""

    def __init__(self, time: np.ndarray) -> None:
        step = max(1, len(time) // MAX_POINTS)
        self._at = _joined([part[::step] for part in _parts(time)], -1)
        self.time = self.of(time)

    def of(
        self, values: ArrayLike, change: Callable[[np.ndarray], np.ndarray] = np.asarray
    ) -> np.ndarray:
        """A function of the values (K, ...) at these samples."""
        drawn = np.array(change(np.asarray(values)[self._at]), np.float64)
        drawn[self._at < 0] = np.nan
        return drawn


def _parts(time: np.ndarray) -> list[np.ndarray]:
    """The indices of the samples between the gaps of times (K,)."""
    gaps = gaps_in(time)[0] if len(time) > 1 else np.zeros(0, int)
    return np.split(np.arange(len(time)), gaps + 1)


def _joined(parts: Sequence[np.ndarray], between: float) -> np.ndarray:
    """Arrays (n,) one after the other, with a number between them."""
    return np.concatenate([np.append(part, between) for part in parts])[:-1]


def _without_zeros(ax: Axes, errors: np.ndarray) -> np.ndarray:
    """Scale a logarithmic axis without the smallest 1 % of the errors; returns the other errors.

    Where errors pass through 0, a single sample at 1e-4 would take half of the axis.
    """
    positive = errors[errors > 0]
    if positive.size < 2:
        return errors
    least, most = np.quantile(positive, 0.01), positive.max()
    ax.set_ylim(least / 1.3, 1.3 * most)
    return positive[positive >= least]


def _largest(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve as the maxima of about MAX_POINTS bins; NaN for bins without values, and in gaps."""
    size = max(1, -(-len(values) // MAX_POINTS))
    parts = _parts(time)
    largest = [_largest_of_bins(values[part], size) for part in parts]
    return _joined([time[part][::size] for part in parts], np.nan), _joined(largest, np.nan)


def _largest_of_bins(values: np.ndarray, size: int) -> np.ndarray:
    short = -len(values) % size
    bins = np.pad(values, (0, short), constant_values=np.nan).reshape(-1, size)
    known = np.isfinite(bins).any(axis=1)
    largest = np.max(np.where(np.isfinite(bins), bins, -np.inf), axis=1)
    return np.where(known, largest, np.nan)
