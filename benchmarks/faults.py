"""Faults on purpose: killed runs, damaged checkpoints, full disks, hostile input; all counted.

Each part adds what it counted to benchmarks/faults.json, so that a long campaign may be run in
pieces; `--write` puts the totals into docs/robustness.md.

    python benchmarks/faults.py --quick
    python benchmarks/faults.py [--kills 100] [--corruptions 2000] [--disks] [--inputs 2000]
                                [--overhead 5] [--seed 0] [--fresh] [--write]
"""

import argparse
import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from readme import ROOT, write_block

sys.path.insert(0, str(ROOT / "tests"))

import posegsa
from posegsa import cli, config

COUNTS = Path(__file__).with_suffix(".json")
KILLED = [
    *("scenario.duration=2.0", "cost.steady_window=[150, 199]", "search.agents=100"),
    *("search.iterations=4000", "run.training_scenarios=2", "run.held_out_scenarios=3"),
    "checkpoint.iterations=1",
]
"""A search of many seconds that writes a checkpoint after each of its 50 chunks."""
KILLS_A_RUN = 20
FILLED = [*KILLED, "search.iterations=300"]
"""A short one, for disks."""


def next_command(folder: Path, chosen: Sequence[str] = KILLED) -> list[str]:
    """What a person would type next."""
    if any((folder / "checkpoints").glob("*.checkpoint")):
        return ["tune", "--resume", str(folder), "--quiet"]
    settings = [word for setting in chosen for word in ("--set", setting)]
    return ["tune", "--out", str(folder), "--quiet", *settings]


def start_or_resume(folder: Path, chosen: Sequence[str] = KILLED) -> list[str]:
    """The same as a command."""
    return [sys.executable, "-m", "posegsa", *next_command(folder, chosen)]


