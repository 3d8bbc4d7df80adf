"""Time of the attitude filter in Python: an hour of arrays, and an update of a stream.

1. An hour at 200 Hz, simulated, as whole arrays: CPU time from the arrays to the estimates, with
   all checks (`posegsa.imu`, `estimate`), and of VQF's `updateBatch` on the same arrays; in turns.
2. `PoseFilter("imu").update`, of one sample each: median and 99th percentile.

    python benchmarks/attitude_in_python.py [--write]
"""

import argparse
import time
from collections.abc import Callable
from importlib.metadata import version

import numpy as np
from machine import machine
from readme import write_block

import posegsa

RATE, SECONDS = 200.0, 3600
"""Samples a second, and the time that is simulated [s]."""
TURNS = 5
"""How often each is timed."""
UPDATES = 20_000
"""Number of updates of a stream."""


def signals() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gyroscope, accelerometer and magnetometer (N, 3) of a body that turns, with noise."""
    rng = np.random.default_rng(0)
    t = np.arange(round(RATE * SECONDS)) / RATE
    gyr = np.stack([np.sin(t), np.cos(0.7 * t), 0.5 * np.sin(0.3 * t)], axis=1)
    noise = rng.normal(size=(3, len(t), 3))
    acc, mag = np.array([0.0, 0.0, 9.81]), np.array([0.0, 20.0, -40.0])
    return gyr + 0.01 * noise[0], acc + 0.3 * noise[1], mag + 0.5 * noise[2]


def cpu(call: Callable[[], object]) -> float:
    """CPU time of a call [s]."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description="The attitude filter in Python.")
    parser.add_argument("--write", action="store_true", help="write the results to docs/imu.md")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    from vqf import VQF  # pyright: ignore[reportMissingImports] - of an extra

    gyr, acc, mag = signals()
    filter = posegsa.configured("imu")

    def ours() -> object:
        return filter.estimate(posegsa.imu(gyr, acc, mag, rate=RATE))

    def others() -> object:
        return VQF(1 / RATE).updateBatch(gyr, acc, mag)

    ours()  # compiles
    times = [(cpu(ours), cpu(others)) for _ in range(TURNS)]
    own, other = np.min(times, axis=0)
    stream, each = posegsa.PoseFilter("imu"), []
    for sample in zip(gyr[:UPDATES], acc, mag, strict=False):
        begin = time.perf_counter()
        stream.update(time_step=1 / RATE, **dict(zip(("gyr", "acc", "mag"), sample, strict=True)))
        each.append(1e6 * (time.perf_counter() - begin))
    middle, late = np.quantile(each[100:], (0.5, 0.99))
    about = machine(version("jax"), 1, "")
    text = (
        f"An hour at {RATE:g} Hz as whole arrays, warm: {own:.2f} s of CPU; VQF's `updateBatch` "
        f'{other:.2f} s. An update of `PoseFilter("imu")`: {middle:.0f} us (99th percentile '
        f"{late:.0f} us). {about['cpu']}, jax {about['jax']}, NumPy {np.__version__}, VQF "
        f"{version('vqf')}; best of {TURNS}; {about['date']}. By `python "
        "benchmarks/attitude_in_python.py --write`."
    )
    print(text)
    if options.write:
        write_block("imu-python", text, "docs/imu.md")


if __name__ == "__main__":
    main()
