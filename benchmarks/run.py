"""Speed of posegsa compared with the alternatives: a table, JSON and a figure.

Every contender computes the costs of the same 100 parameter vectors on the same scenario
(configs/paper.toml: 1500 steps, gain limit, exact centroid). Costs are first compared with those of
posegsa; a contender that disagrees is reported as wrong and not timed.

    python benchmarks/run.py [--quick] [--only posegsa] [--readme] [--fuzzylite-python PYTHON]

It takes a minute or two with --quick, up to 9 minutes without. `--only posegsa` compares posegsa
and C only: 100 and 1000 agents, vectors of 16 and of 8 floats (AVX2), and the configuration of
observer.toml, whose filter learns the vector biases. Writes benchmarks/run.json (run-quick.json,
run-posegsa.json); with --readme also README.md, docs/benchmarks.md and benchmarks/scaling.png.
Numba is an extra: pip install ".[bench]". A contender whose tools are missing is skipped, and the
table says so.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import venv
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from contenders import c, numpy_vectorised
from contenders.plain_loop import SLICE
from contenders.scene import Scene, load
from machine import cpu, machine
from readme import write_block
from run_tables import (
    AVX2,
    LIMITLESS,
    NUMBA,
    NUMPY,
    OBSERVER,
    POSEGSA,
    C,
    Row,
    machine_line,
    overview,
    scaling,
    sentences,
    table,
)
from tqdm import tqdm

HERE = Path(__file__).parent
WORKER = HERE / "contenders" / "posegsa_worker.py"
FIGURE = HERE / "scaling.png"
TOLERANCES = {"float32": 1e-3, "float64": 1e-6, "sampled": 1e-3}
"""Relative tolerances of a cost: float32 with other orders of operations; float64; loops whose
library samples the centroid, checked on a slice with 2001 points."""


def wrong(kind: str) -> str:
    """The note of a contender that disagrees."""
    return f"WRONG: costs differ by more than {TOLERANCES[kind]:g}; not timed"


def timed(run: Callable[[], object], seconds: float) -> tuple[float, float]:
    """Best and median time [s] of calls repeated for about `seconds`, at least three times."""
    times: list[float] = []
    while len(times) < 3 or sum(times) < seconds:
        started = perf_counter()
        run()
        times.append(perf_counter() - started)
    return min(times), float(np.median(times))


def worker(*words: object, cache: Path) -> dict[str, Any]:
    """The report of a separate posegsa process; see `contenders/posegsa_worker.py`.

    Raises:
        RuntimeError: The process fails.
    """
    said = subprocess.run(
        [sys.executable, str(WORKER), *map(str, words)],
        capture_output=True,
        text=True,
        env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)},
    )
    if said.returncode:
        raise RuntimeError(f"posegsa_worker.py {' '.join(map(str, words))}: {said.stderr[-2000:]}")
    return json.loads(said.stdout.splitlines()[-1])


class Benchmark:
    """One run of the benchmark: its scene, and the results so far."""

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self.quick, self.only = options.quick, options.only
        self.fuzzylite_python = options.fuzzylite_python
        self.folder = folder
        self.cache = folder / "cache"
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        self.cores = cores or 1
        self.threads = sorted({1, min(2, self.cores), self.cores})
        self.seconds = 0.5 if self.quick else 1.5
        self.rows: list[Row] = []
        self.facts: dict[str, Any] = {"cold": {}, "warm": {}, "search": {}, "memory": {}}
        self.built: Path | None = None
        self.narrow: Path | None = None
        self.wide = "avx512f" in cpu()
        self.c_best: dict[int, float] = {}

    def stages(self) -> list[tuple[str, Callable[[], None]]]:
        """All measurements by name, in order."""
        few = self.quick or self.only is not None
        sizes = (100, 1000) if few else (10, 30, 100, 300, 1000, 3000, 10_000)
        cases: list[dict[str, Any]] = [
            {"agents": agents, "devices": devices}
            for devices in self.threads
            for agents in sizes
            if not self.quick or agents == 100 or devices == self.threads[-1]
        ]
        if not few:
            most = self.threads[-1]
            cases += [{"scenarios": scenarios, "devices": most} for scenarios in (8, 64)]
            cases += [{"dtype": "float64", "devices": devices} for devices in self.threads]
            cases += [{"agents": 1000, "dtype": "float64", "devices": most}]
        if not self.quick:
            both = [(agents, devices) for devices in self.threads for agents in (100, 1000)]
            cases += [{"agents": a, "devices": d, "variant": AVX2} for a, d in both if self.wide]
            cases += [{"devices": devices, "variant": OBSERVER} for devices in self.threads]
        beside_c: list[tuple[str, Callable[[], None]]] = [
            ("scenario", self.make_scene),
            ("C", self.run_c),
            *((f"posegsa {case}", lambda case=case: self.run_posegsa(**case)) for case in cases),
        ]
        if self.only is not None:
            return beside_c
        return [
            *beside_c,
            ("search", self.run_searches),
            ("NumPy", self.run_numpy),
            ("Numba", self.run_numba),
            ("scikit-fuzzy", self.run_scikit_fuzzy),
            ("pyfuzzylite", self.run_fuzzylite),
        ]

    def make_scene(self) -> None:
        """The scenario and posegsa's costs, in float64 and float32."""
        path = self.folder / "scene.npz"
        found = worker("scene", path, cache=self.cache)
        self.scene: Scene = load(path)
        self.costs = {dtype: np.array(costs) for dtype, costs in found["costs"].items()}
        self.jax_version: str = found["jax"]

    def add(self, row: Row, kind: str, run: Callable[[], np.ndarray]) -> bool:
        """Check a contender's costs, then time it; returns whether the costs were right."""
        costs = run().mean(axis=0)
        known = np.resize(self.costs["float32" if kind == "float32" else "float64"], costs.shape)
        difference = float(np.max(np.abs(costs / known - 1)))
        row = replace(row, difference=difference, c_best=self.c_best.get(row.threads))
        if not difference <= TOLERANCES[kind]:  # NaN is wrong
            self.rows.append(replace(row, note=wrong(kind)))
            return False
        best, median = timed(run, self.seconds)
        self.rows.append(replace(row, best=best, median=median))
        return True

    def skip(self, contender: str, why: str) -> None:
        """Note that a contender could not be run."""
        tqdm.write(f"{contender}: skipped, {why}")
        self.rows.append(Row(contender, 1, note=f"skipped: {why}"))

    def run_c(self) -> None:
        """C, as the reference for speed, with and without the gain limit."""
        try:
            library, narrow = (
                c.build(self.folder),
                c.build(self.folder, "avx2") if self.wide else None,
            )
        except RuntimeError as error:
            self.skip(C, str(error))
            return
        for threads in self.threads:
            row = Row(C, threads, dtype="float32")
            if not self.add(row, "float32", c.prepare(self.scene, library, threads)):
                return
            best = self.rows[-1].best
            if best is not None:
                self.c_best[threads] = best
                self.rows[-1] = replace(self.rows[-1], c_best=best)
        self.built, self.narrow = library, narrow
        for threads in self.threads:
            free = c.prepare(replace(self.scene, gain_limit=0.0), library, threads)
            best, median = timed(free, self.seconds)
            note = "not checked: chaotic without the limit"
            row = Row(f"{C}, {LIMITLESS}", threads, dtype="float32", note=note)
            self.rows.append(replace(row, best=best, median=median))

    def _improve_c(self, threads: int, best: float | None) -> None:
        """Update C's best time over the whole run, so that a disturbance doesn't distort ratios."""
        if best is None or best >= self.c_best.get(threads, 0):
            return
        self.c_best[threads] = best
        self.rows = [
            replace(row, best=best, c_best=best)
            if (row.contender, row.threads) == (C, threads)
            else row
            for row in self.rows
        ]

    def run_searches(self) -> None:
        """Time first calls, with an empty cache and in a second process, and the paper's run."""
        cache, most = self.folder / "first", self.threads[-1]
        words = ("search", "--devices", most, "--repeats")
        self.facts["cold"] = worker(*words, 1, cache=cache)
        self.facts["warm"] = worker(*words, 3, cache=cache)
        self.facts["search"][str(most)] = self.facts["warm"]
        if not self.quick and most > 1:
            self.facts["search"]["1"] = worker("search", "--devices", 1, cache=self.cache)

    def run_posegsa(
        self,
        agents: int = 100,
        scenarios: int = 1,
        dtype: str = "float32",
        devices: int = 1,
        variant: str = "",
    ) -> None:
        """Time one size of posegsa, by turns with C."""
        words: list[object] = ["--agents", agents, "--scenarios", scenarios, "--dtype", dtype]
        words += ["--devices", devices, "--seconds", self.seconds]
        words += {AVX2: ["--isa", "avx2"], OBSERVER: ["--observer"]}.get(variant, [])
        built = self.narrow if variant == AVX2 else self.built
        if built is not None:
            words += ["--against", built]
        found = worker("time", *words, cache=self.cache)
        name, of_c = (f"{who}, {variant}" if variant else who for who in (POSEGSA, C))
        sizes = {key: found[key] for key in ("agents", "scenarios", "samples")}
        row = Row(name, devices, dtype=dtype, **sizes)
        # C's costs of the same agents and scenarios, always in float32.
        if not found.get("c_difference", 0.0) <= TOLERANCES["float32"]:
            self.rows.append(replace(row, note=wrong("float32")))
            return
        times = {name: found.get(name) for name in ("best", "median", "c_best")}
        if variant and "c_best" in found:
            c_times = {"best": found["c_best"], "median": found["c_median"]}
            c_row = replace(row, contender=of_c, **c_times, c_best=found["c_best"])
            note = "in 9 of 10 agents; others' starts are chaotic" if variant == OBSERVER else ""
            self.rows.append(replace(c_row, difference=found["c_difference"], note=note))
        self.rows.append(replace(row, **times))
        if variant:
            return
        if (agents, scenarios) == (100, 1):
            self._improve_c(devices, found.get("c_best"))
        if dtype == "float32" and scenarios == 1 and devices == self.threads[-1]:
            self.facts["memory"][str(agents)] = found["peak_bytes"]

    def sized(self, agents: int) -> Scene:
        """The scene with `agents` agents, repeated from its own."""
        shape = (agents, *self.scene.inputs.shape[1:])
        many = {name: np.resize(getattr(self.scene, name), shape) for name in ("inputs", "outputs")}
        return replace(self.scene, **many)

    def run_numpy(self) -> None:
        """NumPy, which uses one core."""
        for agents in (100,) if self.quick else (100, 1000):
            run = numpy_vectorised.prepare(self.sized(agents))
            row = Row(NUMPY, 1, agents)
            if not self.add(row, "float64", run):
                return
            self.rows[-1] = self._with_c(self.rows[-1])

    def run_numba(self) -> None:
        """Numba, on one core and on all cores."""
        try:
            from contenders import numba_parallel
        except ImportError as error:
            self.skip(NUMBA, f'{error} (pip install ".[bench]")')
            return
        for agents in (100,) if self.quick else (100, 1000, 10_000):
            for threads in self.threads:
                run = numba_parallel.prepare(self.sized(agents), threads)
                if not self.add(Row(NUMBA, threads, agents), "float64", run):
                    return
                self.rows[-1] = self._with_c(self.rows[-1])

    def _with_c(self, row: Row) -> Row:
        """The row with C's time for the same number of agents, from posegsa's rows of this run."""
        for other in self.rows:
            same = (other.contender, other.threads, other.agents) == (
                POSEGSA,
                row.threads,
                row.agents,
            )
            if same and other.scenarios == 1 and other.c_best:
                return replace(row, c_best=other.c_best)
        return replace(row, c_best=self.c_best.get(row.threads) if row.agents == 100 else None)

    def run_scikit_fuzzy(self) -> None:
        """The plain loop with scikit-fuzzy, on a slice."""
        name = "plain loop, scikit-fuzzy"
        try:
            from contenders import scikit_fuzzy

            found = scikit_fuzzy.run(self.scene, self.slice_seconds)
        except ImportError as error:
            self.skip(name, f'{error} (pip install ".[test]")')
            return
        self.add_slice(name, found)

    def run_fuzzylite(self) -> None:
        """The plain loop with pyfuzzylite, on a slice, in a separate environment."""
        name, script = "plain loop, pyfuzzylite", HERE / "contenders" / "fuzzylite_loop.py"
        python = self.fuzzylite_python
        try:
            if python is None:
                home = self.folder / "fuzzylite"
                venv.create(home, with_pip=True)
                python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
                _run([python, "-m", "pip", "install", "--quiet", "numpy", "pyfuzzylite"], 180)
            said = _run([python, script, self.folder / "scene.npz", self.slice_seconds], 120)
        except (OSError, subprocess.SubprocessError) as error:
            why = getattr(error, "stderr", None) or str(error)
            self.skip(name, f"no environment for it ({why.strip().splitlines()[-1]})")
            return
        self.add_slice(name, json.loads(said.splitlines()[-1]))

    @property
    def slice_seconds(self) -> float:
        """Measuring time of a slow loop [s]."""
        return 2.0 if self.quick else 10.0

    def add_slice(self, name: str, found: dict[str, Any]) -> None:
        """A row extrapolated from a slice whose costs are checked against NumPy's."""
        part = self.scene.part(**SLICE, agents=len(found["costs"]))
        known = numpy_vectorised.prepare(part)()[0]
        difference = float(np.max(np.abs(np.array(found["costs"]) / known - 1)))
        row = Row(name, 1, difference=difference, c_best=self.c_best.get(1))
        if not difference <= TOLERANCES["sampled"]:
            self.rows.append(replace(row, note=wrong("sampled")))
            return
        note = f"extrapolated from {found['steps']} steps; sampled centroid, 101 points"
        self.rows.append(replace(row, best=found["seconds_per_step"] * row.steps, note=note))


