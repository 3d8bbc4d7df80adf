"""The attitude filter for inertial sensors on BROAD, by leave-one-out, compared with VQF.

Each trial is used twice: whole, including the rest at its beginning, and from START_DELAY seconds
into its motion on, judged from JUDGE_DELAY seconds after that. The rule by which numbers are chosen
was written down before the search: with the total RMSE in motion of each trial, they minimise

    1/2 (mean / VQF's mean + geometric mean of the ratios to VQF's),

over trials whole and in motion alike. Three searches (differential evolution) minimise it on all
trials; each trial is judged with the candidate that is best on the others. (The candidates depend a
little on all trials.) They begin anywhere between a fifth and five times the shipped numbers, which
are not among their candidates, as they were chosen on all trials.

    python benchmarks/broad_trials.py DATA_FOLDER [--iterations N] [--write]
    python benchmarks/broad_trials.py DATA_FOLDER --changed [--write]

DATA_FOLDER holds trials of BROAD as published (https://github.com/dlaidig/broad). Needs the package
vqf. Three searches of 60 iterations take 20 minutes on two cores.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from readme import write_block

import posegsa
from posegsa import config
from posegsa.filters.attitude import AttitudeNumbers
from posegsa.filters.base import Samples, sensors_in
from posegsa.filters.rollout import run
from posegsa.model.se3 import compose
from posegsa.model.signal import known_pose
from posegsa.recordings.accuracy import attitude_errors, rmse
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import matrices
from posegsa.search.configured_filters import filter_of
from posegsa.search.recorded import recorded_batch

START_DELAY, JUDGE_DELAY = 5.0, 30.0
"""Delay of the second use after the motion begins, and of its judgement after that [s]."""
SPREAD = 5.0
"""Numbers are searched between the shipped ones divided and multiplied by this."""
SEARCHED = tuple(name for name in AttitudeNumbers._fields if name != "outlier")
SEARCHES = 3
"""Searches with different seeds; their candidates are taken together."""
KINDS = "whole", "in motion"
Change = Callable[[Recording], Recording]


class Trial(NamedTuple):
    """A trial, whole and started in motion, as the filter reads it."""

    name: str
    whole: Recording
    moving: Recording


def trial(path: Path, change: Change | None = None) -> Trial:
    """A trial from its file, with its signals changed."""
    one = Recording.from_broad(path)
    begin = float(one.time[np.argmax(one.phases["motion"])]) + START_DELAY
    one = one if change is None else change(one)
    later = posegsa.as_imu(one.window(begin))
    moving = replace(later, judged=later.judged & (later.time >= JUDGE_DELAY))
    return Trial(path.stem, posegsa.as_imu(one), moving)


def half_the_rate(one: Recording) -> Recording:
    """Each second sample; of the gyroscope the mean since the one before."""
    gyr = np.asarray(one.measurements.angular_velocity)
    gyr = np.concatenate([gyr[:1], (gyr[1:-1:2] + gyr[2::2]) / 2])
    return changed(one, gyr, one.sensors["magnetometer"], 2)


def with_a_bias(one: Recording) -> Recording:
    """1 deg/s more about (1, 1, 1)."""
    gyr = np.asarray(one.measurements.angular_velocity)
    return changed(one, gyr + np.deg2rad(1) / np.sqrt(3), one.sensors["magnetometer"])


def with_a_long_axis(one: Recording) -> Recording:
    """The magnetometer's x axis is 5 % long."""
    gyr = np.asarray(one.measurements.angular_velocity)
    return changed(one, gyr, one.sensors["magnetometer"] * [1.05, 1, 1])


def changed(one: Recording, gyr: np.ndarray, mag: np.ndarray, stride: int = 1) -> Recording:
    """A recording with other signals, and only each `stride`-th sample of the others."""
    assert one.truth is not None
    gyr = gyr[: len(mag[::stride])]
    return Recording.from_arrays(
        name=one.name,
        time_step=stride * one.time_step,
        angular_velocity=gyr,
        truth_rotation=one.truth.rotation[::stride],
        judged=one.judged[::stride],
        phases={name: mask[::stride] for name, mask in one.phases.items()},
        sensors={
            "accelerometer": one.sensors["accelerometer"][::stride],
            "magnetometer": mag[::stride],
        },
        start=(np.eye(3), np.zeros(3)),  # `as_imu` finds its own
    )


CHANGES: dict[str, Change | None] = {
    "as they are": None,
    "half the rate": half_the_rate,
    "1 deg/s of bias added to the gyroscope": with_a_bias,
    "x axis of the magnetometer 5 % long": with_a_long_axis,
}


