"""Waiting time of whole commands, each in its own process, cold and warm.

Cold means an empty cache folder; warm means the cache that the cold run left. CPU time is that of
all threads. To measure another version, give the interpreter of an environment in which it is
installed. The table shows both versions, without commands that a version does not have.

    python benchmarks/commands.py [--write]
    python benchmarks/commands.py --python ../old/.venv/bin/python --name 0.5.0 --write
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from machine import machine
from readme import ROOT, write_block
from run_tables import duration

STORED, PAGE = ROOT / "benchmarks" / "commands.json", "docs/benchmarks.md"
EIGHT = """
[run]
training_scenarios = 8
[scenario]
duration = 15.0
[cost]
steady_window = [400, 1400]
[search]
optimiser = "gsa"
agents = 100
iterations = 250
"""
"""Eight scenarios of 15 s, 100 agents, 250 iterations."""
EXAMPLE = """
import posegsa
posegsa.enable_fast_path()
print(posegsa.tune("quick", seed=1).summary())
"""
COMMANDS: dict[str, list[str]] = {
    "posegsa --help": ["-m", "posegsa", "--help"],
    "posegsa tune --seed x": ["-m", "posegsa", "tune", "--seed", "x"],
    "import posegsa": ["-c", "import posegsa"],
    "tune (README's first command)": [
        *("-m", "posegsa", "tune", "--iterations", "20", "--out", "run", "--overwrite"),
    ],
    "tune quick": ["-m", "posegsa", "tune", "quick", "--out", "quick-run", "--overwrite"],
    "tune quick --no-figures": [
        *("-m", "posegsa", "tune", "quick", "--no-figures", "--out", "bare", "--overwrite"),
    ],
    "tune, 8 scenarios of 15 s, 100 x 250": [
        *("-m", "posegsa", "tune", "eight.toml", "--out", "eight", "--overwrite"),
    ],
    "export quick --format c": [
        *("-m", "posegsa", "export", "quick-run", "--format", "c", "--out", "a.h", "--overwrite"),
    ],
    "Python: tune('quick')": ["-c", EXAMPLE],
    "evaluate quick --scenarios 1000": [
        "-m",
        "posegsa",
        "evaluate",
        "quick-run",
        "--scenarios",
        "1000",
    ],
}


def run(python: str, words: list[str], folder: Path, cache: Path) -> tuple[float, float]:
    """CPU time and wall time of a command [s]."""
    dropped = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR")
    inherited = {k: v for k, v in os.environ.items() if k not in dropped}
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [python, *words],
        cwd=folder,
        env=inherited | {"XDG_CACHE_HOME": str(cache)},
        capture_output=True,
        text=True,
    )
    took, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != (2 if "x" in words else 0):
        raise RuntimeError(f"{words}: {done.stderr}")
    return (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime), took


Found = dict[str, dict[str, list[float]]]


def measure(python: str, keep: Callable[[Found], None]) -> None:
    """CPU time and wall time [s] of each command, cold and warm; `keep` is called after each."""
    found: Found = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "eight.toml").write_text(EIGHT, encoding="utf-8")
        for i, (name, words) in enumerate(COMMANDS.items()):
            cache = folder / f"cache-{i}"
            try:
                cold = run(python, words, folder, cache)
                warm = run(python, words, folder, cache)
            except RuntimeError as error:
                print(f"{name}: left out, {error}", flush=True)
                continue
            found[name] = {"cold": list(cold), "warm": list(warm)}
            print(f"{name}: {cold[0]:.2f} s of CPU cold, {warm[0]:.2f} s warm", flush=True)
            keep(found)


def table(stored: dict) -> Iterator[str]:
    """The table of all measured versions."""
    names = list(stored["versions"])
    yield "| command | version | CPU, cold | CPU, warm | time, cold | time, warm |"
    yield "| --- | --- | --: | --: | --: | --: |"
    for command in stored["versions"][names[-1]]:
        for name in names:
            found = stored["versions"][name].get(command)
            if found is None:
                continue
            cells = [duration(found[state][i]) for i in range(2) for state in ("cold", "warm")]
            yield f"| {command} | {name} | {' | '.join(cells)} |"
    about = stored["machine"]
    yield ""
    yield (
        f"Made by `python benchmarks/commands.py --write`. "
        f"{about['cpu']}, {about['cores']} cores; jax {about['jax']}, Python {about['python']}; "
        f"load before {about['load']}; {about['date']}."
    )


def main() -> None:
    """Measure the commands of one version, and show them with those of other versions."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--python", default=sys.executable, help="interpreter that has the version")
    parser.add_argument("--name", help="what the version is called; by default as it says")
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE}")
    options = parser.parse_args()
    asked = "import jax, posegsa.version as v; print(v.VERSION, jax.__version__)"
    said = subprocess.run([options.python, "-c", asked], capture_output=True, text=True, check=True)
    version, jax_version = said.stdout.split()
    load = f"{os.getloadavg()[0]:.1f}"
    stored = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {"versions": {}}
    stored["machine"] = machine(jax_version, len(os.sched_getaffinity(0)), load)

    def keep(found: Found) -> None:
        stored["versions"][options.name or version] = found
        if options.write:
            STORED.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
            write_block("commands", "\n".join(table(stored)), PAGE)

    measure(options.python, keep)
    print("\n".join(table(stored)))


if __name__ == "__main__":
    main()
