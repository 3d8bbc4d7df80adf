"""`tune` on recordings: its result, output, files and refusals."""

import json
import re
import shlex
import signal
import warnings
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import TINY as SCENARIOS
from helpers.messages import assert_states
from helpers.recordings import bench

import posegsa
from posegsa import config
from posegsa.cli.command import main, parser
from posegsa.errors import (
    ArgumentError,
    ConfigError,
    FuzzyError,
    PosegsaWarning,
    RecordingError,
    RunFolderError,
    SearchInterrupted,
)
from posegsa.export import export
from posegsa.judging.evaluation import KALMAN_AS_IT_COMES, NOISES_FOUND
from posegsa.judging.judge import Recorded, judge
from posegsa.judging.result import Result
from posegsa.recordings.recording import Recording
from posegsa.saving.checkpointing import RecordedTask
from posegsa.saving.folder import CHECKPOINT_SUFFIX
from posegsa.saving.resume import check_same_recordings
from posegsa.search.recorded import default_experiment, recorded_problem
from posegsa.search.run_search import Found, first_search
from posegsa.search.search_spaces import rule_indices
from posegsa.settings.plain import plain
from posegsa.steps import Step
from posegsa.tuning import _share_in

TINY = {
    "filter": {"vector_bias": "off", "cross_vector": False, "gamma_law": "fixed"},
    "parameters": {"also": [{"key": "filter.gamma", "lower": 0.01, "upper": 5.0}]},
    "search": {"optimiser": "de", "agents": 8, "iterations": 3},
}
CONSTANT = TINY | {"filter": {"schedule": "constant"} | TINY["filter"]}
"""The same with one gain."""


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    made = Recording.from_arrays(
        name="bench", **bench(), landmark_weights=0.1, sources={"velocity": "synthetic: R^T v"}
    )
    return [made.off(60, 1, seed=seed) for seed in range(2)]


@pytest.fixture(scope="module")
def result(recordings: list[Recording]) -> Result:
    return posegsa.tune(
        config.from_dict(CONSTANT),
        recordings=recordings[0],
        held_out=recordings[1],
    )


def test_the_best_gain_is_found_and_judged_on_what_was_held_out(
    result: Result, recordings: list[Recording]
) -> None:
    gain = result.filter.numbers["gain"][0]
    assert 1 < gain < 100
    assert result.filter.evaluations == 24
    on = result.on_recordings
    assert on is not None
    (held_out,) = on.held_out
    again = posegsa.recording_errors(result.estimate(recordings[1]), recordings[1]).rmse()
    assert held_out.errors == again
    judged = on.training[0].errors["judged"]
    assert judged.position is not None
    assert result.best_cost == pytest.approx(judged.total + 100 * judged.position, rel=0.02)
    (replayed,) = posegsa.replay(result, recordings[1])
    assert replayed.errors is not None
    assert replayed.errors.rmse() == again


def test_the_summary_shows_the_held_out_or_says_that_there_are_none(
    result: Result, recordings: list[Recording]
) -> None:
    assert "held out" in result.summary()
    assert "No recording was held out" not in result.summary()
    assert "synthetic: R^T v" in result.summary()
    assert result.on_recordings is not None
    alone = replace(result, on_recordings=replace(result.on_recordings, held_out=[]))
    assert "No recording was held out" in alone.summary()


def test_a_search_without_a_finite_cost_is_no_result(recordings: list[Recording]) -> None:
    wild = {"gain_limit": "off"} | CONSTANT["filter"]
    box = {"also": [{"key": "filter.gamma", "lower": 1e8, "upper": 1e9}]}
    found = posegsa.tune(
        config.from_dict(CONSTANT | {"filter": wild, "parameters": box}),
        recordings=recordings[0],
        held_out=recordings[1],
    )
    assert found.best_cost == np.inf
    assert found.search is not None
    assert found.search.non_finite == 24
    assert_states(found.summary(), "no agent had a finite cost", "24 agents")
    assert found.on_recordings is not None
    assert found.on_recordings.held_out[0].errors["judged"].total == np.inf


