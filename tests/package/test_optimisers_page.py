"""docs/optimisers.md: its examples run, and the commands and files it names exist."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from optimisers import FILTER, FUNCTIONS, ON_FUNCTIONS, SPENT, VARIANTS, registered

from posegsa.cli.command import parser

ROOT = Path(__file__).parent.parent.parent
TEXT, RESULTS = (
    (ROOT / "docs" / name).read_text(encoding="utf-8")
    for name in ("optimisers.md", "optimisers_results.md")
)


def test_the_examples_run_and_find_what_they_say() -> None:
    names: dict = {}
    for code in re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL):
        exec(code, names)  # the page's own text
    np.testing.assert_allclose(names["found"].best_position, [2, 0.3, 2.5], rtol=0.05)
    assert names["found"].best_cost < 0.004
    assert names["at_bench"].best_cost <= 1e-3
    assert names["climbed"].best_cost < 0.01


def test_the_list_is_that_of_the_optimisers() -> None:
    """`python benchmarks/optimisers.py list` writes it."""
    assert f"<!-- optimisers: begin -->\n{registered()}\n<!-- optimisers: end -->" in TEXT


def test_commands_and_files_that_it_names() -> None:
    for command in re.findall(r"`posegsa ((?:tune|compare) [^`]*)`", TEXT + RESULTS):
        words = command.replace("[CONFIG]", "configs/paper.toml").split()
        parser().parse_args(words)
    for path in re.findall(r"\]\(\.\./([\w./]+)\)", TEXT + RESULTS):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize(
    ("block", "named"),
    [
        ("comparison", FILTER),
        ("variants", VARIANTS),
        ("scenarios", [f"{name} | {count}" for name, count in SPENT]),
        ("functions", [*ON_FUNCTIONS, *(f.name for f in FUNCTIONS)]),
        ("speed", FILTER[:-1]),
    ],
)
def test_the_results_are_there(block: str, named: Sequence[str]) -> None:
    (text,) = re.findall(rf"<!-- {block}: begin -->(.*?)<!-- {block}: end -->", RESULTS, re.DOTALL)
    for name in named:
        assert re.search(rf"\| {re.escape(name)}[ ,]", text), name
