"""The filter on recorded motion, compared with an invariant Kalman filter; time and memory.

1. EuRoC V1_02 with a velocity and landmarks made from its truth, at 200 and at 20 Hz. Both filters
   are tuned on the first 40 s, from initial errors of 45 deg and 1 m and of 150 deg and 5 m. They
   are judged on the rest from both initial errors, with other noise and other starts.
2. The same with outliers of 1 to 10 m in 1 % of the landmark measurements: the tuned filter without
   and with outlier rejection, and with the outliers known.
3. Seconds per sample and memory of a filter run over recordings of 10^4 to 10^6 samples.

DATA_FOLDER has a folder `euroc` with V1_02_medium as published (see docs/recordings.md), or with
its two files as *imu0.csv and *groundtruth.csv. For BROAD see `benchmarks/broad_trials.py`.

    python benchmarks/recordings.py DATA_FOLDER [--only euroc|outliers|speed] [--write]
"""

import argparse
import json
import resource
import time
import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from readme import ROOT, write_block

import posegsa
from posegsa.judging.evaluation import EKF
from posegsa.judging.on_recordings import mean_errors
from posegsa.judging.result import Result
from posegsa.progress import Display
from posegsa.recordings.euroc import LANDMARKS, read_euroc
from posegsa.recordings.recording import LANDMARK_OUTLIER
from posegsa.runtime import environment

JSON = ROOT / "benchmarks" / "recordings.json"
PAGE = "docs/recordings_results.md"
RATES = 200.0, 20.0
"""Rates of the landmarks [Hz]."""
STARTS = (45.0, 1.0), (150.0, 5.0)
"""Initial errors of a filter [deg], [m]."""
TRAINING_SEEDS, HELD_OUT_SEEDS = 3, 6
SPLIT = 40.0
"""Time that separates the tuning part from the judged part [s]."""
WRONG, OFF = 0.01, (1.0, 10.0)
"""Share of outliers in the landmark measurements, and range of their errors [m]."""
REPEATS = 7
SAMPLES = 10_000, 100_000, 1_000_000
"""Lengths of the timed recordings."""


def euroc(folder: Path) -> list[dict[str, Any]]:
    """Results of both filters, a row for each rate, start and filter."""
    rows = []
    for rate in RATES:
        noisy = {
            seed: posegsa.Recording.from_euroc(folder, landmark_rate=rate, seed=seed)
            for seed in (*range(TRAINING_SEEDS), *range(100, 100 + HELD_OUT_SEEDS))
        }
        training = [
            noisy[seed].window(0, SPLIT).off(*start, seed=10 * which + seed)
            for seed in range(TRAINING_SEEDS)
            for which, start in enumerate(STARTS)
        ]
        held_out = [
            noisy[100 + i].window(SPLIT).off(*start, seed=500 + i)
            for start in STARTS
            for i in range(HELD_OUT_SEEDS)
        ]
        tuned = posegsa.tune(ROOT / "configs" / "landmarks.toml", recordings=training)
        print(tuned.summary(), flush=True)
        with Display():
            judged = posegsa.evaluate(tuned, recordings=held_out, training=training)
        rows += _rows(rate, judged)
    return rows


def _rows(rate: float, judged: Result) -> list[dict[str, Any]]:
    rows, on = [], judged.on_recordings
    assert on is not None
    filters = {"tuned filter": on.held_out, **on.baselines}
    for which, (degrees, metres) in enumerate(STARTS):
        part = slice(which * HELD_OUT_SEEDS, (which + 1) * HELD_OUT_SEEDS)
        for name, scores in filters.items():
            errors = mean_errors(scores[part])
            each = [one.errors["judged"] for one in scores[part]]
            rows.append(
                {
                    "rate": rate,
                    "start": [degrees, metres],
                    "filter": name,
                    **errors._asdict(),
                    "total_each": [one.total for one in each],
                    "position_each": [one.position for one in each],
                }
            )
    return rows


