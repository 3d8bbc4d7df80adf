"""The attitude filter for inertial sensors on BROAD, by leave-one-out, compared with other filters.

Each trial is used twice: whole, with its initial rest, and from the middle of its motion, where the
gyroscope bias is unknown (judged after LATE seconds). The filter's numbers are chosen from a grid:
for each trial those with the smallest error on all other trials (weighted by WHOLE). Further rows
show the numbers chosen on all trials with each part of the filter changed, and other filters.

    python benchmarks/broad_trials.py DATA_FOLDER [--write]

DATA_FOLDER holds trials of BROAD as published (https://github.com/dlaidig/broad). The other filters
need the packages vqf and ahrs.
"""

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import posegsa

posegsa.enable_fast_path()

import jax  # noqa: E402  (after the fast path)
import jax.numpy as jnp  # noqa: E402  (after the fast path)
from readme import write_block  # noqa: E402  (after the fast path)

from posegsa import config  # noqa: E402  (after the fast path)
from posegsa.filters.base import samples_of  # noqa: E402  (after the fast path)
from posegsa.filters.observer import FilterSettings, Observer, VectorBias  # noqa: E402  (after the fast path)
from posegsa.filters.rollout import simulate_cost  # noqa: E402  (after the fast path)
from posegsa.model.cost import CostWeights  # noqa: E402  (after the fast path)
from posegsa.model.estimate import initial_state  # noqa: E402  (after the fast path)
from posegsa.model.schedules import ConstantGain, GainSchedule, SettlingGain, SmoothGain  # noqa: E402  (after the fast path)
from posegsa.recordings.accuracy import attitude_errors, rmse  # noqa: E402  (after the fast path)
from posegsa.recordings.imu import STARTUP, ImuRecording  # noqa: E402  (after the fast path)
from posegsa.recordings.imu_filter import imu_schedule, imu_settings, in_passes  # noqa: E402  (after the fast path)
from posegsa.recordings.magnetic_field import field_parts  # noqa: E402  (after the fast path)
from posegsa.recordings.recording import Recording  # noqa: E402  (after the fast path)
from posegsa.recordings.rotations import matrices, product  # noqa: E402  (after the fast path)
from posegsa.runtime import environment  # noqa: E402  (after the fast path)

LATE = 30.0
"""Time after a start in motion at which judging starts [s]."""
WHOLE = 0.75
"""Weight of whole trials in the minimised error; the rest is for those started in motion, which run
in one pass for this."""
LOW_PASS = (1.5, 2.0, 2.5, 3.0, 4.0)
TOLERANCE = (0.02, 0.03, 0.04, 0.06, 0.08, 0.16)
"""At least 0.02, as no reference of the field is exact (docs/imu.md)."""
GAIN = (2.0, 4.0, 8.0, 16.0)
HEADING = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)
"""K times the weight of east [1/s]."""
GAMMA = (0.3, 0.6, 1.0, 2.0)


SMOOTH = 0.02, 0.1
"""Scaled errors at which the tested schedules are half-way between their two gains."""
NAMES = "whole", "in motion"


class Setting(NamedTuple):
    """A point of the grid."""

    low_pass: float
    tolerance: float
    gain: float
    heading: float
    gamma: float

    def config(self) -> config.ImuConfig:
        """The filter with these numbers."""
        return config.ImuConfig(
            vectors=config.ImuVectorsConfig(low_pass=self.low_pass, field_tolerance=self.tolerance),
            observer=config.ImuObserverConfig(
                gain=self.gain, east_weight=self.heading / self.gain, gamma=self.gamma
            ),
        )


GRID = [Setting(*s) for s in itertools.product(LOW_PASS, TOLERANCE, GAIN, HEADING, GAMMA)]


class Trial(NamedTuple):
    """A trial, whole or from the middle of its motion."""

    name: str
    recording: Recording
    rest: Any
    """The `rest` argument of `as_imu`."""

    def prepared(self, vectors: config.ImuVectorsConfig) -> ImuRecording:
        """The recording with the vectors of a configuration."""
        return posegsa.as_imu(self.recording, rest=self.rest, settings=vectors)