def vqf(recording: Recording, six_axes: bool = False) -> np.ndarray:
    """Total, heading and inclination RMSE (3,) of VQF with its defaults [deg]."""
    from vqf import VQF  # pyright: ignore[reportMissingImports] - of an extra

    m = recording.measurements
    signals = (m.angular_velocity, m.vectors[:, 0], m.vectors[:, 1])
    found = VQF(recording.time_step).updateBatch(*map(np.ascontiguousarray, signals))
    assert recording.truth is not None
    q = np.asarray(found["quat6D" if six_axes else "quat9D"])
    errors = attitude_errors(matrices(q), recording.truth.rotation)
    return np.array([rmse(each, recording.judged) for each in errors])


@jax.jit
def _errors(filter: Any, samples: Samples, weight: Any, initial: Any, values: Any) -> Any:
    """Total, heading and inclination RMSE (A, S, 3) [rad] of A candidates on S recordings."""

    def one(values: Any, samples: Samples, weight: Any, initial: Any) -> Any:
        def look(total: Any, view: Any, share: Any) -> Any:
            w, x, y, z = known_pose(view.now.truth).attitude
            w, x, y, z = compose(view.estimate.attitude, (w, -x, -y, -z))
            tilt = x * x + y * y
            halves = (
                jnp.arctan2(jnp.sqrt(tilt + z * z), jnp.abs(w)),
                jnp.arctan2(jnp.abs(z), jnp.abs(w)),
                jnp.arctan2(jnp.sqrt(tilt), jnp.sqrt(w * w + z * z)),
            )
            pairs = zip(total, halves, strict=True)
            return tuple(sum_ + 4 * share * a * a for sum_, a in pairs), None

        chosen = filter.with_values(values)
        start, zero = chosen.start(initial, sensors_in(samples)), jnp.zeros_like(weight[0])
        _, sums, _ = run(look, chosen, samples, start, extra=weight, total=(zero,) * 3)
        return jnp.sqrt(jnp.stack(sums))

    on_all = jax.vmap(one, in_axes=(None, 0, 0, 0))
    return jax.vmap(on_all, in_axes=(0, None, None, None))(values, samples, weight, initial)


class Judge:
    """RMSE of candidate numbers on trials.

    Args:
        trials: at least one.
        six_axes: without the magnetometer.
    """

    def __init__(self, trials: list[Trial], *, six_axes: bool = False) -> None:
        each = [one for trial in trials for one in (trial.whole, trial.moving)]
        if six_axes:
            each = [without_magnetometer(one) for one in each]
        experiment = config.from_dict({"filter": {"kind": "imu"}})
        self._batch = recorded_batch(experiment, each, 0.0)
        self._filter = filter_of(experiment)
        self._trials = len(trials)

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """(A, trials, 2, 3) [deg] of numbers (A, SEARCHED): total, heading, inclination."""
        recorded = self._batch.recorded
        assert recorded is not None
        values = dict(zip(SEARCHED, jnp.asarray(numbers, jnp.float32).T, strict=True))
        found = _errors(
            self._filter, self._batch.samples, recorded.weight, self._batch.initial, values
        )
        degrees = np.degrees(np.asarray(found, float))
        degrees = np.where(np.isfinite(degrees), degrees, 180.0)
        return degrees.reshape(len(numbers), self._trials, 2, 3)


def without_magnetometer(recording: Recording) -> Recording:
    """The recording with the field missing."""
    weights = np.array(recording.measurements.vector_weights)
    weights[:, 1] = 0.0
    measured = recording.measurements._replace(vector_weights=weights)
    return replace(recording, measurements=measured)