def euroc_table(rows: list[dict[str, Any]]) -> str:
    """The results as a Markdown table, with ratios to the Kalman filter's errors."""
    kalman = {(r["rate"], *r["start"]): r for r in rows if r["filter"] == EKF}
    lines = [
        "| landmarks | start off by | filter | total [deg] | heading [deg] | inclination [deg] | "
        "position [cm] | total, position: times the Kalman filter's |",
        "| --- | --- | --- | --: | --: | --: | --: | --- |",
    ]
    for row in rows:
        beside = kalman[row["rate"], *row["start"]]
        ratios = [row[name] / beside[name] for name in ("total", "position")]
        spread = [np.ptp(row[f"{name}_each"]) / 2 for name in ("total", "position")]
        lines.append(
            f"| {row['rate']:g} Hz | {row['start'][0]:g}°, {row['start'][1]:g} m | {row['filter']} "
            f"| {row['total']:.2f} ± {spread[0]:.2f} | {row['heading']:.2f} "
            f"| {row['inclination']:.2f} "
            f"| {100 * row['position']:.2f} ± {100 * spread[1]:.2f} "
            f"| {ratios[0]:.2f}, {ratios[1]:.2f} |"
        )
    return "\n".join(lines)


def outliers(folder: Path) -> list[dict[str, Any]]:
    """Results of a filter tuned without outliers, a row for each of WAYS."""
    rows = []
    for rate in RATES:
        training = [
            _seen(folder, rate, seed)[0].window(0, SPLIT).off(*start, seed=10 * which + seed)
            for seed in range(TRAINING_SEEDS)
            for which, start in enumerate(STARTS)
        ]
        tuned = posegsa.tune(ROOT / "configs" / "landmarks.toml", recordings=training)
        seen = [_seen(folder, rate, 100 + i) for i in range(HELD_OUT_SEEDS)]
        for start in STARTS:
            for which, name in enumerate(WAYS):
                errors = []
                for i, each in enumerate(seen):
                    recording = each[which].window(SPLIT).off(*start, seed=500 + i)
                    found = posegsa.recording_errors(tuned.estimate(recording), recording)
                    errors.append(found.rmse()["judged"])
                lost = [
                    int((each[which].measurements.landmark_weights == 0).sum()) for each in seen
                ]
                none = [int((each[0].measurements.landmark_weights == 0).sum()) for each in seen]
                rows.append(
                    {
                        "rate": rate,
                        "start": list(start),
                        "way": name,
                        "passed_over": float(np.mean(lost) - np.mean(none)),
                        "total": float(np.mean([one.total for one in errors])),
                        "position": float(np.mean([one.position for one in errors])),  # type: ignore[misc]  # each has a position
                    }
                )
                print(rows[-1], flush=True)
    return rows


WAYS = (
    "no outliers, all believed",
    "no outliers, passed over where found",
    "1 % outliers, all believed",
    "1 % outliers, passed over where found",
    "1 % outliers, known and left out",
)


def _seen(folder: Path, rate: float, seed: int) -> list[posegsa.Recording]:
    """A recording for each of WAYS."""
    given = read_euroc(
        folder,
        landmarks=LANDMARKS,
        landmark_noise=0.05,
        landmark_rate=rate,
        velocity_noise=0.05,
        velocity_bias=(0.05, -0.05, 0.02),
        seed=seed,
    )
    clean, rng = given["landmarks"], np.random.default_rng(1000 + seed)
    wrong = rng.random(clean.shape[:2]) < WRONG
    along = rng.normal(size=clean.shape)
    along *= rng.uniform(*OFF, wrong.shape)[..., None] / np.linalg.norm(along, axis=-1)[..., None]
    with_outliers = np.where(wrong[..., None], clean + along, clean)
    known = np.where(wrong[..., None], np.nan, clean)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", posegsa.PosegsaWarning)
        return [
            posegsa.Recording.from_arrays(**given | {"landmarks": y, "landmark_outlier": factor})
            for y, factor in (
                (clean, "off"),
                (clean, LANDMARK_OUTLIER),
                (with_outliers, "off"),
                (with_outliers, LANDMARK_OUTLIER),
                (known, "off"),
            )
        ]


