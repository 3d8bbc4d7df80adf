"""docs/tutorials/study_on_a_cluster.md: its script, with tasks that are killed and run again."""

import csv
import os
import random
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.experiments import tiny

from posegsa import config

PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "study_on_a_cluster.md"
SCRIPT, MERGE = re.findall(r"```bash\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1:]
TASKS = 2


@pytest.fixture
def cluster(tmp_path: Path) -> Path:
    """A folder as the page describes it, with a tiny study and an environment that has posegsa."""
    (tmp_path / "study.toml").write_text(config.to_toml(tiny("search.agents=4")), encoding="utf-8")
    (tmp_path / "study.sh").write_text(SCRIPT, encoding="utf-8")
    (tmp_path / "merge.sh").write_text(f". .venv/bin/activate\n{MERGE}", encoding="utf-8")
    commands = tmp_path / ".venv" / "bin"
    commands.mkdir(parents=True)
    command = commands / "posegsa"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m posegsa "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    (commands / "activate").write_text(f'PATH="{commands}:$PATH"\n', encoding="utf-8")
    return tmp_path


def started(cluster: Path, script: str, task: int = 1, of: int = 1) -> subprocess.Popen:
    """A script of the page, in a process group of its own, as a task of an array."""
    given = {"SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_TASK_COUNT": str(of)}
    return subprocess.Popen(
        ["bash", script], cwd=cluster, env=os.environ | given, start_new_session=True
    )


def ended(job: subprocess.Popen) -> None:
    assert job.wait() == 0


def killed(job: subprocess.Popen) -> None:
    os.killpg(job.pid, 9)
    job.wait()


def table_and_runs(folder: Path) -> tuple[bytes, list[dict[str, str]]]:
    """The table of a study, and its single runs but for the time that they took."""
    with (folder / "runs.csv").open(encoding="utf-8", newline="") as file:
        runs = list(csv.DictReader(file))
    assert all(run.pop("search_seconds") for run in runs)
    return (folder / "sweep.csv").read_bytes(), runs


def test_killed_tasks_come_to_the_table_of_one_machine(cluster: Path) -> None:
    ended(started(cluster, "study.sh"))
    table, runs = table_and_runs(cluster / "study" / "1")
    assert len(runs) == 24
    shutil.rmtree(cluster / "study")

    def saved(task: int) -> int:
        return len(list((cluster / "study" / str(task)).rglob("*.json")))

    # The first task is killed at a random time, and once more after some of its runs are saved.
    job = started(cluster, "study.sh", 1, TASKS)
    time.sleep(random.uniform(0.2, 3.0))
    killed(job)
    job = started(cluster, "study.sh", 1, TASKS)
    while job.poll() is None and saved(1) < 4:
        time.sleep(0.01)
    killed(job)
    for task in range(1, TASKS + 1):
        ended(started(cluster, "study.sh", task, TASKS))
    ended(started(cluster, "merge.sh"))
    assert table_and_runs(cluster / "merged") == (table, runs)
