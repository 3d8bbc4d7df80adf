"""The files of a sweep's runs: every altered field is refused by name, or is usable."""

import copy
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.results import K, description
from helpers.stored import sealed

import posegsa
from posegsa.errors import RunFolderError
from posegsa.figures.sweep_figures import plot_sweep
from posegsa.judging.description import tuned_experiment
from posegsa.judging.sweep_runs import Sweep, SweepRun
from posegsa.saving.sweep_folder import write_sweep_run

pytestmark = pytest.mark.quick

VALUES = (None, True, "x", "\x1b[31m", "nan", [], {}, -1, 0, 1.5, 1e308, 10**30, [1], {"a": 1})


def run(seed: int = 0, gamma: float = 5.0, cost: float = 40.0) -> SweepRun:
    return SweepRun(
        base=tiny(),
        values={"filter.gamma": gamma, "gain.signal": "measured"},
        seed=seed,
        training_cost=cost,
        held_out_cost=cost + 1,
        held_out_worst=cost + 9,
        diverged=0,
        filter=description("fuzzy", evaluations=24, k=K),
        search_seconds=0.5,
        environment={"jax": "0.10"},
        version="1.2.3",
    )


def written(folder: Path, *runs: SweepRun) -> Path:
    (folder / "runs").mkdir(parents=True)
    for one in runs:
        write_sweep_run(folder, one)
    return folder


def test_every_field_of_a_run_of_a_sweep(tmp_path):
    (file,) = (written(tmp_path / "out", run()) / "runs").iterdir()
    good = json.loads(file.read_text("utf-8"))
    accepted = refused = 0
    for key in good.keys() - {"digest"}:
        for value in VALUES:
            if value == good[key] and type(value) is type(good[key]):
                continue
            altered = copy.deepcopy(good)
            altered[key] = value
            file.write_text(sealed(altered), "utf-8")
            words, found = "", None
            try:
                found = posegsa.load_sweep(tmp_path / "out")
            except RunFolderError as error:
                words = str(error)
            if found is None:
                refused += 1
                assert ".json: " in words
                assert all(c.isprintable() or c == "\n" for c in words)
            else:
                accepted += 1
                texts = (found.table(), found.csv(), found.runs_csv())
                assert all(c.isprintable() or c == "\n" for text in texts for c in text)
    assert refused > 6 * accepted > 0
    file.write_text(sealed(good | {"values": {"filter.gamma": 6.0}}), "utf-8")
    with pytest.raises(RunFolderError, match="another experiment"):
        posegsa.load_sweep(tmp_path / "out")
    file.write_text(json.dumps(good | {"version": "1.2.4"}), "utf-8")
    with pytest.raises(RunFolderError, match=r"was changed .*run it again"):
        posegsa.load_sweep(tmp_path / "out")
    file.write_text(json.dumps(good | {"schema": 1}), "utf-8")
    with pytest.raises(RunFolderError, match=r"schema = 1, .*reads schema 2"):
        posegsa.load_sweep(tmp_path / "out")


def test_a_rule_table_that_was_searched_is_kept(tmp_path):
    searched = tiny("fuzzy.rules=searched")
    filter = description("fuzzy", k=K, rules=[0, 1, 2, 3, 4] * 5)
    found = replace(run(), base=searched, filter=filter)
    (back,) = posegsa.load_sweep(written(tmp_path, found)).runs
    assert back == found
    row = ("VS", "S", "M", "L", "VL")[::-1]
    assert tuned_experiment(back.experiment, back.filter).fuzzy.rules == (row,) * 5


def test_folders_of_different_sweeps_are_not_merged(tmp_path):
    one, other = written(tmp_path / "a", run()), written(tmp_path / "b", run(seed=1))
    third = replace(run(2), base=tiny("filter.substeps=3"))
    with pytest.raises(RunFolderError, match="another experiment"):
        posegsa.merge_sweeps([one, written(tmp_path / "c", third)])
    merged = posegsa.merge_sweeps([one, other])
    assert [each.seed for each in merged.runs] == [0, 1]
    assert posegsa.load_sweep(one) == merged
    # A run that is in both folders counts once.
    shutil.copytree(one / "runs", other / "runs", dirs_exist_ok=True)
    assert posegsa.merge_sweeps([other, one]) == merged


def test_spread_over_seeds_and_a_figure_of_it():
    costs = [10.0, 14.0, np.inf, 30.0]
    runs = [
        run(seed, gamma, c)
        for (seed, gamma), c in zip([(0, 1), (1, 1), (0, 9), (1, 9)], costs, strict=True)
    ]
    found = Sweep(tuple(runs))
    first, second = found.rows()
    assert first.training[:2] == (12.0, pytest.approx(np.sqrt(8)))
    assert (second.training.mean, second.training.least) == (np.inf, 30.0)
    assert np.isnan(second.training.deviation)
    figure = plot_sweep(found, "filter.gamma")
    held_out, training = figure.axes
    np.testing.assert_array_equal(held_out.lines[0].get_xydata()[0], [1, 13])
    np.testing.assert_array_equal(training.lines[0].get_xydata()[0], [1, 12])
    assert np.isnan(training.lines[0].get_ydata()[1])
    (bars,) = training.collections
    np.testing.assert_array_equal(bars.get_segments()[0], [[1, 10], [1, 14]])
    with pytest.raises(posegsa.PosegsaError, match=r"allowed: filter\.gamma, gain\.signal"):
        plot_sweep(found, "filter.substeps")