def trials(folder: Path) -> tuple[list[Trial], list[Trial]]:
    """Whole trials, and the same trials started in motion."""
    whole, moving = [], []
    for path in sorted(folder.glob("*.mat")):
        recording = Recording.from_broad(path)
        whole.append(Trial(path.stem, recording, "auto"))
        start = float(recording.time[np.argmax(recording.phases["motion"])]) + 5.0
        later = recording.window(start)
        later = replace(later, judged=later.judged & (later.time >= LATE))
        moving.append(Trial(path.stem, later, 0.0))
    if not whole:
        raise SystemExit(f"{folder}: holds no trial (.mat)")
    return whole, moving


def grid_errors(each: list[Trial]) -> np.ndarray:
    """Total RMSE [deg] of each setting of the grid (rows) on each trial (columns)."""
    longest = max(trial.recording.samples for trial in each)
    gains = np.array(list(itertools.product(GAIN, HEADING, GAMMA)))
    found = np.zeros((len(LOW_PASS), len(TOLERANCE), len(gains), len(each)))
    for i, j, k in np.ndindex(len(LOW_PASS), len(TOLERANCE), len(each)):
        vectors = config.ImuVectorsConfig(low_pass=LOW_PASS[i], field_tolerance=TOLERANCE[j])
        found[i, j, :, k] = errors_by_gains(each[k].prepared(vectors), gains, longest)
    return found.reshape(len(GRID), len(each))


def errors_by_gains(recording: ImuRecording, gains: np.ndarray, longest: int) -> np.ndarray:
    """Total RMSE [deg] for each gain, heading gain and gamma (A, 3), all in one simulation."""
    index = np.minimum(np.arange(longest), recording.samples - 1)
    inside = np.arange(longest) < recording.samples
    truth = recording.truth
    assert truth is not None
    R = np.where(truth.known[:, None, None], truth.rotation, np.eye(3))[index]
    judged = recording.judged[index] & inside
    m = jax.tree.map(
        lambda a: jnp.asarray(np.asarray(a)[index], jnp.float32), recording.measurements
    )
    start = (jnp.asarray(a, jnp.float32) for a in recording.initial())
    sums = _sums(
        m,
        jnp.asarray(R, jnp.float32),
        jnp.asarray(judged, jnp.float32),
        initial_state(*start),
        gains,
        at_rest=recording.resting > 0,
    )
    # A cost of ||R_err||_I = sin^2(angle / 2): its mean is a quarter of the mean square angle.
    return 2 * np.degrees(np.sqrt(np.asarray(sums, float) / judged.sum()))


@partial(jax.jit, static_argnames="at_rest")
def _sums(m: Any, R: Any, judged: Any, initial: Any, gains: Any, *, at_rest: bool) -> Any:
    """Sum of ||R_err||_I over the judged samples (A,), for gains (A, 3)."""
    zero = jnp.zeros_like(judged)
    weights = CostWeights(transient=zero, steady=judged, window=judged > 0, position=zero[0])

    def schedule(gain: Any) -> GainSchedule:
        return ConstantGain(gain) if at_rest else SettlingGain(gain, jnp.float32(STARTUP))

    def one(numbers: Any) -> Any:
        gain, heading, gamma = numbers
        settings = imu_settings(config.ImuObserverConfig())
        east = heading / gain
        settings = replace(
            settings,
            gamma_angular=gamma,
            vectors=replace(settings.vectors, weights=(jnp.ones_like(east), east), each_agent=True),
        )
        observer = Observer(schedule(gain), settings)
        samples = samples_of(observer, m, R, jnp.zeros((len(R), 3), R.dtype))
        return simulate_cost(observer, samples, initial, weights).steady

    return jax.vmap(one)(jnp.asarray(gains, jnp.float32))


