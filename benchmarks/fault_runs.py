"""Faults of whole runs: killed processes and full disks, after which the run is resumed."""

import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from posegsa.cli import command as cli

KILLED = [
    *("scenario.duration=2.0", "cost.steady_window=[150, 199]", "search.agents=100"),
    *("search.iterations=4000", "run.training_scenarios=2", "run.held_out_scenarios=3"),
    "checkpoint.iterations=1",
]
"""A search of many seconds, with a checkpoint after each of its 50 chunks."""
KILLS_A_RUN = 20
FILLED = [*KILLED, "search.iterations=300"]
"""A short search, for disk faults."""


def next_command(folder: Path, chosen: Sequence[str] = KILLED) -> list[str]:
    """The arguments that a user would type next."""
    if any((folder / "checkpoints").glob("*.checkpoint")):
        return ["tune", "--resume", str(folder), "--quiet"]
    settings = [word for setting in chosen for word in ("--set", setting)]
    return ["tune", "--out", str(folder), "--quiet", *settings]


def start_or_resume(folder: Path, chosen: Sequence[str] = KILLED) -> list[str]:
    """`next_command` as a complete command."""
    return [sys.executable, "-m", "posegsa", *next_command(folder, chosen)]


class Forked:
    """The command line in a forked process, which does not load Python and JAX again."""

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
        """Exit status, or None while the process runs."""
        if self.status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.status = os.waitstatus_to_exitcode(status) if pid else None
        return self.status

    def kill(self) -> int:
        """Kill the process unless it has ended; returns its exit status."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
            self.status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        assert self.status is not None
        return self.status


def outcome(folder: Path) -> dict[str, str]:
    """Everything that must agree between two runs: the tables, and the result without times."""
    data = json.loads((folder / "result.json").read_text("utf-8"))
    del data["search"]["search_seconds"], data["search"]["compile_seconds"], data["digest"]
    names = ("history.csv", "trajectory.csv", "evaluation.txt")
    return {"result": json.dumps(data)} | {n: (folder / n).read_text("utf-8") for n in names}


def wait_for(
    process: Forked | subprocess.Popen, folder: Path, pattern: str, seconds: float
) -> bool:
    """Wait until matching files appear or change, or the process ends."""
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
    """Runs that are killed repeatedly, until each has its result."""
    counts: Counter = Counter()
    whole = folder / "whole"
    subprocess.run(start_or_resume(whole), check=True, capture_output=True)
    right = outcome(whole)
    # These imports don't start JAX, so a process forked from here can start it.
    import matplotlib.pyplot  # noqa: F401 - loaded once, before the forks

    import posegsa.evaluating  # noqa: F401 - loaded once, before the forks

    while counts["kills"] < wanted:
        run = folder / f"run{counts['killed runs']}"
        these = min(KILLS_A_RUN, wanted - counts["kills"])
        for i in range(these):
            process = Forked(next_command(run))
            if kill_somewhere(process, run, rng, last=i == these - 1) != -signal.SIGKILL:
                assert process.status == 0
                break  # it had already ended
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


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system of the given size; this requires root."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def disks(folder: Path) -> Counter:
    """Disks that become full, are read-only, or limit the file size."""
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
        with small_disk(folder / "full", "8m") as disk:  # becomes full while the search runs
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