def rule(errors: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The cost (A,) of total errors (A, trials, 2), relative to VQF's (trials, 2)."""
    ratios = np.exp(np.log(errors / others).mean(axis=(1, 2)))
    return 0.5 * (errors.mean(axis=(1, 2)) / others.mean() + ratios)


def shipped_numbers() -> np.ndarray:
    """(1, SEARCHED)."""
    shipped = config.AttitudeConfig()
    return np.array([[getattr(shipped, name) for name in SEARCHED]])


def search(judge: Judge, others: np.ndarray, iterations: int) -> tuple[np.ndarray, np.ndarray]:
    """All numbers that were tried (A, SEARCHED), and their errors (A, trials, 2, 3)."""
    middle = np.log(shipped_numbers()[0])
    tried, found = [], []

    def costs(positions: np.ndarray) -> np.ndarray:
        tried.append(np.exp(positions.astype(float)))
        found.append(judge(tried[-1]))
        return rule(found[-1][..., 0], others)

    box = posegsa.box(middle - np.log(SPREAD), middle + np.log(SPREAD))
    optimiser = posegsa.DifferentialEvolution(
        agents=16, iterations=iterations, strategy="best/1/bin", factor=0.6
    )
    for seed in range(SEARCHES):
        key = jax.random.key(seed)
        posegsa.minimise(costs, box, optimiser, key, chunk=1, python_objective=True)
    return np.concatenate(tried), np.concatenate(found)


def row(name: str, cells: list[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join([name, *cells]) + " |"


def cell(errors: np.ndarray) -> str:
    """Total (heading, inclination)."""
    return "{:.2f} ({:.2f}, {:.2f})".format(*errors)


def table(names: list[str], columns: dict[str, np.ndarray]) -> list[str]:
    """Rows for each trial, and the means, of errors (trials, 2, 3)."""
    heads = [f"{name}, {kind}" for kind in KINDS for name in columns]
    lines = [row("trial", heads), row("---", ["---"] * len(heads))]
    for k, name in enumerate(names):
        cells = [cell(errors[k, i]) for i in range(2) for errors in columns.values()]
        lines.append(row(name.replace("_", " "), cells))
    means = [cell(errors[:, i].mean(axis=0)) for i in range(2) for errors in columns.values()]
    return [*lines, row("**mean**", [f"**{each}**" for each in means])]


def of_vqf(each: list[Trial]) -> np.ndarray:
    """Errors (trials, 2, 3) of VQF as it comes."""
    return np.array([[vqf(one) for one in (t.whole, t.moving)] for t in each])


def changes(paths: list[Path]) -> list[str]:
    """Rows: mean total errors of the shipped numbers and of VQF where the signals are changed."""
    numbers = shipped_numbers()
    lines = [row("", ["whole", "VQF", "in motion", "VQF"]), row("---", ["---"] * 4)]
    for name, change in CHANGES.items():
        each = [trial(path, change) for path in paths]
        own, other = (a[..., 0].mean(axis=0) for a in (Judge(each)(numbers)[0], of_vqf(each)))
        cells = [f"{x:.2f}" for pair in zip(own, other, strict=True) for x in pair]
        lines.append(row(name, cells))
    return [*lines, "", "By `python benchmarks/broad_trials.py DATA_FOLDER --changed --write`."]


def main() -> None:
    """Search, judge by leave-one-out, and print or write the tables."""
    posegsa.enable_fast_path()  # before anything uses JAX
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of BROAD's trials (.mat)")
    parser.add_argument("--iterations", type=int, default=60, help="of the search")
    parser.add_argument(
        "--changed", action="store_true", help="instead: the shipped numbers on changed signals"
    )
    parser.add_argument("--write", action="store_true", help="write the tables to docs/imu.md")
    options = parser.parse_args()
    each = [trial(path) for path in sorted(options.data.glob("*.mat"))]
    if len(each) < 2:
        raise SystemExit(f"{options.data}: holds fewer than two trials (.mat)")
    if options.changed:
        lines = changes(sorted(options.data.glob("*.mat")))
        print("\n".join(lines))
        if options.write:
            write_block("broad-changed", "\n".join(lines), "docs/imu.md")
        return
    others = of_vqf(each)
    judge = Judge(each)
    shipped = judge(shipped_numbers())[0]
    tried, errors = search(judge, others[..., 0], options.iterations)
    left_out = []
    for k in range(len(each)):
        rest = np.arange(len(each)) != k
        left_out.append(errors[np.argmin(rule(errors[..., 0][:, rest], others[rest][..., 0])), k])
    best = int(np.argmin(rule(errors[..., 0], others[..., 0])))
    held_out, ratios = np.array(left_out), np.array(left_out)[..., 0] / others[..., 0]
    means = np.exp(np.log(ratios).mean(axis=0))
    inclination = [Judge(each, six_axes=True)(shipped_numbers())[0], others_without_field(each)]
    cells = ["{:.2f} / {:.2f}".format(*a[..., 2].mean(axis=0)) for a in inclination]
    lines = [
        "Total (heading, inclination) RMSE in motion [deg], each trial by numbers chosen on the "
        "others; in motion: started 5 s into the motion, judged from 30 s after that.",
        "",
        *table([t.name for t in each], {"posegsa": held_out, "VQF": others}),
        "",
        f"Geometric mean of the ratios to VQF: {means[0]:.2f} whole, {means[1]:.2f} in motion. "
        f"More than 10 % worse than VQF: {int((ratios > 1.1).sum())} of {ratios.size}. "
        f"Shipped numbers on all trials: {cell(shipped[:, 0].mean(axis=0))} whole, "
        f"{cell(shipped[:, 1].mean(axis=0))} in motion. Inclination with six axes, whole / in "
        f"motion: {cells[0]}, VQF {cells[1]}.",
        "",
        "By `python benchmarks/broad_trials.py DATA_FOLDER --write`.",
    ]
    print("\n".join(lines))
    print({name: float(f"{value:.3g}") for name, value in zip(SEARCHED, tried[best], strict=True)})
    if options.write:
        write_block("broad", "\n".join(lines), "docs/imu.md")


def others_without_field(each: list[Trial]) -> np.ndarray:
    """RMSE (trials, 2, 3) of VQF without magnetometer."""
    return np.array([[vqf(one, six_axes=True) for one in (t.whole, t.moving)] for t in each])


if __name__ == "__main__":
    main()
