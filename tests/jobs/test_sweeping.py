"""A sweep: its runs are those of `tune`, none is made twice, and the parts add up to the whole."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.experiments import TINY, tiny

import posegsa
from posegsa import sweeping
from posegsa.cli.command import main
from posegsa.errors import ArgumentError, ConfigError, RunFolderError, SearchInterrupted
from posegsa.judging.evaluation import TUNED
from posegsa.judging.sweep_runs import Sweep
from posegsa.search.run_search import Found, first_search, run_search

GAMMA = "filter.gamma"
GAMMAS = [[2.0, 4.0], [5.0, 10.0]]
pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Path, Sweep]:
    """A sweep of two values with two seeds each, in two batches, and its folder."""
    folder = tmp_path_factory.mktemp("sweep") / "whole"
    found = posegsa.sweep(tiny(), vary={GAMMA: GAMMAS}, seeds=2, together=2, out=folder)
    return folder, found


@pytest.fixture
def searched(monkeypatch) -> list[int]:
    """The sizes of the searched batches."""
    sizes: list[int] = []
    search = sweeping.search_batch

    def counted(problems, reports):
        sizes.append(len(problems))
        return search(problems, reports)

    monkeypatch.setattr(sweeping, "search_batch", counted)
    return sizes


def test_a_run_is_what_tune_finds(whole):
    _, found = whole
    assert [(run.values[GAMMA], run.seed) for run in found.runs] == [
        (gamma, seed) for gamma in GAMMAS for seed in (0, 1)
    ]
    run = found.runs[3]
    alone = posegsa.tune(tiny(), seed=1)
    assert run.experiment == alone.experiment
    assert run.filter.numbers["k"] == alone.parameters.tolist()
    judged = alone.on_scenarios
    assert judged is not None
    assert run.training_cost == pytest.approx(np.mean(judged.training[TUNED]), rel=1e-5)
    unseen = judged.evaluation.contenders[TUNED].metrics
    assert run.held_out_cost == pytest.approx(np.mean(unseen.cost), rel=1e-5)
    assert run.held_out_worst == pytest.approx(np.max(unseen.cost), rel=1e-5)


def test_what_is_written_is_what_was_found(whole):
    folder, found = whole
    assert posegsa.load_sweep(folder) == found
    assert (folder / "sweep.txt").read_text("utf-8") == found.table() + "\n"
    with (folder / "sweep.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [json.loads(row[GAMMA]) for row in rows] == GAMMAS
    for row, gamma in zip(rows, GAMMAS, strict=True):
        costs = [run.held_out_cost for run in found.runs if run.values[GAMMA] == gamma]
        assert float(row["held_out_mean"]) == np.mean(costs)
        assert float(row["held_out_deviation"]) == np.std(costs, ddof=1)
        assert (float(row["held_out_least"]), float(row["held_out_most"])) == (
            min(costs),
            max(costs),
        )
        assert row["seeds"] == "2"
    with (folder / "runs.csv").open(encoding="utf-8", newline="") as file:
        each = [float(row["training_cost"]) for row in csv.DictReader(file)]
    assert each == [run.training_cost for run in found.runs]
    assert (folder / "figures" / "filter.gamma.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_that_is_done_is_not_made_again(whole, searched, tmp_path):
    folder, found = tmp_path / "again", whole[1]
    shutil.copytree(whole[0], folder)
    again = posegsa.sweep(tiny(), vary={GAMMA: GAMMAS}, seeds=2, out=folder)
    assert (again, searched) == (found, [])
    # More values and seeds are added to the sweep; the last batch is filled up, so that it runs the
    # same program as the one before.
    asked = {"vary": {GAMMA: [GAMMAS[0], [1.0, 2.0]]}, "seeds": [1, 4], "together": 2}
    more = posegsa.sweep(tiny(), **asked, out=folder)
    assert searched == [2, 2]
    assert len(more.runs) == 7
    assert set(map(repr, more.runs)) > set(map(repr, found.runs))


def test_it_says_that_it_prepares_while_it_does(monkeypatch):
    reports, structure = [], sweeping._structure

    def looked(experiment):
        assert {step.name for step in reports} == {"preparing"}
        return structure(experiment)

    monkeypatch.setattr(sweeping, "_structure", looked)
    monkeypatch.setattr(sweeping, "_search", lambda *given: iter(()))
    posegsa.sweep(tiny(), vary={GAMMA: GAMMAS}, progress=reports.append)
    assert [step.name for step in reports][-1] == "sweeping"


def test_a_stopped_one_continues(whole, searched, tmp_path):
    _, found = whole

    def stop(step) -> None:
        if step.name == "sweeping" and step.done > 2:  # in the second batch
            raise KeyboardInterrupt

    asked = {"vary": {GAMMA: GAMMAS}, "seeds": 2, "together": 2, "out": tmp_path}
    with pytest.raises(SearchInterrupted, match=r"2 of 4 runs"):
        posegsa.sweep(tiny(), **asked, progress=stop)
    assert len(posegsa.load_sweep(tmp_path).runs) == 2
    assert not (tmp_path / "sweep.txt").exists()
    again = posegsa.sweep(tiny(), **asked)
    assert searched == [2, 2, 2]
    assert again.csv() == found.csv()


def test_runs_of_long_iterations_are_searched_one_by_one(whole, searched, monkeypatch):
    """Each search is then saved as soon as it is done; its bits are those of a batch."""
    _, found = whole
    monkeypatch.setattr(sweeping, "BATCH_SAMPLES", 1)
    again = posegsa.sweep(tiny(), vary={GAMMA: GAMMAS[:1]}, seeds=2)
    assert searched == [1, 1]
    assert [run.filter for run in again.runs] == [run.filter for run in found.runs[:2]]


def test_parts_come_to_the_whole(whole, tmp_path, capsys):
    _, found = whole
    command = ["sweep", "quick", "--vary", f"{GAMMA}=[2.0, 4.0],[5.0, 10.0]", "--seeds", "2"]
    command += ["--quiet"]
    for setting in TINY:
        command += ["--set", setting]
    places = [str(tmp_path / name) for name in ("first", "second")]
    for part, place in enumerate(places, start=1):
        assert main([*command, "--shard", f"{part}/2", "--out", place]) == 0
        assert f"{part} of 2" in capsys.readouterr().out
    assert main(["sweep", "--merge", *places, "--out", str(tmp_path / "all")]) == 0
    assert found.table() in capsys.readouterr().out
    assert (tmp_path / "all" / "sweep.csv").read_text() == found.csv()
    assert main(["sweep", "--merge", str(tmp_path)]) == 2
    assert "no runs" in capsys.readouterr().err
    assert main(["sweep", "--merge", *places, "--vary", "filter.gamma=1"]) == 2
    assert "--merge with vary" in capsys.readouterr().err


def test_another_sweep_is_not_replaced_unasked(whole, tmp_path):
    folder, found = whole
    for given, said in (
        ({"experiment": tiny("run.dtype=float64"), "vary": {GAMMA: GAMMAS}}, "another experiment"),
        ({"experiment": tiny(), "vary": {"filter.substeps": [2]}}, r"over filter.gamma"),
    ):
        with pytest.raises(RunFolderError, match=said):
            posegsa.sweep(**given, out=folder)
    assert posegsa.load_sweep(folder) == found


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"vary": {}}, ArgumentError, "vary: nothing"),
        ({"vary": {GAMMA: []}}, ArgumentError, r"vary\['filter.gamma'\]: none"),
        ({"vary": {GAMMA: 5}}, ArgumentError, r"vary\['filter.gamma'\]:.* int.*values"),
        ({"vary": {GAMMA: [-1.0]}}, ConfigError, r"filter.gamma = -1.0"),
        ({"vary": {"filter.gama": [1.0]}}, ConfigError, "did you mean filter.gamma"),
        ({"vary": {"run.seed": [1]}}, ArgumentError, r"vary: run.seed.*other keys"),
        ({"vary": {GAMMA: [1.0]}, "seeds": 0}, ArgumentError, "seeds = 0"),
        ({"vary": {GAMMA: [1.0]}, "seeds": []}, ArgumentError, "seeds: none"),
        ({"vary": {GAMMA: [1.0]}, "seeds": ["a"]}, ArgumentError, "seeds = 'a'"),
        ({"vary": {GAMMA: [1.0]}, "shard": (2, 2)}, ArgumentError, r"shard = \(2, 2\)"),
        ({"vary": {GAMMA: [1.0]}, "shard": "1/2"}, ArgumentError, "shard: a str"),
        ({"vary": {GAMMA: [1.0]}, "together": 0}, ArgumentError, "together = 0"),
    ],
)
def test_what_cannot_be_swept_is_refused_before_a_search(given, error, said):
    with pytest.raises(error, match=said):
        posegsa.sweep(tiny(), **given)


@pytest.fixture
def unsearched(monkeypatch) -> list[int]:
    """The sizes of the batches; their searches end at once."""
    sizes: list[int] = []

    def one_batch(problems, _):
        sizes.append(len(problems))
        return [Found(first_search(problem), 0.0, 0.0) for problem in problems]

    monkeypatch.setattr(sweeping, "search_batch", one_batch)
    return sizes


def test_what_differs_in_structure_is_batched_apart(unsearched):
    found = posegsa.sweep(
        tiny(),
        vary={"search.optimiser": ["random_search", "gsa"]},
        seeds=2,
    )
    assert unsearched == [2, 2]
    assert [run.values["search.optimiser"] for run in found.runs] == [
        *("gsa", "gsa"),
        *("random_search", "random_search"),
    ]
    assert "random_search" in found.table()


def test_a_searched_rule_table_is_in_its_run(whole, monkeypatch):
    def one_by_one(problems, reports):
        return [run_search(problem, reports) for problem in problems]

    monkeypatch.setattr(sweeping, "search_batch", one_by_one)  # with the program of `tune`
    searched, given = (
        posegsa.sweep(tiny(), vary={"fuzzy.rules": ["searched"]}).runs[0],
        whole[1].runs[0],
    )
    alone = posegsa.tune(tiny("fuzzy.rules=searched"))
    assert searched.filter == alone.filter
    assert len(searched.filter.numbers["rules"]) == 25
    assert "rules" not in given.filter.numbers