def outliers_table(rows: list[dict[str, Any]]) -> str:
    """The results as a Markdown table."""
    lines = [
        "| landmarks | start off by | | passed over | total [deg] | position [cm] |",
        "| --- | --- | --- | --: | --: | --: |",
    ]
    lines += [
        f"| {row['rate']:g} Hz | {row['start'][0]:g}°, {row['start'][1]:g} m | {row['way']} "
        f"| {row['passed_over']:.1f} | {row['total']:.2f} | {100 * row['position']:.2f} |"
        for row in rows
    ]
    return "\n".join(lines)


def speed() -> list[dict[str, float]]:
    """Time and memory of filter runs over recordings of several lengths."""
    observer, rows = posegsa.Observer(posegsa.ConstantGain(jnp.float32(5.0))), []
    for samples in (SAMPLES[0], *SAMPLES):  # the first run compiles
        recording = _recording(samples)
        before, times = _memory(), []
        for _ in range(REPEATS):
            started = time.perf_counter()
            posegsa.run_filter(observer, recording)
            times.append(time.perf_counter() - started)
        rows.append({"samples": samples, "seconds": min(times), "more_mib": _memory() - before})
    return rows[1:]


def _recording(samples: int) -> posegsa.Recording:
    """A body at rest at 200 Hz that sees three landmarks at 20 Hz."""
    rng = np.random.default_rng(0)
    known = np.array([[3.0, 1, 2], [-2, 4, 1], [1, -3, 0.5]])
    landmarks = known + 0.05 * rng.normal(size=(samples, 3, 3))
    landmarks[np.arange(samples) % 10 != 0] = np.nan
    return posegsa.Recording.from_arrays(
        time_step=0.005,
        angular_velocity=0.01 * rng.normal(size=(samples, 3)),
        velocity=0.01 * rng.normal(size=(samples, 3)),
        landmarks=landmarks,
        landmark_references=known,
    )


def _memory() -> float:
    """Peak memory of the process [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def speed_table(rows: list[dict[str, float]]) -> str:
    """The results as a Markdown table."""
    lines = [
        "| samples | at 200 Hz | time | per sample | more memory than the recording itself |",
        "| --: | --: | --: | --: | --: |",
    ]
    lines += [
        f"| {row['samples']:,.0f} | {row['samples'] / 200 / 60:.3g} min | {row['seconds']:.3g} s "
        f"| {1e6 * row['seconds'] / row['samples']:.2f} us | {row['more_mib']:.0f} MiB |"
        for row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="The filter on recorded motion.")
    parser.add_argument("data", metavar="DATA_FOLDER", type=Path)
    parser.add_argument("--only", choices=("euroc", "outliers", "speed"))
    parser.add_argument("--write", action="store_true", help=f"into {PAGE} and {JSON.name}")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    held: dict[str, Any] = json.loads(JSON.read_text("utf-8")) if JSON.exists() else {}
    if options.only in (None, "speed"):
        held["speed"] = speed()
        print(speed_table(held["speed"]))
    if options.only in (None, "euroc"):
        held["euroc"] = euroc(options.data / "euroc")
        print(euroc_table(held["euroc"]))
    if options.only in (None, "outliers"):
        held["outliers"] = outliers(options.data / "euroc")
        print(outliers_table(held["outliers"]))
    held["environment"] = environment()
    if options.write:
        JSON.write_text(json.dumps(held, indent=1) + "\n", encoding="utf-8")
        write(held)


def write(held: dict[str, Any]) -> None:
    """Write the tables to the page."""
    where = held["environment"]
    by = (
        f"\n\nBy `python benchmarks/recordings.py DATA_FOLDER --write` ({where['device']}, jax "
        f"{where['jax']})."
    )
    write_block("euroc", euroc_table(held["euroc"]) + by, PAGE)
    write_block("outliers", outliers_table(held["outliers"]) + by, PAGE)
    write_block("speed", speed_table(held["speed"]) + by, PAGE)


if __name__ == "__main__":
    main()