def chosen(errors: np.ndarray, trials: list[int]) -> Setting:
    """The setting of the grid with the smallest mean error on some trials.

    Args:
        errors: Total RMSE (2, settings, trials), of whole trials and of those started in motion.
        trials: Indices of the trials to use.
    """
    whole, moving = errors[:, :, trials].mean(axis=2)
    return GRID[int(np.argmin(WHOLE * whole + (1 - WHOLE) * moving))]


class Errors(NamedTuple):
    """RMSE in motion [deg]."""

    total: float
    heading: float
    inclination: float


def judged(rotation: np.ndarray, recording: Recording) -> Errors:
    """The errors of estimates (K, 3, 3) of a recording."""
    truth = recording.truth
    assert truth is not None
    each = attitude_errors(rotation, truth.rotation)
    return Errors(*(rmse(errors, recording.judged) for errors in each))


def run(trial: Trial, setting: config.ImuConfig) -> Errors:
    """Errors of the filter on a trial."""
    recording = trial.prepared(setting.vectors)
    return judged(np.asarray(posegsa.run_imu(recording, setting).rotation), recording)


# --- the filter with a part changed ---

Change = Callable[[Trial, config.ImuConfig], Errors]


def with_vectors(**changes: Any) -> Change:
    """The filter with other numbers for making the vectors."""

    def changed(trial: Trial, setting: config.ImuConfig) -> Errors:
        vectors = setting.vectors.model_copy(update=changes)
        return run(trial, setting.model_copy(update={"vectors": vectors}))

    return changed


def with_observer(**changes: Any) -> Change:
    """The filter with other numbers of the observer."""

    def changed(trial: Trial, setting: config.ImuConfig) -> Errors:
        observer = setting.observer.model_copy(update=changes)
        return run(trial, setting.model_copy(update={"observer": observer}))

    return changed


def with_settings(
    change: Callable[[FilterSettings], FilterSettings], schedule: GainSchedule | None = None
) -> Change:
    """The filter with other settings, or another schedule than its constant gain."""

    def changed(trial: Trial, setting: config.ImuConfig) -> Errors:
        recording = trial.prepared(setting.vectors)
        with jax.enable_x64(True):
            gains = schedule or imu_schedule(setting.observer, recording)
            observer = Observer(gains, change(imu_settings(setting.observer)))
            found = in_passes(recording, lambda each: posegsa.run_filter(observer, each))
        return judged(np.asarray(found.rotation), recording)

    return changed


def magnetometer_itself(trial: Trial, setting: config.ImuConfig) -> Errors:
    """The filter with the field instead of east as second vector, and the same weights."""
    recording = trial.prepared(setting.vectors)
    field = recording.sensors["magnetometer"]
    second = slice(0, recording.resting or round(1 / recording.time_step))
    up = np.asarray(recording.measurements.vectors)[second, 0]
    horizontal, vertical = np.median(field_parts(field[second], up), axis=0)

    def changed(each: ImuRecording) -> Recording:
        vectors = np.array(each.measurements.vectors)
        references = np.array(each.measurements.vector_references)
        vectors[:, 1] = field / horizontal
        references[:, 1] = [0.0, 1.0, vertical / horizontal]
        measured = each.measurements._replace(vectors=vectors, vector_references=references)
        return replace(each, measurements=measured)

    with jax.enable_x64(True):
        gain = imu_schedule(setting.observer, recording)
        observer = Observer(gain, imu_settings(setting.observer))
        found = in_passes(recording, lambda each: posegsa.run_filter(observer, changed(each)))
    return judged(np.asarray(found.rotation), recording)


def with_reference_off(trial: Trial, setting: config.ImuConfig) -> Errors:
    """The filter if the field is 2 % stronger during the initial rest or the first second."""
    recording = trial.recording
    first = recording.phases["motion"] | (recording.time >= 1.0 if trial.rest == 0 else False)
    factor = np.where(np.cumsum(first) > 0, 1.0, 1.02)
    field = recording.sensors["magnetometer"] * factor[:, None]
    changed = replace(recording, sensors=recording.sensors | {"magnetometer": field})
    return run(trial._replace(recording=changed), setting)


