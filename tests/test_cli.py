"""The command line as a person types it: fresh processes, exit status, and what they read."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from test_tuning import TINY

SETTINGS = [word for setting in TINY for word in ("--set", setting)]


def posegsa(*arguments: str, cwd=None, as_module: bool = True) -> subprocess.CompletedProcess[str]:
    command = (
        [sys.executable, "-m", "posegsa"]
        if as_module
        else [str(Path(sys.executable).with_name("posegsa"))]
    )
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    return subprocess.run(
        [*command, *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """`posegsa tune` without CONFIG in an empty folder."""
    folder = tmp_path_factory.mktemp("anywhere")
    return folder, posegsa("tune", "--seed", "3", *SETTINGS, cwd=folder)


def test_tune_runs_from_any_folder(finished):
    folder, done = finished
    assert done.returncode == 0, done.stderr
    assert "held out" in done.stdout
    assert "Written to posegsa-run" in done.stdout
    data = json.loads((folder / "posegsa-run" / "result.json").read_text())
    assert data["config"]["run"]["seed"] == 3
    assert data["config"]["search"]["agents"] == 6


def test_it_shows_progress_and_notes_in_plain_words(finished):
    _, done = finished
    assert "best cost" in done.stderr
    assert "4/4" in done.stderr
    assert done.stderr.count("note: scenario.initial_rotation_estimate") == 1
    assert "Traceback" not in done.stderr
    assert "Warning" not in done.stderr


def test_a_second_run_does_not_replace_the_first(finished):
    folder, _ = finished
    before = (folder / "posegsa-run" / "result.json").read_bytes()
    refused = posegsa("tune", *SETTINGS, cwd=folder)
    assert refused.returncode == 2
    assert "holds a run already" in refused.stderr
    assert "--overwrite" in refused.stderr
    assert (folder / "posegsa-run" / "result.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tune", "missing.toml"], ["missing.toml", "no such file"]),
        (["tune", "--set", "filter.substep=4"], ["filter.substep", "substeps"]),
        (["tune", "--set", "run.dtype=float16"], ["run.dtype", "float16", "float32", "float64"]),
        (["tune", "--set", "scenario.velocity_noise=-0.1"], ["scenario.velocity_noise", "-0.1"]),
        (["tune", "--seed", "-1"], ["run.seed", "-1"]),
    ],
)
def test_bad_input_is_one_readable_message(tmp_path, arguments, words):
    done = posegsa(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    for word in words:
        assert word in done.stderr
    assert "Traceback" not in done.stderr
    assert not any(tmp_path.iterdir()), "a refused command leaves nothing behind"


def test_the_command_is_installed_and_helps():
    done = posegsa("--help", as_module=False)
    assert done.returncode == 0
    assert "tune" in done.stdout
