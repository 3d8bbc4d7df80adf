"""The README: its example runs, its files exist, its commands parse."""

import re
from pathlib import Path

import pytest
from helpers.experiments import tiny

from posegsa import config
from posegsa.cli.command import parser

ROOT = Path(__file__).parent.parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_the_example_runs_and_is_short(tmp_path, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 20
    small = tmp_path / "tiny.toml"
    small.write_text(config.to_toml(tiny()), encoding="utf-8")
    names: dict = {}
    exec(code.replace('"quick"', repr(str(small))), names)  # the README's own text
    # It converges; with a smaller search than the README's it is less accurate.
    error = names["error"]
    assert error[0] == pytest.approx(120)
    assert error[-1] < 1
    assert capsys.readouterr().out.endswith(f"from 120 to {error[-1]:.2f} degrees\n")


def test_files_that_it_names_exist():
    for path in re.findall(r"`((?:configs|benchmarks|tests|docs)/[\w./]+)`", TEXT):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"\]\(([\w./]+)\)", TEXT):
        assert (ROOT / path).exists(), path


def test_commands_that_it_names_parse():
    commands = re.findall(r"\.venv/bin/posegsa ([^\n#]*)", TEXT)
    assert len(commands) >= 3
    for command in commands:
        parser().parse_args(command.split())


def test_the_results_are_there():
    page = (ROOT / "docs" / "which_filter.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"<!-- families: begin -->(.*?)<!-- families: end -->", page, re.DOTALL)
    for words in ("recommended", "observer", "`kalman`", "clairvoyant", "any start", "noise"):
        assert words in block
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"<!-- overview: begin -->(.*?)<!-- overview: end -->", page, re.DOTALL)
    for words in ("tuned filter", "best constant gains", "random search", "invariant EKF"):
        assert words in block
    for words in ("paper_literal", "best time switch", "training cost", "tuned for"):
        assert words in page.split("<!-- results: begin -->")[1]
