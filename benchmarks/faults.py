"""Fault injection: killed runs, damaged checkpoints, full disks, hostile input, with counts.

Each part adds its counts to benchmarks/faults.json, so that a long campaign can be run in parts;
`--write` writes the totals to docs/robustness.md.

    python benchmarks/faults.py --quick
    python benchmarks/faults.py [--kills 100] [--corruptions 2000] [--disks] [--inputs 2000]
                                [--overhead 5] [--seed 0] [--fresh] [--write]
"""

import argparse
import json
import shutil
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from fault_inputs import calls, inputs
from fault_runs import KILLED, disks, kills
from readme import write_block

import posegsa
from posegsa import config

COUNTS = Path(__file__).with_suffix(".json")


def corruptions(wanted: int, rng: np.random.Generator, folder: Path) -> Counter:
    """Checkpoints that are truncated, or have bits flipped or parts zeroed or swapped."""
    from posegsa.errors import DamagedCheckpointError
    from posegsa.saving.checkpoint import read
    from posegsa.saving.checkpointing import newest_checkpoint

    counts: Counter = Counter()
    small = [s for s in KILLED if "search" not in s]
    small += ["search.agents=20", "search.iterations=4", "checkpoint.iterations=1"]
    experiment = config.override(config.Experiment(), small)
    run = folder / "run"
    searched(experiment, run)
    newest, before = sorted((run / "checkpoints").iterdir(), reverse=True)[:2]
    good = newest.read_bytes()
    for _ in range(wanted):
        bad = bytearray(good)
        kind = ("cut short", "bits flipped", "a block zeroed", "bytes put in")[rng.integers(4)]
        place = int(rng.integers(len(good)))
        if kind == "cut short":
            bad = bad[:place]
        elif kind == "bits flipped":
            for i in rng.integers(len(good), size=rng.integers(1, 9)):
                bad[i] ^= 1 << int(rng.integers(8))
        elif kind == "a block zeroed":
            bad[place : place + 512] = bytes(len(bad[place : place + 512]))
        else:
            bad[place:place] = rng.bytes(int(rng.integers(1, 100)))
        if bytes(bad) == good:
            continue
        newest.write_bytes(bad)
        counts[f"checkpoints damaged: {kind}"] += 1
        counts["checkpoints damaged"] += 1
        try:
            read(newest)
            counts["damaged checkpoints accepted"] += 1
        except DamagedCheckpointError:
            pass
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = newest_checkpoint(run).checkpoint.path
        counts["damaged checkpoints passed over for the one before"] += found == before
    counts["damaged checkpoints accepted"] += 0
    return counts


def searched(experiment: config.Experiment, folder: Path) -> None:
    """Search with checkpoints in a folder, without an evaluation."""
    from posegsa.saving.checkpointing import CheckpointWriter
    from posegsa.saving.interrupt import StopRequest
    from posegsa.search.problem import tuning_problem
    from posegsa.search.run_search import run_search

    folder.mkdir(parents=True, exist_ok=True)
    with CheckpointWriter(folder, experiment, StopRequest()) as writer:
        run_search(tuning_problem(experiment), after_chunk=writer)


def overhead(repeats: int, folder: Path) -> dict[str, float]:
    """Time of the default search with and without checkpoints, alternating [s]."""
    from posegsa.saving.checkpointing import CheckpointWriter
    from posegsa.saving.interrupt import StopRequest
    from posegsa.search.problem import tuning_problem
    from posegsa.search.run_search import run_search

    class Counted(CheckpointWriter):
        count = 0

        def _save(self) -> None:
            self.count += 1
            super()._save()

    experiment = config.Experiment()
    task = tuning_problem(experiment)
    count = 0
    times: dict[str, list[float]] = {"with": [], "without": []}
    found = None
    for _ in range(max(1, repeats)):
        times["without"].append(run_search(task).search_seconds)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        with Counted(folder, experiment, StopRequest()) as writer:
            found = run_search(task, after_chunk=writer)
        times["with"].append(found.search_seconds)
        count = writer.count
    least = {name: min(values) for name, values in times.items()}
    # The time of one checkpoint alone, as the difference above is smaller than its noise.
    assert found is not None
    search = found.search
    often = config.override(experiment, ["checkpoint.iterations=1", "search.iterations=1000"])
    saver = CheckpointWriter(folder, often, StopRequest())
    started = time.perf_counter()
    for i in range(20):
        saver(search._replace(iteration=search.iteration + i), 0.0, 0.0)
    one = (time.perf_counter() - started) / 20
    return {
        "search without checkpoints [s]": round(least["without"], 3),
        "search with checkpoints [s]": round(least["with"], 3),
        "one checkpoint [ms]": round(1e3 * one, 2),
        "checkpoints of the default run": count,
        "overhead by that [%]": round(100 * count * one / least["without"], 3),
    }


def table(counts: dict[str, float]) -> str:
    rows = ["| what | count |", "| --- | --- |"]
    return "\n".join([*rows, *(f"| {name} | {value:g} |" for name, value in counts.items())])


def main() -> None:
    parser = argparse.ArgumentParser(description="Faults on purpose, counted.")
    parser.add_argument("--quick", action="store_true", help="a few of each, nothing written")
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--corruptions", type=int, default=0)
    parser.add_argument("--disks", action="store_true")
    parser.add_argument("--inputs", type=int, default=0, help="configurations; as many calls")
    parser.add_argument("--overhead", type=int, default=0, metavar="REPEATS")
    parser.add_argument("--seed", type=int, default=0, help="another piece of the campaign")
    parser.add_argument("--fresh", action="store_true", help="forget what was counted before")
    parser.add_argument("--write", action="store_true", help="write the totals into docs/")
    options = parser.parse_args()
    if options.quick:
        options.kills, options.corruptions, options.disks, options.inputs = 5, 200, True, 200
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    rng = np.random.default_rng(options.seed)
    counted: Counter = Counter()
    measured: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.kills:
            counted += kills(options.kills, rng, folder / "kills")
        posegsa.enable_fast_path()
        if options.corruptions:
            counted.update(corruptions(options.corruptions, rng, folder / "corruptions"))
        if options.disks:
            (folder / "disks").mkdir()
            counted.update(disks(folder / "disks"))
        if options.inputs:
            counted.update(inputs(options.inputs, rng))
            counted.update(calls(options.inputs, rng))
        if options.overhead:
            measured = overhead(options.overhead, folder / "overhead")
    print(table({**counted, **measured}))
    if options.quick:
        return
    before = {} if options.fresh or not COUNTS.exists() else json.loads(COUNTS.read_text("utf-8"))
    totals = {k: before.get(k, 0) + counted.get(k, 0) for k in {**before, **counted}} | measured
    COUNTS.write_text(json.dumps(totals, indent=2) + "\n", encoding="utf-8")
    if options.write:
        write_block("faults", table(totals), "docs/robustness.md")


if __name__ == "__main__":
    main()