def _run(words: list[object], seconds: float) -> str:
    said = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, timeout=seconds, check=True
    )
    return said.stdout


def page(rows: list[Row], facts: dict[str, Any], about: dict[str, str], command: str) -> str:
    """The table and sentences as Markdown."""
    tolerances = (
        f"A cost that differs from posegsa's by more than {TOLERANCES['float32']:g} (float32) or "
        f"{TOLERANCES['float64']:g} (float64) would be reported as wrong, and not timed; slices "
        f"that are extrapolated are checked to {TOLERANCES['sampled']:g} with 2001 points."
    )
    method = (
        "Times C: the best time over C's best with as many threads; for posegsa both are timed by "
        f"turns in one process. {tolerances} Made by `{command}`."
    )
    parts = [table(rows), "\n".join(f"- {line}" for line in sentences(facts))]
    return "\n\n".join([*filter(None, parts), f"{method} {machine_line(about)}"])


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of posegsa compared with the alternatives.")
    parser.add_argument("--quick", action="store_true", help="fewer sizes, a minute or two")
    parser.add_argument("--only", choices=("posegsa",), help="posegsa and C only")
    parser.add_argument("--readme", action="store_true", help="write README, docs and figure")
    parser.add_argument(
        "--fuzzylite-python",
        type=Path,
        help="a Python that has pyfuzzylite and NumPy (default: a new environment, by pip)",
    )
    options = parser.parse_args()
    if options.readme and (options.quick or options.only):
        parser.error("--readme: needs the whole run, without --quick and --only")
    # Load of other processes: timings are unreliable on a busy machine, above all with all cores.
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    with tempfile.TemporaryDirectory() as folder:
        benchmark = Benchmark(options, Path(folder))
        bar = tqdm(benchmark.stages())
        for name, stage in bar:
            bar.set_description(name)
            stage()
    about = machine(benchmark.jax_version, benchmark.cores, load)
    command = " ".join(["python benchmarks/run.py", *sys.argv[1:]])
    text = page(benchmark.rows, benchmark.facts, about, command)
    print(f"\n{text}")
    name = "run-quick" if options.quick else "run-posegsa" if options.only else "run"
    path = HERE / f"{name}.json"
    rows = [
        asdict(row) | {"nanoseconds_per_agent_and_step": row.nanoseconds, "times_c": row.ratio}
        for row in benchmark.rows
    ]
    found = {"machine": about, "rows": rows, "posegsa": benchmark.facts}
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"\nWritten: {path}")
    if options.readme:
        write_pages(benchmark.rows, benchmark.facts, about, text)


def write_pages(rows: list[Row], facts: dict[str, Any], about: dict[str, str], text: str) -> None:
    """Write README, docs/benchmarks.md and the figure."""
    scaling(rows).savefig(FIGURE, dpi=200)
    write_block("benchmarks", text, "docs/benchmarks.md")
    search = facts["search"][max(facts["search"], key=int)]
    short = (
        f"{overview(rows)}\n\nThe paper's whole run, {search['agents']} agents x "
        f"{search['iterations']} iterations: {search['best']:.2f} s once compiled. "
        f"{machine_line(about)}"
    )
    write_block("benchmarks", short)


if __name__ == "__main__":
    main()
