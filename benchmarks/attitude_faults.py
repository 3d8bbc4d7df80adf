"""The attitude filter and VQF after faults of a sensor, on trials of BROAD.

Each trial is used from 5 s into its motion on. A fault begins with the first sample, or lasts for
30 s in the middle. Shown is the error from 30 to 60 s after its end, beside the standard deviation
that the filter states. Values that the C header refuses (its limits) are not among the faults.

    python benchmarks/attitude_faults.py DATA_FOLDER [--write]

DATA_FOLDER holds trials of BROAD as published (https://github.com/dlaidig/broad). Needs the package
vqf.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from broad_trials import START_DELAY
from readme import write_block

import posegsa
from posegsa.model.measurements import Measurements
from posegsa.recordings.accuracy import attitude_errors
from posegsa.recordings.imu import references
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import matrices
from posegsa.words import text_table

SAMPLES = 35_000
"""Samples of a trial that are used: two minutes; shorter trials are left out."""
LATER, LASTING = 30.0, 30.0
"""When a later fault begins, and for how long it lasts [s]."""
AFTER = 30.0, 60.0
"""Time after the fault that is judged, from and to [s]."""


class Fault(NamedTuple):
    """What a sensor says wrongly."""

    sensor: str
    """Which of gyr, acc and mag."""
    begin: float
    """Time of its first sample [s]."""
    lasting: float
    """[s]; 0 is one sample."""
    wrong: Callable[[np.ndarray], np.ndarray | float | list[float]]
    """From the right samples (n, 3) to the wrong ones."""


def stuck(on_x: float) -> Callable[[np.ndarray], np.ndarray]:
    """The x axis stays at a value."""
    return lambda right: np.concatenate([np.full_like(right[:, :1], on_x), right[:, 1:]], axis=1)


def frozen(right: np.ndarray) -> np.ndarray:
    """The sensor repeats its last sample."""
    return right[:1]


def reversed_(right: np.ndarray) -> np.ndarray:
    """All axes have the wrong sign."""
    return -right


FAULTS = {
    "none": Fault("acc", 0, 0, lambda right: right),
    "at first, 1 s: acceleration reversed": Fault("acc", 0, 1, reversed_),
    "at first, 5 s: acceleration 0": Fault("acc", 0, 5, lambda right: 0 * right),
    "at first, 1 s: field reversed": Fault("mag", 0, 1, reversed_),
    "at first, one sample: field 1000 times too long": Fault("mag", 0, 0, lambda r: 1e3 * r),
    "30 s: acceleration frozen": Fault("acc", LATER, LASTING, frozen),
    "30 s: acceleration reversed": Fault("acc", LATER, LASTING, reversed_),
    "30 s: acceleration of x stuck at 97 m/s^2": Fault("acc", LATER, LASTING, stuck(97.0)),
    "30 s: gyroscope 0": Fault("gyr", LATER, LASTING, lambda right: 0 * right),
    "30 s: gyroscope of x stuck at 35 rad/s": Fault("gyr", LATER, LASTING, stuck(35.0)),
    "30 s: field frozen": Fault("mag", LATER, LASTING, frozen),
    "30 s: field reversed": Fault("mag", LATER, LASTING, reversed_),
}


def trial(path: Path) -> Recording | None:
    """A trial from within its motion on, cut to SAMPLES; None if it is shorter."""
    one = Recording.from_broad(path)
    begin = float(one.time[np.argmax(one.phases["motion"])]) + START_DELAY
    later = posegsa.as_imu(one.window(begin))
    if later.samples < SAMPLES:
        return None
    return later.window(0.0, (SAMPLES - 0.5) * later.time_step)


def with_fault(one: Recording, fault: Fault) -> dict[str, np.ndarray]:
    """The signals gyr, acc and mag (K, 3)."""
    measured = one.measurements
    gyr, vectors = np.array(measured.angular_velocity), np.array(measured.vectors)
    signals = {"gyr": gyr, "acc": vectors[:, 0], "mag": vectors[:, 1]}
    first = round(fault.begin / one.time_step)
    part = slice(first, first + max(1, round(fault.lasting / one.time_step)))
    signals[fault.sensor][part] = fault.wrong(signals[fault.sensor][part])
    return signals


def estimated(
    filter: posegsa.Result, signals: dict[str, np.ndarray], time_step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes (K, 3, 3) and standard deviations of the attitude (K,) [deg]."""
    measurements = Measurements.from_arrays(
        time_step=time_step,
        angular_velocity=signals["gyr"],
        velocity=np.zeros_like(signals["gyr"]),
        vectors=np.stack([signals["acc"], signals["mag"]], axis=1),
        vector_references=references(),
        dtype=np.float64,
    )
    found = filter.estimate(measurements, np.eye(3), np.zeros(3))
    assert found.heading_deviation is not None
    assert found.inclination_deviation is not None
    both = np.hypot(found.heading_deviation, found.inclination_deviation)
    return np.asarray(found.rotation), np.degrees(both)


def vqf(signals: dict[str, np.ndarray], time_step: float) -> np.ndarray:
    """Attitudes (K, 3, 3) of VQF with its defaults."""
    from vqf import VQF  # pyright: ignore[reportMissingImports] - of an extra

    each = (np.ascontiguousarray(signals[name]) for name in ("gyr", "acc", "mag"))
    return matrices(np.asarray(VQF(time_step).updateBatch(*each)["quat9D"]))


def main() -> None:
    parser = argparse.ArgumentParser(description="The attitude filter and VQF after faults.")
    parser.add_argument("folder", type=Path, metavar="DATA_FOLDER")
    parser.add_argument("--write", action="store_true", help="write the results to docs/imu.md")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    filter = posegsa.configured("imu")
    trials = [one for path in sorted(options.folder.glob("*.mat")) if (one := trial(path))]
    rows = [["fault", "posegsa", "its standard deviation", "VQF"]]
    for name, fault in FAULTS.items():
        found = []
        for one in trials:
            assert one.truth is not None
            signals, step = with_fault(one, fault), one.time_step
            R, deviation = estimated(filter, signals, step)
            end = fault.begin + fault.lasting
            judged = (one.time >= end + AFTER[0]) & (one.time < end + AFTER[1])
            judged &= np.isfinite(one.truth.rotation).all(axis=(1, 2))
            errors = [
                np.sqrt(np.mean(attitude_errors(each, one.truth.rotation)[0][judged] ** 2))
                for each in (R, vqf(signals, step))
            ]
            found.append([errors[0], np.mean(deviation[judged]), errors[1]])
        cells = [f"{np.median(each):.1f} ({np.max(each):.1f})" for each in np.transpose(found)]
        rows.append([name, *cells])
        print(text_table(rows[:1] + rows[-1:]), flush=True)
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    text = "\n".join([head, "| --- | --: | --: | --: |", *body])
    text += (
        "\n\nTotal RMSE 30 to 60 s after the fault [deg]: median (maximum) over "
        f"{len(trials)} trials. By `python benchmarks/attitude_faults.py DATA_FOLDER --write`."
    )
    print(text)
    if options.write:
        write_block("attitude-faults", text, "docs/imu.md")


if __name__ == "__main__":
    main()
