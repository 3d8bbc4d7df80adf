"""docs/recordings.md: its commands run; the tables of the results are those of the benchmark."""

import ast
import json
import re
import tomllib
from pathlib import Path

import pytest
import recordings as benchmark

import posegsa
from posegsa.cli import main
from posegsa.recordings.table import COLUMNS

ROOT = Path(__file__).parent.parent.parent
TEXT = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs" / "recordings_results.md").read_text(encoding="utf-8")
DATA = ROOT / "examples" / "data"


def test_the_ten_lines_run(monkeypatch: pytest.MonkeyPatch) -> None:
    code = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)[0]
    statements = ast.parse(code).body
    assert len(statements) <= 10
    # JAX has started already.
    text = code.replace("posegsa.enable_fast_path()\n", "")
    assert text != code
    monkeypatch.chdir(ROOT)
    exec(text, found := {})  # the page's own text
    rmse = posegsa.recording_errors(found["replayed"].estimates, found["flight"]).rmse()["judged"]
    stated = f"errors of {rmse.total:.2f}° and {100 * rmse.position:.1f} cm"
    assert stated in TEXT
    assert "0.4383711" in found["header"]  # a reference of the flight


def test_its_commands_run_on_the_data_of_the_examples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pages = TEXT, (ROOT / "README.md").read_text(encoding="utf-8")
    found = {
        " ".join(command.split("#")[0].split())
        for page in pages
        for command in re.findall(r"posegsa ((?:replay|export)\b[^`\n]*examples/data[^`\n]*)", page)
    }
    assert len(found) == 3
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)  # JAX has started
    for command in found:
        given = command.replace("filter.h", str(tmp_path / "filter.h")).split()
        assert main(given) == 0, command
    out = capsys.readouterr().out
    imu = re.search(r"^broad +judged: motion +\d+ +([\d.]+)", out, re.MULTILINE)
    assert imu is not None
    assert f"the second of {imu[1]}°" in TEXT
    assert (tmp_path / "filter.h").exists()


@pytest.mark.quick
def test_the_filter_that_it_shows_is_the_one_of_the_examples() -> None:
    blocks = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    (shown,) = (block for block in blocks if "[filter]" in block)
    assert tomllib.loads(shown) == tomllib.loads((DATA / "sensors.toml").read_text())


@pytest.mark.quick
def test_the_data_are_attributed() -> None:
    words = (DATA / "README.md").read_text(encoding="utf-8")
    for fact in ("BROAD", "Laidig", "Creative Commons Attribution", "licenses/by/4.0", "Changes"):
        assert fact in words
    assert {path.name for path in DATA.iterdir()} == {
        *("README.md", "broad.npz", "eight.csv", "eight.csv.toml", "sensors.toml")
    }


@pytest.mark.quick
def test_the_page_names_the_usual_columns() -> None:
    for names in COLUMNS.values():
        assert (names if isinstance(names, str) else " ".join(names)) in TEXT


@pytest.mark.quick
@pytest.mark.parametrize("block", ["euroc", "outliers", "speed"])
def test_the_tables_are_those_that_were_measured(block: str) -> None:
    held = json.loads(benchmark.JSON.read_text("utf-8"))
    measured = RESULTS.split(f"<!-- {block}: begin -->")[1].split(f"<!-- {block}: end -->")[0]
    table = {
        "euroc": benchmark.euroc_table,
        "outliers": benchmark.outliers_table,
        "speed": benchmark.speed_table,
    }[block]
    assert table(held[block]) in measured