class Forked:
    """The command line in a process of its own, which need not load Python and JAX again."""

    def __init__(self, arguments: list[str]) -> None:
        self.pid, self.status = os.fork(), None
        if self.pid == 0:
            try:
                with Path(os.devnull).open("w") as nowhere:
                    os.dup2(nowhere.fileno(), 1)
                    os.dup2(nowhere.fileno(), 2)
                os._exit(cli.main(arguments))
            finally:
                os._exit(99)

    def poll(self) -> int | None:
        """How it ended, or None while it runs."""
        if self.status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.status = os.waitstatus_to_exitcode(status) if pid else None
        return self.status

    def kill(self) -> int:
        """Kill it, unless it is done; returns how it ended."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
            self.status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        assert self.status is not None
        return self.status


def outcome(folder: Path) -> dict[str, str]:
    """All that must agree between two runs: the tables, and the result but for its times."""
    data = json.loads((folder / "result.json").read_text("utf-8"))
    del data["search_seconds"], data["compile_seconds"]
    names = ("history.csv", "trajectory.csv", "evaluation.json", "evaluation.txt")
    return {"result": json.dumps(data)} | {n: (folder / n).read_text("utf-8") for n in names}


def wait_for(
    process: Forked | subprocess.Popen, folder: Path, pattern: str, seconds: float
) -> bool:
    """Wait until files like this appear or change, or the process is done."""
    seen = set(folder.glob(pattern))
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and process.poll() is None:
        if set(folder.glob(pattern)) - seen:
            return True
        time.sleep(0.0005)
    return False


def kill_somewhere(process: Forked, run: Path, rng: np.random.Generator, *, last: bool) -> int:
    """Kill a run while it starts, searches or writes a checkpoint; the last time while it saves."""
    where = rng.random()
    if last:
        wait_for(process, run, ".sav*", 120)
        time.sleep(rng.uniform(0, 0.03))
    elif where < 0.1:
        time.sleep(rng.uniform(0, 5))
    else:
        wait_for(process, run, "checkpoints/*.checkpoint", 60)
        if where < 0.6:
            wait_for(process, run, "checkpoints/*.part", 5)
            time.sleep(rng.uniform(0, 0.002))
        else:
            time.sleep(rng.uniform(0, 0.3))
    return process.kill()


def kills(wanted: int, rng: np.random.Generator, folder: Path) -> Counter:
    """Runs that are killed again and again, until each has its result."""
    counts: Counter = Counter()
    whole = folder / "whole"
    subprocess.run(start_or_resume(whole), check=True, capture_output=True)
    right = outcome(whole)
    # None of these starts JAX, so that a process forked from here can.
    import matplotlib.pyplot  # noqa: F401 - loaded before the forks, not in each

    import posegsa.evaluate  # noqa: F401 - likewise

    while counts["kills"] < wanted:
        run = folder / f"run{counts['killed runs']}"
        these = min(KILLS_A_RUN, wanted - counts["kills"])
        for i in range(these):
            process = Forked(next_command(run))
            if kill_somewhere(process, run, rng, last=i == these - 1) != -signal.SIGKILL:
                assert process.status == 0
                break  # it was done before
            counts["kills"] += 1
            counts["kills within a checkpoint's writing"] += any(run.glob("checkpoints/*.part"))
            counts["kills within a result's writing"] += any(run.glob(".sav*"))
        finished = subprocess.run(start_or_resume(run), capture_output=True, text=True)
        assert finished.returncode == 0, finished.stderr
        counts["killed runs"] += 1
        counts["killed runs with the uninterrupted run's bits"] += outcome(run) == right
        shutil.rmtree(run)
        print(dict(counts), flush=True)
    return counts


def corruptions(wanted: int, rng: np.random.Generator, folder: Path) -> Counter:
    """Checkpoints cut short, with bits flipped, or with parts zeroed or swapped."""
    from posegsa import resume
    from posegsa.checkpoint import read
    from posegsa.errors import DamagedCheckpointError

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
            found = resume.begun(run).checkpoint.path
        counts["damaged checkpoints passed over for the one before"] += found == before
    counts["damaged checkpoints accepted"] += 0
    return counts


def searched(experiment: config.Experiment, folder: Path) -> None:
    """Search with checkpoints in a folder, without judging."""
    from posegsa import resume
    from posegsa.interrupt import Asked
    from posegsa.search import make_ready, run_search

    folder.mkdir(parents=True, exist_ok=True)
    with resume.Saver(folder, experiment, Asked()) as keep:
        run_search(make_ready(experiment), keep=keep)


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system of this size; only root can make one."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def disks(folder: Path) -> Counter:
    """Disks that are full from some moment on, read-only, or allow no large file."""
    counts: Counter = Counter()
    whole = folder / "whole"
    subprocess.run(start_or_resume(whole, FILLED), check=True, capture_output=True)
    right = outcome(whole)

    def tried(name: str, run: Path, **options) -> subprocess.CompletedProcess:
        done = subprocess.run(
            start_or_resume(run, FILLED), capture_output=True, text=True, **options
        )
        assert "Traceback" not in done.stderr, done.stderr
        counts[f"{name}: tried"] += 1
        print(dict(counts), done.returncode, flush=True)
        return done

    def recovered(name: str, run: Path) -> None:
        done = subprocess.run(start_or_resume(run, FILLED), capture_output=True, text=True)
        counts[f"{name}: same bits once there is room"] += (
            done.returncode == 0 and outcome(run) == right
        )

    if os.geteuid() != 0:
        print("full and read-only disks: skipped, only root can mount them")
    else:
        for size in ("64k", "256k", "1m"):
            with small_disk(folder / f"disk{size}", size) as disk:
                done = tried("full disk", disk / "run")
                counts["full disk: told, result shown"] += (
                    done.returncode in (1, 2) and "cannot be written" in done.stderr
                )
                assert done.returncode == 2 or "k = [" in done.stdout
                assert not (disk / "run" / "result.json").exists()
                subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
                recovered("full disk", disk / "run")
        with small_disk(folder / "full", "8m") as disk:  # full while the search runs
            process = subprocess.Popen(
                start_or_resume(disk / "run", FILLED),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            wait_for(process, disk / "run", "checkpoints/*.checkpoint", 60)
            with contextlib.suppress(OSError), (disk / "ballast").open("wb") as ballast:
                while True:
                    ballast.write(bytes(4096))
                    ballast.flush()
            said = process.communicate()
            counts["disk that fills: tried"] += 1
            counts["disk that fills: the search went on, the result was shown"] += (
                process.returncode == 1 and "k = [" in said[0] and "goes on" in said[1]
            )
            (disk / "ballast").unlink()
            recovered("disk that fills", disk / "run")
        with small_disk(folder / "readonly", "8m") as disk:
            subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
            done = tried("read-only disk", disk / "run")
            counts["read-only disk: refused before the search"] += (
                done.returncode == 2 and "cannot be written" in done.stderr
            )
    for limit in (1000, 200_000):
        run = folder / f"limit{limit}"
        done = tried(
            "limit on the size of files",
            run,
            preexec_fn=lambda limit=limit: resource.setrlimit(
                resource.RLIMIT_FSIZE, (limit, limit)
            ),
        )
        counts["limit on the size of files: told"] += (
            done.returncode in (1, 2) and "cannot be written" in done.stderr
        )
        recovered("limit on the size of files", run)
    return counts


STRUCTURES = (
    (),
    ("gsa.random=agent", "gsa.bounds=clip", "gsa.force_power=2.0"),
    ("search.optimiser=random_search", "objective.name=worst", "filter.gain_limit=off"),
    ("filter.law=printed", "gain.signal=pose", "fuzzy.no_rule=midrange"),
    ("fuzzy.centroid=sampled", "fuzzy.ordering=false", "fuzzy.coverage=false"),
    ("run.dtype=float64", "objective.name=cvar", "gsa.bounds=reflect"),
    ("search.optimiser=pso", "objective.name=mean_std"),
    ("search.optimiser=de", "search.agents=4"),
)
"""What is compiled; the numbers in it are drawn by the hundred."""
TUNED_STRUCTURES = 12
"""Those that are tuned whole in one piece of the campaign: the first ones, in which most
configurations fall. What a whole tune compiles takes some ten seconds, and a search alone three."""
WRITTEN = 10
"""One of so many whole tunes is written to a folder and read back, for seconds too."""


def inputs(wanted: int, rng: np.random.Generator) -> Counter:
    """Configurations: refused in words, or run to a result without NaN, all of them."""
    import generated
    import jax

    from posegsa.errors import PosegsaError
    from posegsa.search import make_ready, run_search

    names = ("configurations tuned whole", "of these written and read back")
    names += ("configurations searched only", "results with NaN", "other exceptions")
    counts: Counter = Counter(dict.fromkeys(names, 0))
    tiny = [
        *("scenario.duration=0.3", "cost.steady_window=[10, 29]", "cost.transient_window=[0, 5]"),
        *("search.agents=3", "search.iterations=2", "run.training_scenarios=2"),
        "run.held_out_scenarios=3",
    ]
    bases = [config.override(config.Experiment(), [*tiny, *s]) for s in STRUCTURES]
    whole: dict[tuple, bool] = {}
    while counts["configurations"] < wanted:
        base = bases[rng.integers(len(bases))]
        counts["configurations"] += 1
        try:
            experiment = config.from_dict(generated.configuration(rng, base))
        except PosegsaError:
            counts["configurations refused by name"] += 1
            continue
        try:
            with jax.enable_x64(experiment.run.dtype == "float64"):
                task = make_ready(experiment)
                kind = generated.structure(task)
                found = None
                if not whole.setdefault(kind, len(whole) < TUNED_STRUCTURES):
                    found = run_search(task).search
            if found is None:
                nan, best = tuned_whole(experiment, counts)
            else:
                counts["configurations searched only"] += 1
                best = float(found.best_cost)
                numbers = (best, found.best_position, found.history.best)
                nan = any(np.isnan(a).any() for a in numbers)
        except PosegsaError:
            counts["configurations refused by name"] += 1
            continue
        counts["configurations run"] += 1
        counts["results with NaN"] += nan
        counts["configurations run, no agent with a finite cost"] += int(np.isinf(best))
    return counts  # other exceptions would have ended the campaign


def tuned_whole(experiment: config.Experiment, counts: Counter) -> tuple[bool, float]:
    """Tune, sometimes with a folder; whether something is NaN, and the best cost."""
    import generated

    count = "configurations tuned whole"
    if counts[count] % WRITTEN == 0:
        with tempfile.TemporaryDirectory() as folder:
            posegsa.tune(experiment, out=folder)
            result = posegsa.load(folder)
        counts["of these written and read back"] += 1
    else:
        result = posegsa.tune(experiment)
    counts[count] += 1
    return bool(generated.not_numbers(result)), result.best_cost


def calls(wanted: int, rng: np.random.Generator, folder: Path) -> Counter:
    """Calls of public functions: refused in words, or answered."""
    import generated
    from test_bad_input import some_result

    from posegsa.errors import PosegsaError

    counts: Counter = Counter()
    result = some_result()
    while counts["calls"] < wanted:
        counts["calls"] += 1
        try:
            generated.call(rng, result).make()
            counts["calls answered"] += 1
        except PosegsaError:
            counts["calls refused by name"] += 1
    return counts


def overhead(repeats: int, folder: Path) -> dict[str, float]:
    """Time of the default search with and without checkpoints, alternating [s]."""
    from posegsa import resume
    from posegsa.interrupt import Asked
    from posegsa.search import make_ready, run_search

    experiment = config.Experiment()
    task = make_ready(experiment)
    times: dict[str, list[float]] = {"with": [], "without": []}
    found = None
    for _ in range(max(1, repeats)):
        times["without"].append(run_search(task).search_seconds)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        with resume.Saver(folder, experiment, Asked()) as keep:
            found = run_search(task, keep=keep)
        times["with"].append(found.search_seconds)
    least = {name: min(values) for name, values in times.items()}
    # What a checkpoint takes, by itself: the difference above is smaller than its noise.
    assert found is not None
    search = found.search
    often = config.override(experiment, ["checkpoint.iterations=1", "search.iterations=1000"])
    saver = resume.Saver(folder, often, Asked())
    begun = time.perf_counter()
    for i in range(20):
        saver(search._replace(iteration=search.iteration + i), 0.0, 0.0)
    one = (time.perf_counter() - begun) / 20
    return {
        "search without checkpoints [s]": round(least["without"], 3),
        "search with checkpoints [s]": round(least["with"], 3),
        "one checkpoint [ms]": round(1e3 * one, 2),
        "checkpoints of the default run": 4,
        "overhead by that [%]": round(100 * 4 * one / least["without"], 3),
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
            counted.update(calls(options.inputs, rng, folder))
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
