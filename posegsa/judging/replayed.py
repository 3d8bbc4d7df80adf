"""A filter's estimates on recordings, their errors by phase, and error tables."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from posegsa.filters.attitude import LONGEST_PAUSE
from posegsa.filters.rollout import Estimates
from posegsa.model.se3 import euler_angles
from posegsa.recordings.accuracy import RecordingErrors, Rmse, known_mean, recording_errors
from posegsa.recordings.recording import Recording
from posegsa.words import counted, text_table

MOST_TIMES = 3
"""Maximum number of times in a sentence."""
LOST_RATIO = 10.0
"""Multiple of the position error at the start above which the position at the end is lost."""
LARGE_NIS = 2.0
"""Mean NIS above which a filter's noises are called too small."""


class Replay(NamedTuple):
    """A filter's estimates on one recording."""

    recording: Recording
    estimates: Estimates
    errors: RecordingErrors | None
    """None if the recording has no truth."""

    @property
    def lost(self) -> str:
        """Why the estimate is lost at the end, in words; "" if it is not, or nothing shows it.

        It is lost if an estimate is not finite; or if over the last second (medians) its attitude
        is off by more than 90 deg, or its position by more than the body's largest distance from
        the centre of its path, and by more than LOST_RATIO times the error at the start.
        """
        estimates, truth, errors = self.estimates, self.recording.truth, self.errors
        moved = [] if self.recording.attitude_only else [estimates.position]
        if not all(np.isfinite(a).all() for a in (estimates.rotation, *moved)):
            return "its estimate is not a number"
        known = np.flatnonzero(truth.known) if truth is not None else np.zeros(0, int)
        if truth is None or errors is None or not known.size:
            return ""
        last = known[errors.time[known] >= errors.time[known[-1]] - 1.0]
        vectors = np.asarray(self.recording.measurements.vector_weights) > 0
        heading = not self.recording.attitude_only or vectors.any(axis=0).sum() > 1
        attitude = errors.attitude.total if heading else errors.attitude.inclination
        off = float(np.median(attitude[last]))
        if off > 90.0:
            return f"its attitude is off by {off:.0f} deg at the end"
        if truth.position is None or errors.position is None:
            return ""
        true, off = truth.position[known], float(np.median(errors.position[last]))
        reach = float(np.linalg.norm(true - true.mean(axis=0), axis=1).max())
        if off > max(reach, LOST_RATIO * float(errors.position[known[0]])):
            return f"its position is off by {off:.3g} m at the end"
        return ""

    @property
    def found_anew(self) -> str:
        """After which pauses the attitude was found anew, in words; "" if after none.

        The attitude filter tells it: its inclination is then as uncertain as at the start.
        """
        sigma, time = self.estimates.inclination_deviation, self.recording.time
        if sigma is None:
            return ""
        sigma = np.asarray(sigma)
        after = np.flatnonzero(np.diff(time) > LONGEST_PAUSE) + 1
        after = after[sigma[after] > 0.5 * sigma[0]]
        if not after.size:
            return ""
        shown = [f"{time[k]:.4g} s" for k in after[:MOST_TIMES]]
        more = ", ..." if len(after) > MOST_TIMES else ""
        return (
            f"after {counted(len(after), 'pause')} of more than {LONGEST_PAUSE:.2g} s the attitude "
            f"was found anew (at {', '.join(shown)}{more})"
        )

    def __repr__(self) -> str:
        errors = "no truth"
        if self.errors is not None:
            judged = self.errors.rmse()["judged"]
            errors = f"{judged.total:.3g} deg"
            if judged.position is not None:
                errors += f", {100 * judged.position:.3g} cm"
        return f"<Replay of {self.recording.name}: {errors}>"


def roll_pitch_yaw(rotation: ArrayLike) -> np.ndarray:
    """Roll, pitch and yaw (K, 3) [deg] of rotations (K, 3, 3), body to inertial."""
    return np.degrees(np.asarray(euler_angles(jnp.asarray(rotation)), np.float64))


def attitude_sigmas(estimates: Estimates) -> np.ndarray | None:
    """Standard deviations (K, 2) of heading and inclination [deg]; None if the filter has none."""
    heading, inclination = estimates.heading_deviation, estimates.inclination_deviation
    if heading is not None and inclination is not None:
        return np.degrees(np.stack([heading, inclination], axis=1))
    if estimates.covariance is None:
        return None
    x, y, z = _inertial_variances(estimates, slice(0, 3)).T
    return np.degrees(np.sqrt(np.stack([z, x + y], axis=1)))