def without_rest(trial: Trial, setting: config.ImuConfig) -> Errors:
    """The filter without using the initial rest."""
    return run(trial._replace(rest=0.0), setting)


def learning(gain: float) -> Callable[[FilterSettings], FilterSettings]:
    """Settings that learn the vectors' biases, with a gain [1/s] at K = 10/s."""

    def change(settings: FilterSettings) -> FilterSettings:
        return replace(
            settings,
            vectors=replace(settings.vectors, each_agent=True),
            vector_bias=VectorBias(
                gain=jnp.asarray(gain, float),
                leak=jnp.zeros((), float),
                per_bound=jnp.asarray(4.0, float),
                per_turning=jnp.asarray(0.3**-4, float),
                excitation_time=jnp.asarray(1.0, float),
                law="linear",
            ),
        )

    return change


def changes(setting: config.ImuConfig) -> dict[str, Change]:
    """The changes, by their description."""
    gain = setting.observer.gain
    found: dict[str, Change] = {
        "as chosen": run,
        "no low-pass": with_vectors(low_pass=0.0),
        "no low-pass, K 0.5": lambda trial, each: with_vectors(low_pass=0.0)(
            trial,
            each.model_copy(
                update={
                    "observer": each.observer.model_copy(
                        update={"gain": 0.5, "east_weight": each.observer.east_weight * gain / 0.5}
                    )
                }
            ),
        ),
        "east always at full weight": with_vectors(field_tolerance="off"),
        "disturbances remembered for 1 s": with_vectors(field_recovery=1.0),
        "the field itself instead of east": magnetometer_itself,
        "vectors normalised": with_settings(
            lambda s: replace(s, vectors=replace(s.vectors, normalise=True))
        ),
        "angular velocity about the time after its stamp": with_vectors(gyroscope_interval="after"),
        "gyroscope's bias not learnt": with_observer(gamma=0.0),
        "nothing taken from the rest": without_rest,
        "field's reference 2 % off": with_reference_off,
    }
    found |= {
        f"vectors' biases learnt, {rate:g}/s": with_settings(learning(rate))
        for rate in (0.003, 0.03)
    }
    found |= {
        f"K {factor:g} times, heading as it is": with_observer(
            gain=gain * factor, east_weight=setting.observer.east_weight / factor
        )
        for factor in (0.25, 0.5, 2.0)
    }
    for low, high in ((gain, gain / 4), (gain / 4, gain)):
        for half in SMOOTH:
            schedule = SmoothGain(*(jnp.float32(a) for a in (low, high, half)))
            words = f"K from {low:g} to {high:g} as the error grows, half-way at {half:g}"
            found[words] = with_settings(lambda settings: settings, schedule)
    return found


# --- other filters ---


def vqf(recording: Recording) -> np.ndarray:
    """Quaternions (K, 4) of VQF with its default settings; axes east, north, up."""
    from vqf import VQF  # pyright: ignore[reportMissingImports] - of an extra

    gyr, acc, mag = sensors(recording)
    return VQF(recording.time_step).updateBatch(gyr, acc, mag)["quat9D"]


def madgwick(recording: Recording) -> np.ndarray:
    """Quaternions (K, 4) of Madgwick's filter with a gain of 0.12."""
    from ahrs.filters import Madgwick  # pyright: ignore[reportMissingImports] - of an extra

    gyr, acc, mag = sensors(recording)
    rate = 1 / recording.time_step
    found = Madgwick(gyr=gyr, acc=acc, mag=mag, frequency=rate, gain=0.12).Q
    # Its x axis points north; here y does.
    quarter = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    return product(quarter, found)


def mahony(recording: Recording) -> np.ndarray:
    """Quaternions (K, 4) of Mahony's filter with gains of 0.74 and 0.0012."""
    from ahrs.filters import Mahony  # pyright: ignore[reportMissingImports] - of an extra

    gyr, acc, mag = sensors(recording)
    rate = 1 / recording.time_step
    return Mahony(gyr=gyr, acc=acc, mag=mag, frequency=rate, k_P=0.74, k_I=0.0012).Q


