"""A population on a GPU: as one kernel, by XLA's loop over time, and on the CPU of that machine.

    python benchmarks/gpu.py     # five minutes, most of them to compile
    python benchmarks/gpu.py --experiment recommended --agents 32 320

Prints a table: milliseconds for all agents of an experiment, by default configs/paper.toml with one
scenario (1500 steps), on its training scenarios, best of the repeats; and how far the costs of the
kernel are from those of the CPU. Each column runs in a process of its own, in float32, with the
same random agents. A Kalman filter is too large for a kernel, so its first two columns are alike.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from contenders.posegsa_worker import on_all_devices
from tqdm import tqdm

import posegsa
from posegsa import config
from posegsa.model import loops
from posegsa.search import population
from posegsa.search.problem import tuning_problem
from posegsa.words import text_table

AGENTS = (100, 1000, 10_000, 100_000)
COLUMNS = {"kernel": "one kernel", "loop": "XLA's loop", "cpu": "CPU"}
SECONDS, LEAST = 1.0, 3
"""Time for the repeats of a population, and their least number."""


def measure(column: str, experiment: str, populations: Sequence[int], folder: Path) -> None:
    """Store the first time and those of the repeats [s] of each population, and its costs."""
    posegsa.enable_fast_path()
    if column == "loop":
        for module in (loops, population):
            vars(module)["on_gpu"] = lambda: False
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    for agents in populations:
        settings = ["run.dtype=float32", f"search.agents={agents}"]
        problem = tuning_problem(config.override(config.load(experiment), settings))
        lower, upper = map(np.asarray, problem.space.box)
        unit = np.random.default_rng(1).uniform(size=(agents, len(lower)))
        vectors = (lower + (upper - lower) * unit).astype(np.float32)
        evaluate, times = on_all_devices(problem), []
        while len(times) < 1 + LEAST or sum(times[1:]) < SECONDS:
            started = time.perf_counter()
            costs = np.asarray(evaluate(vectors))
            times.append(time.perf_counter() - started)
        np.savez(folder / f"{column}_{agents}.npz", times=times, costs=costs)


def table(populations: Sequence[int], folder: Path) -> str:
    """The table of what was measured."""
    rows = []
    for agents in populations:
        found = {one: np.load(folder / f"{one}_{agents}.npz") for one in COLUMNS}
        best = [f"{1e3 * min(one['times'][1:]):.1f}" for one in found.values()]
        off = np.abs(found["kernel"]["costs"] / found["cpu"]["costs"] - 1)
        first = f"{found['kernel']['times'][0]:.0f}"
        rows.append([str(agents), *best, f"{np.median(off):.0e}", f"{np.max(off):.0e}", first])
    heads = ["agents", *(f"{name} [ms]" for name in COLUMNS.values())]
    return text_table([[*heads, "median off", "at most", "first call [s]"], *rows])


def main() -> None:
    """Measure all columns and print the table."""
    parser = argparse.ArgumentParser(description="A population on a GPU and on CPUs.")
    parser.add_argument("--experiment", default="paper", help="its name, or a TOML file")
    parser.add_argument("--agents", type=int, nargs="+", default=AGENTS, help="populations")
    parser.add_argument("--column", choices=COLUMNS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.column:
        measure(options.column, options.experiment, options.agents, options.folder)
        return
    if jax.default_backend() != "gpu":
        sys.exit(f"JAX runs on {jax.default_backend()} here; this benchmark needs a GPU")
    device = jax.devices()[0].device_kind
    with tempfile.TemporaryDirectory() as folder:
        for column in tqdm(COLUMNS, desc="columns"):
            own = {"JAX_PLATFORMS": "cpu"} if column == "cpu" else {}
            # The process above has a context on the GPU, and needs none of its memory.
            own["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
            words = ["--column", column, "--folder", folder, "--experiment", options.experiment]
            words += ["--agents", *map(str, options.agents)]
            subprocess.run([sys.executable, __file__, *words], check=True, env=os.environ | own)
        print(f"{device}, {len(os.sched_getaffinity(0))} cores, jax {jax.__version__}")
        print(table(options.agents, Path(folder)))


if __name__ == "__main__":
    main()