def position_sigmas(estimates: Estimates) -> np.ndarray | None:
    """Standard deviations (K, 3) of the position by inertial axis [m]; None if it has none."""
    if estimates.covariance is None:
        return None
    return np.sqrt(_inertial_variances(estimates, slice(3, 6)))


def _inertial_variances(estimates: Estimates, part: slice) -> np.ndarray:
    """Variances (K, 3) by inertial axis of a part of the pose error, which is in the body frame."""
    R = np.asarray(estimates.rotation, np.float64)
    covariance = np.asarray(estimates.covariance, np.float64)[:, part, part]
    return np.einsum("kij,kjl,kil->ki", R, covariance, R)


def replayed_on(recording: Recording, estimates: Estimates) -> Replay:
    """A replay from a recording and the estimates at all its samples."""
    errors = None if recording.truth is None else recording_errors(estimates, recording)
    return Replay(recording, estimates, errors)


HEADS = (
    *("recording", "phase", "samples", "total\n[deg]", "heading\n[deg]", "inclination\n[deg]"),
    *("position\n[cm]", "NEES,\n6 if right", "NIS,\n1 if right"),
)
"""Column headers of an error table."""


def error_rows(name: str, phases: Iterable[tuple[str, Rmse]]) -> list[list[str]]:
    """A row for each phase of a recording; the position, NEES and NIS are empty if unknown.

    A phase that is all that is judged has no row of its own.
    """
    each_phase = dict(phases)
    judged = each_phase.pop("judged")
    others = {phase: each for phase, each in each_phase.items() if each != judged}
    same = [phase for phase in each_phase if phase not in others]
    named = {f"judged: {same[0]}" if same else "judged": judged} | others
    return [
        [
            name if first == 0 else "",
            phase,
            str(each.samples),
            *(f"{a:.2f}" for a in (each.total, each.heading, each.inclination)),
            "" if each.position is None else f"{100 * each.position:.2f}",
            *("" if number is None else f"{number:.3g}" for number in (each.nees, each.nis)),
        ]
        for first, (phase, each) in enumerate(named.items())
    ]


def with_heads(heads: list[str], rows: list[list[str]]) -> list[list[str]]:
    """The rows of an error table, the heads first; without columns that are empty."""
    filled = [i for i in range(len(heads)) if i == 0 or any(row[i] for row in rows)]
    return [[row[i] for i in filled] for row in (heads, *rows)]


def replay_table(replays: Sequence[Replay]) -> str:
    """Errors, NEES and NIS by recording and phase, as text, and what else is to be known."""
    rows = []
    for each in replays:
        if each.errors is not None:
            rows += error_rows(each.recording.name, each.errors.rmse().items())
    told = [_without_truth(each) for each in replays if each.errors is None]
    told += [f"{each.recording.name}: {words}" for each in replays if (words := each.found_anew)]
    told += [
        f"  warning: {each.recording.name}: the filter is lost: {words}; `posegsa check` looks for "
        "mistakes in a recording"
        for each in replays
        if (words := each.lost)
    ]
    told += [
        f"  warning: {each.recording.name}: {words}"
        for each in replays
        if (words := far_off(_nis(each)))
    ]
    table = [text_table(with_heads([*HEADS], rows))] if rows else []
    return "\n".join([*table, *told])


def far_off(nis: float | None) -> str:
    """That measurements are far from their prediction, by a mean NIS, and what to do, in words.

    "" if they are not, or the NIS is unknown or not finite.
    """
    if nis is None or not LARGE_NIS < nis < np.inf:
        return ""
    return (
        f"the sensors are {np.sqrt(nis):.2g} times as far from their prediction as the filter "
        f"expects (NIS {nis:.3g}, 1 if its noises are right): the start is wrong, or a sensor is "
        "noisier than stated, or disturbed. Where it is disturbed, `posegsa tune --recording FILE "
        "--set filter.belief=ramp`, with a truth, finds how far to believe each"
    )


def _nis(replay: Replay) -> float | None:
    """The mean NIS of a replay, of the judged samples if it has a truth."""
    if replay.errors is not None:
        judged = replay.errors.rmse().get("judged")
        return None if judged is None else judged.nis
    return None if replay.estimates.nis is None else known_mean(replay.estimates.nis)


def _without_truth(replay: Replay) -> str:
    """What can be said of a replay on a recording without a truth."""
    words = f"{replay.recording.name}: has no truth, so that no errors can be shown"
    if (mean := _nis(replay)) is not None and np.isfinite(mean):
        words += f"; NIS {mean:.3g}, 1 if the noises are right"
    return words