OTHERS = {"VQF": vqf, "Madgwick": madgwick, "Mahony": mahony}


def sensors(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gyroscope, accelerometer and magnetometer (K, 3) of a recording, contiguous."""
    arrays = (
        recording.measurements.angular_velocity,
        recording.sensors["accelerometer"],
        recording.sensors["magnetometer"],
    )
    gyr, acc, mag = (np.ascontiguousarray(a, np.float64) for a in arrays)
    return gyr, acc, mag


# --- tables ---


def row(name: str, cells: list[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join([name, *cells]) + " |"


def cell(errors: Errors) -> str:
    """A cell with total, heading and inclination."""
    return f"{errors.total:.2f} ({errors.heading:.2f}, {errors.inclination:.2f})"


def mean(errors: list[Errors]) -> Errors:
    """Means over trials."""
    return Errors(*np.mean(errors, axis=0))


def main() -> None:
    """Choose the numbers, run all filters, and print or write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of BROAD's trials (.mat)")
    parser.add_argument("--write", action="store_true", help="write the tables to docs/imu.md")
    options = parser.parse_args()
    both = trials(options.data)
    count = len(both[0])
    errors = np.stack([grid_errors(each) for each in both])
    everywhere = list(range(count))
    best = chosen(errors, everywhere)
    print(f"chosen on all: {best}")
    held_out: list[list[Errors]] = [[], []]
    settings = []
    for k in everywhere:
        setting = chosen(errors, [i for i in everywhere if i != k])
        settings.append(setting)
        for each, found in zip(both, held_out, strict=True):
            found.append(run(each[k], setting.config()))
        print(f"{both[0][k].name}: {setting}, {held_out[0][-1]}, {held_out[1][-1]}")
    other = {
        name: [[judged(matrices(each(t.recording)), t.recording) for t in some] for some in both]
        for name, each in OTHERS.items()
    }
    lines: list[str] = []
    for number, kind in enumerate(
        (
            "Whole trials, with the rest that they begin with",
            f"The same begun 5 s into the motion, judged from {LATE:g} s later on",
        )
    ):
        heads = ["posegsa, held out", *OTHERS]
        lines += [f"{kind}: total (heading, inclination) RMSE in motion [deg].", ""]
        lines += [row("trial", heads), row("---", ["---"] * len(heads))]
        columns = [held_out[number], *(found[number] for found in other.values())]
        lines += [
            row(both[0][k].name.replace("_", " "), [cell(column[k]) for column in columns])
            for k in everywhere
        ]
        lines += [row("**mean**", [f"**{cell(mean(column))}**" for column in columns]), ""]
    spread = [sorted({getattr(s, name) for s in settings}) for name in Setting._fields]
    lines += [
        row("number", ["chosen on all", "chosen without one of them", "grid"]),
        row("---", ["---"] * 3),
    ]
    grids = (LOW_PASS, TOLERANCE, GAIN, HEADING, GAMMA)
    words = ("low_pass [s]", "field_tolerance", "gain K [1/s]", "K east_weight [1/s]", "gamma")
    for word, value, values, grid in zip(words, best, spread, grids, strict=True):
        lines.append(
            row(word, [f"{value:g}", *(", ".join(f"{a:g}" for a in v) for v in (values, grid))])
        )
    lines += ["", "The numbers chosen on all, with a part changed; means of all trials:", ""]
    lines += [row("", list(NAMES)), row("---", ["---"] * 2)]
    for changed, change in changes(best.config()).items():
        found = [mean([change(trial, best.config()) for trial in each]) for each in both]
        lines.append(row(changed, [cell(each) for each in found]))
        print(lines[-1], flush=True)
    lines += [
        "",
        f"By `python benchmarks/broad_trials.py DATA_FOLDER --write` ({environment()['device']}).",
    ]
    text = "\n".join(lines)
    print(text)
    if options.write:
        write_block("broad", text, "docs/imu.md")


if __name__ == "__main__":
    main()
