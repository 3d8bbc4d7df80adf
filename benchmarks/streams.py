"""Time per sample on-line: each call for one sample, compared with the compiled call that it wraps.

Uses the tuned observer with two vectors and one landmark. The controller is in the middle of
its boxes; all controllers take the same time. Times are of single calls in sequence, in a separate
process for each precision.

    python benchmarks/streams.py [--updates N] [--write]
"""

import argparse
import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any, cast

import jax
import numpy as np
from machine import cpu
from readme import write_block

import posegsa
from posegsa import config
from posegsa.errors import PosegsaWarning
from posegsa.filters.rollout import _step
from posegsa.model.fuzzy import _compiled_gain

PAGE = "docs/streaming.md"


def observer(dtype: str) -> posegsa.Observer:
    """The filter to time."""
    experiment = config.override(config.Experiment(), [f"run.dtype={dtype}"])
    with jax.enable_x64(dtype == "float64"):
        space = posegsa.parameter_space(experiment)
        controller = space.controller(0.5 * (space.lower + space.upper))
        return posegsa.Observer(
            posegsa.FuzzyGain(controller),
            posegsa.filter_settings(experiment),
            posegsa.signal_settings(experiment.gain, dtype),
        )


def made(dtype: str) -> Callable[[], posegsa.PoseFilter]:
    """A function that makes the filter for a stream."""
    scenario, filter = config.Experiment().scenario, observer(dtype)
    return lambda: posegsa.PoseFilter(
        filter,
        rotation=np.diag([1.0, -1.0, -1.0]),
        position=np.zeros(3),
        vector_references=np.array([v.direction for v in scenario.vectors]),
        landmark_references=np.array([p.position for p in scenario.landmarks]),
    )


def microseconds(call: Callable[[], object], count: int) -> np.ndarray:
    """Time of each of `count` calls [us]."""
    times = np.empty(count)
    for i in range(count):
        begin = time.perf_counter()
        call()
        times[i] = time.perf_counter() - begin
    return 1e6 * times


def measured(dtype: str, updates: int) -> dict[str, Any]:
    """Seconds to make the filter the first and the second time, and microseconds per call."""
    make, seconds = made(dtype), []
    for _ in range(2):
        begin = time.perf_counter()
        pose_filter = make()
        seconds.append(time.perf_counter() - begin)
    rng = np.random.default_rng(0)
    omega, v = rng.normal(size=(2, 3))
    vectors, landmarks = rng.normal(size=(2, 3)), rng.normal(size=(1, 3))

    def update() -> object:
        return pose_filter.update(
            time_step=0.01,
            angular_velocity=omega,
            velocity=v,
            vectors=vectors,
            landmarks=landmarks,
        )

    loop = pose_filter._loop
    record = pose_filter._record
    sample = np.full(loop.sample_size, 0.5, dtype)
    update()
    whole, inner = (
        microseconds(update, updates),
        microseconds(lambda: loop(record, sample), updates),
    )
    return helpers(dtype, updates // 10) | {
        "first": seconds[0],
        "second": seconds[1],
        "update": float(np.median(whole)),
        "update 99 %": float(np.quantile(whole, 0.99)),
        "compiled call": float(np.median(inner)),
    }


def helpers(dtype: str, calls: int) -> dict[str, list[float]]:
    """Median times of other calls for one sample, and of the compiled calls in them [us]."""
    filter = observer(dtype)
    controller = cast(posegsa.FuzzyGain, filter.schedule).controller
    rng = np.random.default_rng(0)
    with jax.enable_x64(dtype == "float64"):
        measured = posegsa.Measurements.from_arrays(
            time_step=0.01,
            angular_velocity=rng.normal(size=(100, 3)),
            velocity=rng.normal(size=(100, 3)),
            vectors=rng.normal(size=(100, 2, 3)),
            vector_references=rng.normal(size=(2, 3)),
            landmarks=rng.normal(size=(100, 1, 3)),
            landmark_references=rng.normal(size=(1, 3)),
            dtype=np.dtype(dtype),
        )
        state = filter.start(posegsa.initial_state(np.eye(3), np.zeros(3)), posegsa.Sensors(2, 1))
        sample = measured.at(5)
        step = _step.lower(filter, state, sample, 0.0).compile()
        gain = _compiled_gain.lower(controller, np.asarray(0.2), np.asarray(0.01), None).compile()

        inputs = np.asarray(0.2), np.asarray(0.01)
        pairs: dict[str, list[Callable[[], object]]] = {
            "step": [
                lambda: posegsa.step(filter, state, sample),
                lambda: step(filter, state, sample, 0.0),
            ],
            "controller(error, rate)": [
                lambda: controller(0.2, 0.01),
                lambda: gain(controller, *inputs, None),
            ],
            "Measurements.at": [lambda: measured.at(5), lambda: None],
        }
        return {name: medians(pair, calls) for name, pair in pairs.items()}


def medians(pair: list[Callable[[], object]], calls: int) -> list[float]:
    """Median time of each of two calls [us], by turns, so that disturbances affect both."""
    times = np.empty((calls + 1, len(pair)))
    for row in times:
        for i, call in enumerate(pair):
            begin = time.perf_counter()
            jax.block_until_ready(call())
            row[i] = 1e6 * (time.perf_counter() - begin)
    return np.median(times[1:], axis=0).tolist()  # without the first call, which compiles


def main() -> None:
    """Measure each precision in a separate process."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--updates", type=int, default=20_000)
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE}")
    parser.add_argument("--dtype", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.dtype:
        warnings.simplefilter("ignore", PosegsaWarning)
        print(json.dumps(measured(options.dtype, options.updates)))
        return
    rows = [
        "| precision | one update, median | 99 % | of it compiled | made first | made again |",
        "| --- | --: | --: | --: | --: | --: |",
    ]
    others = ["| call | precision | median | of it compiled |", "| --- | --- | --: | --: |"]
    for dtype in ("float32", "float64"):
        words = [sys.executable, __file__, "--dtype", dtype, "--updates", str(options.updates)]
        found = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
        rows.append(
            f"| {dtype} | {found['update']:.0f} us | {found['update 99 %']:.0f} us | "
            f"{found['compiled call']:.0f} us | {found['first']:.1f} s | {found['second']:.2f} s |"
        )
        for name in ("step", "controller(error, rate)", "Measurements.at"):
            whole, inner = found[name]
            compiled = f"{inner:.0f} us" if name != "Measurements.at" else "nothing"
            others.append(f"| `{name}` | {dtype} | {whole:.0f} us | {compiled} |")
    load = f"load {os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"
    if os.sched_getscheduler(0) == os.SCHED_FIFO:  # set by `chrt -f 10` on a busy machine
        load += ", at real-time priority"
    where = f"{' '.join(cpu())}, jax {jax.__version__}, {load}"
    table = "\n".join(
        [*rows, "", *others, "", f"By `python benchmarks/streams.py --write` ({where})."]
    )
    print(table)
    if options.write:
        write_block("streaming", table, PAGE)


if __name__ == "__main__":
    main()
