"""The tutorials of a recording and of a device, followed to the letter.

The files that they say to save are saved, and their commands are run, in their order.
"""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from helpers.compiled_c import needs_cc

from posegsa.cli import main

ROOT = Path(__file__).parents[2]


def follow(page: str, folder: Path) -> dict:
    """The names that the page's programs define."""
    text = (ROOT / "docs" / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
    files = iter(re.findall(r"as `([\w.]+\.(?:py|c))`", text))
    (folder / "examples").symlink_to(ROOT / "examples")
    names: dict = {}
    for kind, block in re.findall(r"```(\w+)\n(.*?)```", text, re.DOTALL):
        if kind != "bash":
            # JAX has started already.
            block = block.replace("posegsa.enable_fast_path()\n", "")
            (folder / next(files)).write_text(block, encoding="utf-8")
            continue
        for line in block.splitlines():
            match shlex.split(line):
                case ["posegsa", *words]:
                    assert main(words) == 0, line
                case ["python", name]:
                    exec((folder / name).read_text(encoding="utf-8"), names)
                case words:
                    subprocess.run(words, cwd=folder, check=True)
    return names


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)
    return tmp_path


def test_my_recording(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = follow("my_recording", folder)
    assert "No mistake was found" in capsys.readouterr().out
    true = names["flight"].truth.position[1000]
    assert abs(names["pose"].position - true).max() < 0.1
    assert {path.name for path in folder.iterdir()} >= {"replayed", "filter.h"}


@needs_cc
def test_my_imu_on_a_device(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = follow("imu_on_a_device", folder)
    assert "0.87     0.79         0.38" in capsys.readouterr().out
    assert names["apart"].max() < 0.01  # degrees, as the page says
