"""The main job through the API: its result and its folder."""

import dataclasses
import json
import math
import os
import shutil
import signal
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.generated import configuration, not_numbers, structure

import posegsa
from posegsa import config
from posegsa.errors import (
    ArgumentError,
    ConfigError,
    MeasurementError,
    RunFolderError,
    SearchInterrupted,
)
from posegsa.figures import style as figure_style
from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.judge import References
from posegsa.saving import result_files as run_folder
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import keys, scenario_keys, training_keys
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import tuning_problem
from posegsa.search.search_spaces import rule_indices
from posegsa.steps import Step

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run: its result, its folder and its progress messages."""
    reports: list[Step] = []
    folder = tmp_path_factory.mktemp("run") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figure_style, "DPI", 15)
        result = posegsa.tune(tiny(), out=folder, progress=reports.append)
    return result, folder, reports


def test_the_best_cost_is_that_of_the_parameters_on_the_training_scenarios(run):
    result, _, _ = run
    problem = tuning_problem(result.experiment)
    k = problem.space.schedules.checked(result.parameters)
    one = jax.tree.map(lambda a: a[None], problem.space.candidate(k))
    again = np.mean(costs_by_scenario(one, problem.scenarios)[:3])
    # Another batch size and another kernel: float32 rounding over 200 steps, no chaos.
    np.testing.assert_allclose(again, result.best_cost, rtol=1e-4)
    np.testing.assert_allclose(
        np.mean(result.on_scenarios.training[TUNED]), result.best_cost, rtol=1e-4
    )


def test_training_and_held_out_scenarios_have_different_noise():
    use = keys(0)
    training = jax.random.key_data(scenario_keys(use.training, 64)).tolist()
    held_out = jax.random.key_data(scenario_keys(use.held_out, 64)).tolist()
    assert not {tuple(k) for k in training} & {tuple(k) for k in held_out}


def test_the_number_of_scenarios_does_not_change_the_first_ones():
    key = keys(3).training
    few, many = (jax.random.key_data(scenario_keys(key, n)) for n in (3, 64))
    assert (few == many[:3]).all()


def test_the_start_of_scenarios_depends_neither_on_their_number_nor_on_their_length():
    short = tiny()
    long = short.replace(**{"scenario.duration": 2 * short.scenario.duration})
    few, many = (scenario_batch(e, training_keys(3, n)) for e, n in ((short, 2), (long, 17)))
    for a, b in zip(jax.tree.leaves(few.samples), jax.tree.leaves(many.samples), strict=True):
        np.testing.assert_array_equal(a, b[:2, : a.shape[1]])
    for a, b in zip(jax.tree.leaves(few.initial), jax.tree.leaves(many.initial), strict=True):
        np.testing.assert_array_equal(a, b[:2])


def test_no_keys_or_those_of_another_generator_make_no_scenarios():
    experiment = tiny()
    for given in (training_keys(0, 2)[:0], jax.random.split(jax.random.key(0, impl="rbg"), 2)):
        with pytest.raises(ArgumentError, match="threefry"):
            scenario_batch(experiment, given)


def test_history_and_counts(run):
    result, _, _ = run
    assert len(result.search.history.best) == 4
    assert (np.diff(result.search.history.best) <= 0).all()
    assert result.search.history.best[-1] == np.float32(result.best_cost)
    assert result.filter.evaluations == 24
    assert result.search.non_finite == result.search.history.non_finite.sum() == 0
    for contender in result.on_scenarios.evaluation.contenders.values():
        assert len(contender.metrics.cost) == 3


def test_progress_begins_at_zero_and_ends_at_the_end(run):
    result, _, reports = run
    searching = [step for step in reports if step.name == "searching"]
    assert [step.done for step in searching] == [0, 1, 2, 3, 4]
    assert {step.parts for step in searching} == {4}
    assert searching[0].best_cost == math.inf
    assert searching[-1].best_cost == result.best_cost


def test_progress_is_reported_for_every_step(run):
    names = dict.fromkeys(step.name for step in run[2])
    assert list(names) == ["preparing", "compiling", "searching", "judging", "drawing"]


def test_the_same_seed_gives_the_same_result_and_progress_does_not_matter(run):
    again = posegsa.tune(tiny())
    assert again.best_cost == run[0].best_cost
    assert (again.parameters == run[0].parameters).all()
    assert posegsa.tune(tiny(), seed=5).best_cost != run[0].best_cost


def test_the_best_constant_gain_is_the_best_of_those_tried(run):
    from posegsa.judging.baselines import CONSTANT_GAINS
    from posegsa.model.schedules import ConstantGain
    from posegsa.search.candidates import Candidate

    result, _, _ = run
    training = scenario_batch(result.experiment, scenario_keys(keys(0).training, 3))
    gains = np.linspace(1, 101, CONSTANT_GAINS, dtype=np.float32)
    every = Candidate(ConstantGain(jax.numpy.asarray(gains)))
    costs = np.mean(costs_by_scenario(every, training), axis=0)
    found = result.on_scenarios.evaluation.contenders[CONSTANT].filter
    assert found.numbers["gain"] == [gains[np.argmin(costs)]]


def test_the_folder_holds_what_is_promised(run):
    result, folder, _ = run
    data = json.loads((folder / "result.json").read_text())
    assert data["schema"] == run_folder.SCHEMA
    assert data["version"] == posegsa.__version__
    assert data["search"]["best_cost"] == result.best_cost
    assert data["filter"]["numbers"]["k"] == result.parameters.tolist()
    assert data["filter"]["evaluations"] == 24
    assert data["search"]["compile_seconds"] > 0
    assert data["search"]["search_seconds"] > 0
    assert data["search"]["non_finite"] == 0
    costs = data["on_scenarios"]["evaluation"]["contenders"][TUNED]["metrics"]["cost"]
    assert costs == result.on_scenarios.evaluation.contenders[TUNED].metrics.cost.tolist()
    assert (folder / "summary.txt").read_text() == result.summary() + "\n"
    assert config.from_dict(data["experiment"]) == result.experiment
    assert {"jax", "numpy", "device"} <= set(data["environment"])
    header, *rows = (folder / "history.csv").read_text().splitlines()
    assert header == "iteration,best,mean,worst,non_finite"
    assert len(rows) == 4
    assert len((folder / "trajectory.csv").read_text().splitlines()) == 201
    figures = {path.stem for path in (folder / "figures").glob("*.png")}
    assert figures == set(posegsa.draw(result))
    paper = {"input_terms", "output_terms", "euler_angles", "position", "errors"}
    assert paper | {"convergence", "gain", "control_surface"} <= figures
    assert (folder / "report.html").read_text().startswith("<!doctype html>")


def test_load_gives_the_same_from_the_folder(run):
    result, folder, _ = run
    loaded = posegsa.load(folder)
    assert loaded.experiment == result.experiment
    assert (loaded.parameters == result.parameters).all()
    assert loaded.best_cost == result.best_cost
    assert loaded.summary() == result.summary()
    for name, values in vars(result.on_scenarios.trajectory).items():
        np.testing.assert_array_equal(getattr(loaded.on_scenarios.trajectory, name), values)
    for name, values in result.search.history._asdict().items():
        np.testing.assert_array_equal(getattr(loaded.search.history, name), values)
    second = (folder / "trajectory.csv").read_text().splitlines()[2]
    assert second.startswith("0.01,"), "and not 0.009999999776482582"
    error, rate = np.float32([0.1, 0.5]), np.float32([0.0, 0.3])
    assert (loaded.controller(error, rate) == result.controller(error, rate)).all()


def test_the_summary_shows_training_beside_held_out(run):
    text = run[0].summary()
    for words in ("training", "held out", "worst", "best constant gain", "deg", "cm"):
        assert words in text


def test_float64_is_one_setting_away(run, monkeypatch):
    # The filters beside it would take as long to compile once more.
    monkeypatch.setattr("posegsa.tuning.references", lambda _: References({}, None))
    result = posegsa.tune(tiny("run.dtype=float64"))
    assert result.controller.output_terms.dtype == np.float64
    assert result.search.history.best.dtype == np.float64
    assert jax.numpy.ones(1).dtype == np.float32, "the process keeps its precision"
    # The same noise and the same first agents, so the same search up to rounding.
    assert result.search.history.best[0] == pytest.approx(run[0].search.history.best[0], rel=1e-4)


def test_a_folder_that_holds_a_run_is_refused_before_the_search(run, monkeypatch):
    _, folder, _ = run
    monkeypatch.setattr("posegsa.tuning.run_search", lambda *_: pytest.fail("it searched"))
    with pytest.raises(RunFolderError, match="already"):
        posegsa.tune(tiny(), out=folder)
    assert posegsa.load(folder).best_cost == run[0].best_cost


def test_a_run_is_replaced_when_asked(run, tmp_path, monkeypatch):
    result, _, _ = run
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    posegsa.save(result, tmp_path)
    with pytest.raises(RunFolderError, match="overwrite"):
        posegsa.save(result, tmp_path)
    posegsa.save(result, tmp_path, overwrite=True)
    assert posegsa.load(tmp_path).best_cost == result.best_cost


def alter(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def comparable(folder: Path) -> dict:
    """The data that must agree between two runs: all tables, and the result except times."""
    data = json.loads((folder / "result.json").read_text())
    for key in ("search_seconds", "compile_seconds"):
        del data["search"][key]
    del data["digest"]
    names = ("history.csv", "trajectory.csv", "evaluation.txt")
    return {"result": data} | {name: (folder / name).read_bytes() for name in names}


def test_a_run_stopped_by_ctrl_c_resumes_as_if_never_stopped(run, tmp_path):
    reports: list[float] = []

    def iterations(step: Step) -> None:
        if step.name == "searching":
            reports.append(step.done)

    def interrupt(step: Step) -> None:
        iterations(step)
        if step.name == "searching" and step.done == 1:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(SearchInterrupted, match="after iteration 2 of 4"):
        posegsa.tune(tiny(), out=tmp_path, progress=interrupt, figures=[])
    assert reports == [0, 1, 2], "what is done already is reported too"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(RunFolderError, match="unfinished run"):
        posegsa.tune(tiny(), out=tmp_path)
    with pytest.raises(RunFolderError, match="no finished run"):
        posegsa.load(tmp_path)
    reports.clear()
    posegsa.tune(resume=tmp_path, progress=iterations, figures=[])
    assert reports == [2, 3, 4]
    assert comparable(tmp_path) == comparable(run[1])
    # Resumed again, the run is finished and says so without searching.
    again = posegsa.tune(tiny(), resume=tmp_path, progress=lambda _: pytest.fail("it searched"))
    assert again.best_cost == run[0].best_cost


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    path = tmp_path / "file"
    path.write_text("mine")
    with pytest.raises(RunFolderError, match="not a folder"):
        posegsa.tune(tiny(), out=path)
    assert path.read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError, match="cannot be written"):
        posegsa.tune(tiny(), out=tmp_path / "file" / "below")


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda f: (f / "result.json").unlink(), "no finished run"),
        (lambda f: (f / "result.json").write_text("{"), "not JSON"),
        (lambda f: (f / "result.json").write_text("[]"), "allowed: an object"),
        (
            lambda f: (f / "result.json").write_text('{"schema": 1, "version": "0.1"}'),
            "schema = 1,.*'0.1'.*schema 8",
        ),
        (lambda f: (f / "result.json").write_text("[" * 10**6), "not JSON"),
        (lambda f: (f / "result.json").write_bytes(b"\xff"), "not UTF-8"),
        (lambda f: os.truncate(f / "result.json", run_folder.MAX_RESULT + 1), "6193741825 bytes"),
        (lambda f: (f / "result.json").unlink() or os.mkfifo(f / "result.json"), "regular file"),
        (
            lambda f: alter(f / "result.json", '"sampled_points": 1', '"sampled_points": -1'),
            "points",
        ),
        (lambda f: alter(f / "result.json", '"best constant gains": {', '"x": {'), "contenders.x"),
        (lambda f: alter(f / "result.json", '"seed": null', '"seed": 7'), "was changed"),
    ],
)
def test_a_damaged_folder_is_refused_by_name(run, tmp_path, damage, said):
    folder = tmp_path / "run"
    shutil.copytree(run[1], folder)
    damage(folder)
    with pytest.raises(RunFolderError, match=said):
        posegsa.load(folder)


def test_estimates_of_own_measurements_refuse_an_invalid_pose(run):
    # As many samples and the same sensors as an example, whose preparation is already compiled.
    own = posegsa.Measurements.from_arrays(
        time_step=np.full(900, 0.01),
        angular_velocity=np.zeros((900, 3)),
        velocity=np.zeros((900, 3)),
        vectors=np.tile(np.eye(3)[:2], (900, 1, 1)),
        vector_references=np.eye(3)[:2],
        landmarks=np.ones((900, 1, 3)),
        landmark_references=np.ones((1, 3)),
    )
    good = {"rotation": np.eye(3), "position": np.zeros(3)}
    assert run[0].estimate(own, **good).position.shape == (900, 3)
    for name, value in (
        ("rotation", 2 * np.eye(3)),
        ("rotation", np.diag([1, 1, -1])),
        ("position", [1, 2]),
        ("position", [np.nan, 0, 0]),
        ("bias", np.zeros(3)),
    ):
        with pytest.raises(MeasurementError, match=name):
            run[0].estimate(own, **(good | {name: value}))


def test_a_box_of_zero_width_fixes_its_parameter():
    result = posegsa.tune(tiny("parameters.lower.0=0.1", "parameters.upper.0=0.1"))
    assert result.parameters[0] == np.float32(0.1)
    assert len(set(result.parameters)) > 15


def test_generated_configurations_are_tuned_without_nan(run):
    """Configurations that run the same program as the tests above, to avoid compiling."""
    rng, base, tuned = np.random.default_rng(2), tiny(), 0
    program = structure(tuning_problem(base))
    while tuned < 3:
        try:
            experiment = config.from_dict(configuration(rng, base))
        except ConfigError:
            continue
        if (
            experiment.run.dtype == base.run.dtype
            and structure(tuning_problem(experiment)) == program
        ):
            assert not_numbers(posegsa.tune(experiment)) == []
            tuned += experiment != base
    broken = run[0].search.history._replace(best=np.full(4, np.nan))
    search = dataclasses.replace(run[0].search, history=broken)
    assert not_numbers(dataclasses.replace(run[0], search=search)) == ["history.best"]


def test_a_bad_seed_names_its_key():
    with pytest.raises(ConfigError, match=r"run\.seed"):
        posegsa.tune(tiny(), seed=-1)


def test_a_batch_gives_what_single_runs_give(run):
    batch = posegsa.tune_batch(tiny(), seeds=[0, 5])
    assert len(batch.results) == 2
    assert batch.results[0].best_cost == run[0].best_cost
    assert (batch.results[0].parameters == run[0].parameters).all()
    assert batch.results[1].experiment.run.seed == 5
    assert batch.results[1].best_cost != run[0].best_cost
    for words in ("2 searches", "training", "held out", "median"):
        assert words in batch.summary()


def test_a_batch_of_traced_values_is_compiled_once(monkeypatch, caplog):
    # Other tests check the results.
    monkeypatch.setattr(
        "posegsa.tuning.judge", lambda _, found: SimpleNamespace(best_cost=found.search.best_cost)
    )
    many = [tiny(f"filter.gamma={g}", f"scenario.velocity_noise={g / 100}") for g in (2.0, 8.0)]
    costs = [r.best_cost for r in posegsa.tune_batch(many).results]
    assert costs[0] != costs[1]
    again = [config.override(one, ["gain.error_scale=0.7", "run.seed=9"]) for one in many]
    with jax.log_compiles():
        posegsa.tune_batch(again)
    assert "Compiling" not in caplog.text


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("filter.substeps=3", "structure"),
        ("run.dtype=float64", "run.dtype"),
        ("search.agents=7", "search: differs"),
        ("objective.name=worst", "objective"),
    ],
)
def test_a_batch_that_differs_in_structure_is_refused(setting, said):
    with pytest.raises(ConfigError, match=said):
        posegsa.tune_batch([tiny(), tiny(setting)])


def test_an_empty_batch_is_refused():
    with pytest.raises(ConfigError, match="nothing to tune"):
        posegsa.tune_batch(tiny(), seeds=[])


# Searched rules -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    folder = tmp_path_factory.mktemp("searched") / "out"
    return posegsa.tune(tiny("fuzzy.rules=searched"), out=folder, figures=[]), folder


def test_a_searched_rule_table_is_that_of_all_that_shows_the_result(searched):
    result, folder = searched
    controller, printed = result.controller, result.tuned.fuzzy.rules
    assert result.experiment.fuzzy.rules == "searched"
    assert rule_indices(printed) == controller.rules
    assert len({term for row in controller.rules for term in row}) > 1
    np.testing.assert_allclose(
        np.mean(result.on_scenarios.training[TUNED]), result.best_cost, rtol=1e-4
    )
    read = posegsa.load(folder)
    assert read.controller.rules == controller.rules
    names = [[config.TERMS[i] for i in row] for row in controller.rules]
    assert json.loads(posegsa.export_json(read))["controller"]["rules"] == names
    shown = [line.split() for line in result.summary().splitlines()]
    for name, row in zip(reversed(config.TERMS), printed, strict=True):
        assert [name, *row] in shown
    (folder / "gain.fis").write_text(posegsa.export_fis(read))
    assert posegsa.load_controller(folder / "gain.fis").rules == controller.rules


def test_a_rule_table_of_a_folder_is_checked(searched):
    result, folder = searched
    path = folder / "result.json"
    whole = path.read_text()
    for wrong, said in (([5.0] * 25, "25 whole numbers"), (None, "rules")):
        numbers = dict(result.filter.numbers)
        numbers.pop("rules") if wrong is None else numbers.update(rules=wrong)
        data = json.loads(whole)
        contenders = data["on_scenarios"]["evaluation"]["contenders"]
        for found in (data, contenders[TUNED]):
            found["filter"]["numbers"] = numbers
        path.write_text(json.dumps(data))
        with pytest.raises(RunFolderError, match=said):
            posegsa.load(folder, edited=True)


def test_a_search_that_only_descends_cannot_choose_rules():
    with pytest.raises(ConfigError, match=r'fuzzy.rules = "searched"\s.*table'):
        tiny("fuzzy.rules=searched", "search.optimiser=adam")
    polished = ("search.optimiser=gsa+adam", "search.agents=40", "search.iterations=40")
    assert tiny("fuzzy.rules=searched", *polished).search.optimiser == "gsa+adam"
