"""A population of invariant Kalman filters: posegsa compared with hand-written C.

100 candidates that differ in the sensors' four noises, on configs/paper.toml (two vectors, one
landmark, 1500 samples), with 12 and with 18 states, on one core and on two. Each size runs in a
process of its own, which is pinned to its cores and times both by turns.

    python benchmarks/kalman_beside_c.py [--write]

Some minutes, most of them for compiling. With --write the table goes into docs/benchmarks.md.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from contenders import kalman_population
from contenders.posegsa_worker import on_all_devices, task_of, timed, use_devices
from machine import machine
from readme import write_block
from run_tables import duration, machine_line, number

from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.search.candidates import SearchSpace, without_schedule
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import training_keys
from posegsa.search.problem import TuningProblem

AGENTS = 100
ASSUMED = {
    "angular_velocity": 0.02,
    "velocity": 0.01,
    "angular_walk": 0.003,
    "linear_walk": 0.003,
    "vector_walk": 0.005,
    "vector": 0.1,
    "landmark": 0.1,
    "initial_attitude": 1.5,
    "initial_position": 5.0,
    "initial_angular_bias": 0.1,
    "initial_linear_bias": 0.3,
    "initial_vector_bias": 0.1,
}
"""`KalmanNoise`."""
SEARCHED = ("angular_velocity", "velocity", "vector", "landmark")
"""The numbers in which candidates differ, by up to FACTOR either way."""
FACTOR = 3.0
TOLERANCE = 1e-3
"""Relative tolerance of the mean cost."""
PAIRS = 150
"""Number of alternating runs of both."""


def task_of_filters(states: int) -> tuple[TuningProblem, jax.Array, KalmanFilter]:
    """The experiment with filters of 12 or 18 states; vectors (A, 4) and the filters of these."""
    task = task_of("float32", agents=AGENTS)
    filter = KalmanFilter(
        KalmanNoise(**{name: jnp.float32(value) for name, value in ASSUMED.items()}), states > 12
    )
    e = task.experiment
    seeds = training_keys(e.run.seed, e.run.training_scenarios)
    made = scenario_batch(e, seeds, filter)
    middle = jnp.log(jnp.asarray([ASSUMED[name] for name in SEARCHED], jnp.float32))
    lower, upper = middle - np.log(FACTOR), middle + np.log(FACTOR)
    logarithmic = (True,) * len(SEARCHED)
    space = SearchSpace(without_schedule("float32"), lower, upper, SEARCHED, logarithmic)
    vectors = jax.random.uniform(
        jax.random.key(1), (AGENTS, len(SEARCHED)), minval=lower, maxval=upper
    )
    filters = jax.vmap(lambda vector: space.candidate(vector).applied(filter))(vectors)
    of_all = jax.tree.map(lambda noise: jnp.broadcast_to(noise, (AGENTS,)), filters)
    training: Any = made._replace(filter=filter)
    return task._replace(training=training, space=space), vectors, of_all


def measure(states: int, cores: int, folder: Path) -> dict[str, Any]:
    """Compile both, compare their costs, and time them by turns."""
    use_devices(cores)
    task, vectors, filters = task_of_filters(states)
    evaluate = on_all_devices(task)
    by_hand = kalman_population.prepare(
        task.training, filters, kalman_population.build(folder, states), cores
    )
    known = by_hand().mean(axis=0)
    started = time.perf_counter()
    costs = np.asarray(evaluate(vectors))
    first = time.perf_counter() - started
    mean = float(abs(np.mean(known) / np.mean(costs) - 1))
    found: dict[str, Any] = {"states": states, "cores": cores, "first_call": first}
    found |= {"jax": jax.__version__, "mean_off": mean, "mean_cost": float(np.mean(costs))}
    found |= {"largest_off": float(np.max(np.abs(known / costs - 1)))}
    if not mean <= TOLERANCE:  # NaN is wrong
        raise RuntimeError(f"C's mean cost is off by {mean:.1e}, relative")
    runs = {"posegsa": lambda: np.asarray(evaluate(vectors)), "C": by_hand}
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(PAIRS):
        for name, run in runs.items():
            times[name] += timed(run, 0)
            time.sleep(0.01)  # OpenMP's threads wait actively for a while
    simulated = AGENTS * task.training.samples.time.size
    for name, taken in times.items():
        found[name] = [1e9 * float(f(taken)) / simulated for f in (np.min, np.median)]
    return found


def table(all_found: list[dict[str, Any]]) -> str:
    """The results as a Markdown table."""
    lines = [
        "| states | cores | posegsa [ns] | C [ns] | times C | costs differ by, mean (largest) "
        "| first call |",
        "| --: | --: | --: | --: | --: | --: | --: |",
    ]
    for found in all_found:
        taken = ["{} ({})".format(*map(number, found[name])) for name in ("posegsa", "C")]
        ratio = [number(a / b) for a, b in zip(found["posegsa"], found["C"], strict=True)]
        off = f"{found['mean_off']:.0e} ({found['largest_off']:.0e})"
        cells = [found["states"], found["cores"], *taken, "{} ({})".format(*ratio), off]
        cells += [duration(found["first_call"])]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Kalman filters, posegsa's beside C.")
    parser.add_argument("--write", action="store_true", help="write it into docs/benchmarks.md")
    parser.add_argument("--one", nargs=2, type=int, metavar=("STATES", "CORES"), help="this alone")
    options = parser.parse_args()
    if options.one:
        with tempfile.TemporaryDirectory() as folder:
            states, cores = options.one
            print(json.dumps(measure(states, cores, Path(folder))))
        return
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    all_found = []
    for states in (12, 18):
        for used in sorted({1, min(2, cores)}):
            words = [sys.executable, __file__, "--one", str(states), str(used)]
            said = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True).stdout
            all_found.append(json.loads(said.splitlines()[-1]))
    about = machine(all_found[0]["jax"], cores, load)
    text = (
        f"{table(all_found)}\n\nNanoseconds a filter and sample, best (median) of {3 * PAIRS} "
        f"calls of each by turns. First call: posegsa's, compiling included. Made by `python "
        f"benchmarks/kalman_beside_c.py --write`. {machine_line(about)}"
    )
    print(text)
    if options.write:
        write_block("kalman", text, "docs/benchmarks.md")


if __name__ == "__main__":
    main()