def test_a_result_is_saved_and_read_back(
    result: Result, recordings: list[Recording], tmp_path: Path
) -> None:
    found = posegsa.tune(
        config.from_dict(CONSTANT),
        recordings=recordings[0],
        held_out=recordings[1],
        out=tmp_path,
    )
    assert found.filter == result.filter
    read = posegsa.load(tmp_path)
    assert plain(read) == plain(found)
    np.testing.assert_array_equal(
        read.estimate(recordings[1]).rotation, result.estimate(recordings[1]).rotation
    )
    with pytest.raises(RunFolderError, match="already"):
        posegsa.tune(config.from_dict(TINY), recordings=recordings[0], out=tmp_path)
    path = tmp_path / "result.json"
    whole = path.read_text()
    for change in (
        lambda data: data["filter"].update(kind="constant", numbers={}),
        lambda data: data["filter"].update(also={}),
        lambda data: data["on_recordings"]["training"][0].update(samples="many"),
        lambda data: data.update(schema=99),
    ):
        data = json.loads(whole)
        change(data)
        path.write_text(json.dumps(data))
        with pytest.raises(RunFolderError, match=r"result\.json"):
            posegsa.load(tmp_path, edited=True)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_the_command_tunes_on_files(
    recordings: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "tiny.toml").write_text(
        "[filter]\nschedule = 'constant'\nvector_bias = 'off'\ncross_vector = false\n"
        "gamma_law = 'fixed'\n[parameters]\n"
        "also = [{key = 'filter.gamma', lower = 0.01, upper = 5.0}]\n"
        "[search]\noptimiser = 'de'\nagents = 8\niterations = 3\n"
    )
    recordings[0].save(tmp_path / "a.npz")
    recordings[1].save(tmp_path / "b.npz")
    command = ["tune", str(tmp_path / "tiny.toml"), "--out", str(tmp_path / "run"), "--quiet"]
    files = ["--recording", str(tmp_path / "a.npz"), "--held-out", str(tmp_path / "b.npz")]
    assert main([*command, *files, "--window", "0:2"]) == 0
    said = capsys.readouterr().out
    assert "velocity: synthetic: R^T v" in said
    assert "held out" in said
    assert "Written to" in said
    # The command that it prints compares the run with other filters.
    (shown,) = re.findall(r"  posegsa (evaluate .*)", said)
    options = parser().parse_args(shlex.split(shown))
    assert options.run == str(tmp_path / "run")
    assert options.recording == [str(tmp_path / "b.npz")]
    assert (options.training, options.training_window) == ([str(tmp_path / "a.npz")], (0, 2))
    assert (tmp_path / "run" / "summary.txt").read_text().strip() in said
    assert main(["replay", str(tmp_path / "run"), str(tmp_path / "b.npz")]) == 0
    again = ["tune", "--resume", str(tmp_path / "run"), "--quiet"]
    assert main([*again, *files, "--window", "0:2"]) == 0
    assert (tmp_path / "run" / "summary.txt").read_text().strip() in capsys.readouterr().out
    assert main([*again, *files, "--window", "0:1"]) == 2
    assert_states(capsys.readouterr().err, "recordings[0]", "other numbers")
    assert main(again) == 2
    assert "without recordings" in capsys.readouterr().err
    assert main([*command, *files[:2], "--held-out-window", "1:2"]) == 2
    assert_states(capsys.readouterr().err, "--held-out-window", "with --held-out")
    assert main([*command, "--overwrite", "--recording", str(tmp_path / "no.npz")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_it_warns_where_the_gain_limit_sets_the_gain(recordings: list[Recording]) -> None:
    for gain, limited in ((1e5, 1.0), (1e-2, 0.0)):
        schedule = posegsa.ConstantGain(gain)  # type: ignore[arg-type]  # a number will do for an array
        found = posegsa.configured(config.from_dict(TINY), schedule=schedule, recordings=recordings)
        assert found.on_recordings is not None
        assert [one.limited for one in found.on_recordings.held_out] == [limited, limited]
        warned = [w for w in found.warnings() if "gain limit" in w and "100 %" in w]
        assert len(warned) == limited


def test_a_gain_made_by_hand_is_judged_saved_and_exported(
    recordings: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = config.from_dict(TINY)
    mine = posegsa.configured(chosen, schedule=posegsa.ConstantGain(8.0), recordings=recordings[:1])  # type: ignore[arg-type]  # a number will do for an array
    assert mine.filter.numbers == {"gain": [8.0]}
    assert "not searched" in mine.summary()
    posegsa.save(mine, tmp_path / "run")
    assert plain(posegsa.load(tmp_path / "run")) == plain(mine)
    assert main_quietly(["export", str(tmp_path / "run"), "--format", "json"]) == 0
    exported = json.loads(capsys.readouterr().out)
    assert exported["kind"] == "constant"
    assert exported["numbers"] == {"gain": [8.0]}
    assert exported["filter"]["cross_vector"] is False
    assert main_quietly(["export", str(tmp_path / "run"), "--format", "fis"]) == 2
    assert_states(capsys.readouterr().err, "constant gain", "json", "c")
    space = posegsa.parameter_space(chosen)
    controller = space.controller(0.5 * (space.lower + space.upper))
    again = json.loads(
        export(posegsa.configured(chosen, schedule=posegsa.FuzzyGain(controller)), "json")
    )
    assert again["controller"]["offset_1_s"] == 1.0
    assert len(again["numbers"]) == 22
    other = replace(controller, offset=0.0)
    with pytest.raises(FuzzyError, match=r"controller.offset: .* 1\.0.*controller of"):
        posegsa.configured(chosen, schedule=posegsa.FuzzyGain(other))
    with pytest.raises(ArgumentError, match="schedule: a str"):
        posegsa.configured(schedule="fast")  # type: ignore[arg-type]  # wrong on purpose


def test_an_interrupted_search_resumes_to_the_same_bits(
    result: Result, recordings: list[Recording], tmp_path: Path
) -> None:
    def stop(step: Step) -> None:
        if step.name == "searching" and step.done == 1:
            signal.raise_signal(signal.SIGINT)

    given = {"recordings": recordings[0], "held_out": recordings[1]}
    with pytest.raises(SearchInterrupted, match=r"iteration 2 of 3.*--recording"):
        posegsa.tune(config.from_dict(CONSTANT), out=tmp_path, progress=stop, **given)
    with pytest.raises(RunFolderError, match="unfinished run"):
        posegsa.tune(config.from_dict(CONSTANT), out=tmp_path, **given)
    for changes, words in (
        ({"recordings": None, "held_out": None}, "without recordings"),
        ({"recordings": recordings[1], "held_out": recordings[0]}, r"recordings\[0\]: holds other"),
        ({"held_out": None}, r"held_out: 0 of them.*1 of"),
        ({"position_weight": 1.0}, r"position_weight = 1.0.*100.0"),
    ):
        with pytest.raises(ArgumentError, match=words):
            posegsa.tune(resume=tmp_path, **(given | changes))
    with pytest.raises(ConfigError, match=r"filter.substeps"):
        posegsa.tune(
            config.from_dict(CONSTANT).replace(**{"filter.substeps": 3}), resume=tmp_path, **given
        )
    found = posegsa.tune(resume=tmp_path, **given)
    for name in ("filter", "best_cost", "on_recordings", "experiment"):
        assert getattr(found, name) == getattr(result, name), name
    assert plain(posegsa.tune(resume=tmp_path, **given)) == plain(found), "it is finished"
    with pytest.raises(ConfigError, match=r"iterations = 2\s+the run has 3.*as many or"):
        posegsa.tune(resume=tmp_path, iterations=2, **given)


@pytest.mark.quick
def test_a_scenario_run_is_not_resumed_with_recordings(tmp_path: Path) -> None:
    task = RecordedTask(position_weight=1.0, training=["a"], held_out=[])
    with pytest.raises(ArgumentError, match="simulated scenarios"):
        check_same_recordings(None, task, tmp_path)
    check_same_recordings(task, task, tmp_path)


@pytest.mark.filterwarnings("ignore:scenario.initial_rotation:posegsa.PosegsaWarning")
def test_scenarios_are_tuned_on_beside_recordings(
    recordings: list[Recording], tmp_path: Path
) -> None:
    # The scenarios and the search of other tests, with the numbers tuned here.
    settings = ["objective.simulated_share=0.5"]
    settings += ["parameters.also=[{key='filter.gamma.0', lower=0.01, upper=5.0}]"]
    found = posegsa.tune(
        config.override(config.Experiment(), [*SCENARIOS, "filter.schedule=constant", *settings]),
        recordings=recordings[0],
        held_out=recordings[1],
        out=tmp_path,
    )
    assert found.search is not None
    assert found.search.tuned_on == "recordings and scenarios"
    on = found.on_recordings
    assert on is not None
    assert on.simulated is not None
    assert (len(on.simulated.training), len(on.simulated.held_out)) == (3, 3)
    judged = on.training[0].errors["judged"]
    alone = judged.total + 100 * (judged.position or 0)
    both = 0.5 * alone + 0.5 * float(np.mean(on.simulated.training))
    assert found.best_cost == pytest.approx(both, rel=0.02)
    said = found.summary()
    assert_states(said, "1 recording", "3 training scenarios")
    assert f"{np.mean(on.simulated.held_out):.4g}" in said
    assert plain(posegsa.load(tmp_path)) == plain(found)


def test_a_searched_rule_table_is_in_the_result_and_its_exports(
    recordings: list[Recording], tmp_path: Path
) -> None:
    """A result with a made-up controller; `test_tuning` searches one, on scenarios."""
    searched = config.from_dict(TINY | {"fuzzy": {"rules": "searched"}})
    problem = recorded_problem(searched, recordings[:1], 100.0)
    low, high = map(np.asarray, problem.space.box)
    drawn = np.random.default_rng(0).uniform(low, high).astype(np.float32)
    began = first_search(problem)
    nothing = jax.tree.map(jnp.zeros_like, began.history)
    ended = began._replace(
        best_position=jnp.asarray(drawn), best_cost=jnp.zeros(()), history=nothing
    )
    found = judge(problem, Found(ended, 0.0, 0.0), Recorded(recordings[:1], recordings[1:], 100.0))
    posegsa.save(found, tmp_path)
    table = found.tuned.fuzzy.rules
    assert len(found.filter.numbers["rules"]) == 25
    assert {*map(int, found.filter.numbers["rules"])} > {0}
    controller = found.schedule.controller  # type: ignore[attr-defined]  # it is a FuzzyGain
    assert config.from_dict({"fuzzy": {"rules": table}}).fuzzy.rules == table
    assert rule_indices(table) == controller.rules  # type: ignore[arg-type]  # as it is read from a file
    for name, row in zip(reversed(config.TERMS), table, strict=True):
        assert [name, *row] in [line.split() for line in found.summary().splitlines()]
    exported = json.loads(export(found, "json"))
    assert exported["controller"]["rules"] == [
        [config.TERMS[i] for i in row] for row in controller.rules
    ]
    assert posegsa.load(tmp_path).filter == found.filter
    path = tmp_path / "result.json"
    whole = path.read_text()
    for wrong in ([5] * 25, [0.5] * 25, [0] * 24, []):
        data = json.loads(whole)
        data["filter"]["numbers"]["rules"] = [float(n) for n in wrong]
        path.write_text(json.dumps(data))
        with pytest.raises(RunFolderError, match=r"rules = .*25 whole numbers"):
            posegsa.load(tmp_path, edited=True)


def test_nothing_of_a_simulated_run_stays_under_it(result: Result, tmp_path: Path) -> None:
    stale = tmp_path / "checkpoints" / f"0{CHECKPOINT_SUFFIX}"
    stale.parent.mkdir()
    trajectory = tmp_path / "trajectory.csv"
    for path in (tmp_path / "result.json", tmp_path / "report.html", trajectory, stale):
        path.write_text("old", "utf-8")
    posegsa.save(result, tmp_path, overwrite=True)
    assert plain(posegsa.load(tmp_path)) == plain(result)
    assert "on recordings" in (tmp_path / "report.html").read_text("utf-8")
    assert not trajectory.exists()
    assert not stale.exists()


def main_quietly(arguments: list[str]) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", posegsa.PosegsaWarning)
        return main(arguments)


def test_what_cannot_be_tuned_on_is_refused(recordings: list[Recording]) -> None:
    for arguments, words in (
        ({"recordings": []}, "recordings: none"),
        ({"recordings": recordings, "held_out": recordings[1]}, "held_out: bench"),
        ({"recordings": recordings, "position_weight": -1.0}, "position_weight = -1.0"),
        ({"recordings": recordings, "cost": len}, "recordings with cost"),
        ({"held_out": recordings}, "held_out without recordings"),
        ({"position_weight": 3.0}, "position_weight without recordings"),
        ({"recordings": "bench.csv"}, "recordings = 'bench.csv'"),
    ):
        with pytest.raises(ArgumentError, match=words):
            posegsa.tune(config.from_dict(TINY), **arguments)  # type: ignore[arg-type]  # wrong on purpose
    made = posegsa.configured(config.from_dict(TINY), schedule=posegsa.ConstantGain(8.0))  # type: ignore[arg-type]  # a number will do for an array
    for arguments, words in (
        ({"recordings": recordings, "seed": 3}, "seed with recordings"),
        ({"recordings": recordings, "scenarios": 7}, "scenarios with recordings"),
        ({"recordings": recordings, "training": recordings}, "bench.*training"),
    ):
        with pytest.raises(ArgumentError, match=words):
            posegsa.evaluate(made, **arguments)  # type: ignore[call-overload]  # wrong on purpose
    blind = Recording.from_arrays(**bench(truth_rotation=None, truth_position=None))
    with pytest.raises(RecordingError, match="has no truth"):
        posegsa.tune(config.from_dict(TINY), recordings=blind)


def test_without_a_configuration_the_noises_are_those_that_the_recordings_show() -> None:
    given, rng = bench(400), np.random.default_rng(0)
    for name in ("angular_velocity", "velocity", "vectors", "landmarks"):
        given[name] = given[name] + 0.1 * rng.standard_normal(given[name].shape)
    whole = Recording.from_arrays(**given)
    parts = whole.window(0, 2), whole.window(2)
    found = posegsa.tune(recordings=parts[0], held_out=parts[1], iterations=1)
    assert found.experiment.filter.kind == "kalman"
    assert found.experiment.filter.landmark == pytest.approx(0.1, rel=0.2)
    keys = ["filter.angular_velocity", "filter.velocity", "filter.linear_walk"]
    assert list(found.filter.also) == keys
    # The summary ends with the best filter on the held-out recordings.
    last = found.summary().split("Tuned: filter.angular_velocity")[1]
    assert " on what was held out: this filter" in last
    assert KALMAN_AS_IT_COMES in last


@pytest.mark.parametrize("least", [0.0, 0.99])
def test_a_search_that_gains_too_little_changes_nothing(least: float) -> None:
    given, rng = bench(400), np.random.default_rng(0)
    for name in ("angular_velocity", "velocity", "vectors", "landmarks"):
        given[name] = given[name] + 0.1 * rng.standard_normal(given[name].shape)
    whole = Recording.from_arrays(**given)
    own = default_experiment([whole.window(0, 2)]).replace(**{"objective.least_gain": least})
    found = posegsa.tune(own, recordings=whole.window(0, 2), held_out=whole.window(2), iterations=2)
    same = found.also["filter.velocity"] == pytest.approx(own.filter.velocity)
    assert same == (least > 0)
    assert found.on_recordings is not None
    words = f"the search gained less than {100 * least:.3g} % of the cost"
    assert (words in found.summary()) == same
    assert (NOISES_FOUND in found.on_recordings.baselines) != same, (
        "it would be compared with itself"
    )


def test_without_a_velocity_the_attitude_filter_is_the_default() -> None:
    inertial = posegsa.imu(gyr=np.zeros((200, 3)), acc=np.tile([0, 0, 9.81], (200, 1)), rate=100)
    assert default_experiment([inertial]).filter.kind == "imu"


def test_held_out_samples_that_are_tuned_on_are_reported() -> None:
    given, rng = bench(1000), np.random.default_rng(0)
    for name in ("angular_velocity", "velocity", "vectors", "landmarks"):
        given[name] = given[name] + 0.1 * rng.standard_normal(given[name].shape)
    whole = Recording.from_arrays(**given)
    said = r"held_out: 50 % of recording is in recording\[0:5\]"
    with pytest.warns(PosegsaWarning, match=said):
        posegsa.tune(recordings=whole.window(0, 5), held_out=whole, iterations=1)


def test_a_gyroscope_with_few_digits_is_no_sign_of_the_same_samples() -> None:
    rng = np.random.default_rng(0)
    given = bench(1000, angular_velocity=rng.integers(0, 9, (1000, 3)) / 100)
    given["velocity"] = np.zeros((1000, 3))
    other = given | {"vectors": given["vectors"] + 0.1 * rng.standard_normal((1000, 2, 3))}
    one, two = (Recording.from_arrays(**each) for each in (given, other))
    assert _share_in(one, two) == 0
    assert _share_in(one, one) == 1
