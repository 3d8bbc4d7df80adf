"""docs/recordings.md: its ten lines run, and its tables are those of the benchmark."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
import recordings as benchmark
from helpers.recordings import LANDMARKS, motion

import posegsa
from posegsa.recordings.table import COLUMNS

ROOT = Path(__file__).parent.parent.parent
TEXT = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
TINY = """
[filter]
vector_bias = "off"
cross_vector = false
substeps = 1
[parameters]
also = []
[search]
optimiser = "random_search"
agents = 8
iterations = 2
"""


def test_the_ten_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    statements = ast.parse(code).body
    assert len(statements) <= 10
    # Without the Kalman filter, which takes most of the compile time, and without the fast path.
    left_out = "posegsa.enable_fast_path()", "print(posegsa.evaluate"
    kept = [ast.unparse(one) for one in statements if not ast.unparse(one).startswith(left_out)]
    assert len(kept) == len(statements) - 2
    given = motion()
    q = posegsa.tum_text(np.arange(400) / 100, given["truth_rotation"], given["truth_position"])
    table = np.array([line.split() for line in q.splitlines()], float)
    time, P, quaternion = table[:, :1], table[:, 1:4], np.roll(table[:, 4:], 1, axis=1)
    columns = [
        time,
        given["angular_velocity"],
        given["velocity"],
        given["landmarks"].reshape(400, 9),
    ]
    names = "t gx gy gz vx vy vz ax ay az bx by bz cx cy cz qw qx qy qz x y z"
    rows = np.concatenate([*columns, quaternion, P], axis=1)
    np.savetxt(
        tmp_path / "flight.csv", rows, delimiter=",", header=names.replace(" ", ","), comments=""
    )
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "landmarks.toml").write_text(TINY)
    text = "\n".join(kept).replace("[[4, 0, 1], [0, 4, 1], [-4, 0, 2]]", str(LANDMARKS.tolist()))
    text = text.replace("window(0, 40)", "window(0, 2)").replace("window(40)", "window(2)")
    monkeypatch.chdir(tmp_path)
    exec(text, found := {})  # the page's own text
    assert isinstance(found["result"], posegsa.Result)
    assert (tmp_path / "run" / "result.json").exists()


@pytest.mark.quick
def test_the_page_names_the_usual_columns() -> None:
    for names in COLUMNS.values():
        assert (names if isinstance(names, str) else " ".join(names)) in TEXT


@pytest.mark.quick
@pytest.mark.parametrize("block", ["euroc", "outliers", "speed"])
def test_the_tables_are_those_that_were_measured(block: str) -> None:
    held = json.loads(benchmark.JSON.read_text("utf-8"))
    measured = TEXT.split(f"<!-- {block}: begin -->")[1].split(f"<!-- {block}: end -->")[0]
    table = {
        "euroc": benchmark.euroc_table,
        "outliers": benchmark.outliers_table,
        "speed": benchmark.speed_table,
    }[block]
    assert table(held[block]) in measured
