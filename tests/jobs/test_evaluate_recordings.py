"""`evaluate` on recordings: the same recordings for every filter."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.messages import assert_states
from helpers.recordings import bench

import posegsa
from posegsa import config
from posegsa.cli.command import main
from posegsa.errors import ArgumentError
from posegsa.filters.rollout import Estimates
from posegsa.judging import baselines, recorded_baselines
from posegsa.judging.description import Description, described_filter
from posegsa.judging.evaluation import CONSTANT, EKF, TUNED
from posegsa.judging.judge import Recorded, judge
from posegsa.judging.on_recordings import OnRecordings
from posegsa.judging.result import Result
from posegsa.judging.tuned_kalman import kalman_experiment, tune_kalman
from posegsa.recordings.recording import Recording
from posegsa.search.problem import TuningProblem
from posegsa.search.recorded import recorded_problem
from posegsa.search.run_search import Found, first_search
from posegsa.steps import Step

GAMMA, SCALE = (
    {"key": key, "lower": 0.01, "upper": upper}
    for key, upper in (("filter.gamma", 5.0), ("gain.error_scale", 1.0))
)
TINY = {
    "filter": {
        **{"schedule": "smooth", "vector_bias": "off"},
        **{"cross_vector": False, "gamma_law": "fixed"},
    },
    "parameters": {"also": [GAMMA, SCALE]},
    "search": {"optimiser": "de", "agents": 8, "iterations": 3},
}
"""As in `test_tune_recordings`, but scaled; the constant gain there is a baseline here."""


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    rng, given = np.random.default_rng(0), bench()
    given["vectors"] = given["vectors"] + 0.05 * rng.normal(size=given["vectors"].shape)
    made = Recording.from_arrays(name="bench", **given, landmark_weights=0.1)
    return [made.off(50, 1, seed=seed) for seed in range(2)]


@pytest.fixture(scope="module")
def result(recordings: list[Recording]) -> Result:
    """A smooth gain from the middle of its box; its quality does not matter here."""
    problem = recorded_problem(config.from_dict(TINY), recordings[:1], 100.0)
    began = first_search(problem)
    history = jax.tree.map(jnp.zeros_like, began.history)
    found = Found(began._replace(best_cost=jnp.zeros(()), history=history), 0, 0)
    return judge(problem, found, Recorded(recordings[:1], [], 100.0))


def judged_on(result: Result) -> OnRecordings:
    assert result.on_recordings is not None
    return result.on_recordings


def kalman_estimates(
    found: Description, experiment: config.Experiment, recording: Recording
) -> Estimates:
    kalman = kalman_experiment(experiment, EKF)
    return posegsa.run_filter(described_filter(found, kalman, None, (2, 1)), recording)


def test_other_filters_are_compared_on_the_same_recordings(
    result: Result, recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegsa.judging.tuned_kalman.MAX_EVALUATIONS", 40)
    monkeypatch.setattr("posegsa.judging.tuned_kalman.CHECK_INTERVAL", 40)
    reports: list[Step] = []
    judged = judged_on(
        posegsa.evaluate(
            result, recordings=recordings[1], training=recordings[0], progress=reports.append
        )
    )
    assert list(judged.baselines) == [CONSTANT, EKF]
    searched = (step.about for step in reports if step.name == "searching")
    assert list(dict.fromkeys(searched)) == [CONSTANT, EKF]
    for (score,) in (judged.held_out, *judged.baselines.values()):
        assert score.name == "bench"
        assert score.errors["judged"].samples == 200
    (ekf,) = judged.baselines[EKF]
    assert ekf.errors["judged"].position < 0.5  # type: ignore[operator]  # there is a position
    assert f"{EKF}, held out" in judged.table()
    # The judged estimates are those of this recording and this part.
    kalman = kalman_experiment(result.experiment, EKF)
    found = tune_kalman(recorded_problem(kalman, recordings[:1], 100.0, strict=False))
    estimates = kalman_estimates(found, result.experiment, recordings[1])
    again = posegsa.recording_errors(estimates, recordings[1]).rmse()["judged"]
    assert again == ekf.errors["judged"]


def test_what_cannot_be_judged_is_refused(result: Result, recordings: list[Recording]) -> None:
    with pytest.raises(ArgumentError, match="recordings: none"):
        posegsa.evaluate(result, recordings=[])
    with pytest.raises(ArgumentError, match="cost with recordings"):
        posegsa.evaluate(result, recordings=recordings, cost=lambda track, time: 0.0)  # type: ignore[arg-type]  # refused before it is called
    with pytest.raises(ArgumentError, match="recordings = 'bench'"):
        posegsa.evaluate(result, recordings="bench")  # type: ignore[call-overload]  # wrong on purpose


# A run on simulated scenarios ---------------------------------------------------------------------


def test_constant_gains_for_another_filter_have_the_windows_of_its_scenario() -> None:
    short = ["scenario.duration=15.0", "cost.steady_window=[400, 1400]", "filter.kind=kalman"]
    own = config.override(config.load("kalman"), short)
    found = recorded_baselines._observer_on_recordings(own)
    constant = config.override(found, ["filter.schedule=constant"])
    assert (constant.scenario, constant.cost) == (own.scenario, own.cost)


@pytest.fixture(scope="module")
def run() -> Result:
    return posegsa.tune(tiny())


NOISES = Description(
    kind="kalman",
    numbers={},
    also={f"filter.{name}": 0.1 for name in ("angular_velocity", "landmark", "vector")},
    evaluations=20,
)


@pytest.fixture
def noises(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces the Kalman filter's search on scenarios, which `test_evaluate` runs."""

    def tune_kalman(problem: TuningProblem) -> Description:
        assert problem.experiment.filter.kind == "kalman"
        assert problem.scenarios is not None
        return NOISES

    monkeypatch.setattr(baselines, "tune_kalman", tune_kalman)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.usefixtures("noises")
def test_a_run_on_scenarios_is_judged_beside_filters_of_the_same_scenarios(
    run: Result, recordings: list[Recording]
) -> None:
    reports: list[Step] = []
    result = posegsa.evaluate(run, recordings=recordings, progress=reports.append)
    judged = judged_on(result)
    assert {(step.name, step.about) for step in reports} == {("searching", EKF)}
    assert list(judged.baselines) == [CONSTANT, EKF]
    assert run.on_scenarios is not None
    contenders = run.on_scenarios.evaluation.contenders
    assert result.filter == contenders[TUNED].filter
    gain = contenders[CONSTANT].filter.numbers["gain"][0]
    constant = posegsa.ConstantGain(np.float32(gain))  # type: ignore[arg-type]  # a NumPy scalar will do for an array
    by_hand = posegsa.configured(run.experiment, schedule=constant)
    for i, recording in enumerate(recordings):
        for estimates, scores in (
            (run.estimate(recording), judged.held_out),
            (by_hand.estimate(recording), judged.baselines[CONSTANT]),
        ):
            again = posegsa.recording_errors(estimates, recording).rmse()
            assert scores[i].errors == again
        estimates = kalman_estimates(NOISES, run.experiment, recording)
        again = posegsa.recording_errors(estimates, recording).rmse()
        assert judged.baselines[EKF][i].errors == again
    assert_states(result.summary(), "on 3 training scenarios", f"{CONSTANT}, held out")
    assert "No recording was held out" not in result.summary()
    # Baselines that the run already has are not searched again.
    other = NOISES._replace(also=NOISES.also | {"filter.landmark": 0.3})
    known = contenders[CONSTANT]._replace(filter=other)
    wider = replace(run.on_scenarios.evaluation, contenders=contenders | {EKF: known})
    wider = replace(run, on_scenarios=replace(run.on_scenarios, evaluation=wider))
    reports.clear()
    again = judged_on(posegsa.evaluate(wider, recordings=recordings[0], progress=reports.append))
    assert not reports
    estimates = kalman_estimates(other, run.experiment, recordings[0])
    expected = posegsa.recording_errors(estimates, recordings[0]).rmse()
    assert again.baselines[EKF][0].errors == expected
    assert expected != judged.baselines[EKF][0].errors
    # A further judgement on recordings has them, too.
    further = judged_on(posegsa.evaluate(result, recordings=recordings[0]))
    assert list(further.baselines) == [CONSTANT, EKF]
    assert further.baselines[EKF][0].errors == judged.baselines[EKF][0].errors


def test_weights_go_in_order_whatever_a_run_was_tuned_on(
    run: Result, result: Result, recordings: list[Recording]
) -> None:
    two = {"scenario.vectors.0.weight": 0.5, "scenario.landmarks.0.weight": 0.25}
    run = replace(run, experiment=run.experiment.replace(**two))
    settings = run.filter_for(vectors=3, landmarks=2).settings
    assert [float(w) for w in settings.vectors.weights or ()] == [0.5, 1.0, 1.0]
    assert [float(w) for w in settings.landmark_weights or ()] == [0.25, 1.0]
    fewer = run.filter_for(vectors=1, landmarks=0).settings
    assert [float(w) for w in fewer.vectors.weights or ()] == [0.5]
    assert fewer.landmark_weights == ()
    given = replace(result, experiment=run.experiment, filter=result.filter._replace(also={}))
    same = given.filter_on(recordings[0]).settings
    assert same == run.filter_for(vectors=2, landmarks=1).settings


def test_what_a_run_on_scenarios_is_not_judged_with_is_refused(
    run: Result, recordings: list[Recording]
) -> None:
    for arguments, words in (
        ({"scenarios": 7}, "scenarios with recordings"),
        ({"seed": 7}, "seed with recordings"),
        ({"cost": lambda track, time: 0.0}, r"cost = .*lambda.*configured"),
    ):
        with pytest.raises(ArgumentError, match=words):
            posegsa.evaluate(run, recordings=recordings[1:], **arguments)  # type: ignore[call-overload]  # wrong on purpose


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.usefixtures("noises")
def test_the_command_judges_runs_of_both_kinds(
    run: Result,
    result: Result,
    recordings: list[Recording],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    files = [str(tmp_path / name) for name in ("a.npz", "b.npz")]
    for file, recording in zip(files, recordings, strict=True):
        recording.save(file)
    folder = posegsa.save(run, tmp_path / "run")
    assert main(["evaluate", str(folder), "--recording", files[0], "--recording", files[1]]) == 0
    said = capsys.readouterr()
    assert f"searching {EKF}" in said.err
    assert (folder / "summary.txt").read_text().strip() in said.out
    judged = posegsa.load(folder)
    assert [one.name for one in judged_on(judged).held_out] == ["bench", "bench"]
    assert judged.on_scenarios is not None, "its evaluation on scenarios stays"
    assert main(["evaluate", str(folder), "--training", files[0]]) == 2
    assert_states(capsys.readouterr().err, "--training", "with --recording")
    assert main(["evaluate", str(folder), "--bridge", "hold"]) == 2
    assert_states(capsys.readouterr().err, "--bridge", "with --recording")
    bridged = ["--recording", files[0], "--longest-gap", "0.5"]
    assert main(["evaluate", str(folder), *bridged]) == 2
    assert_states(capsys.readouterr().err, "--longest-gap", "with --bridge")
    assert main(["evaluate", str(folder), "--recording", files[0], "--seed", "1"]) == 2
    assert_states(capsys.readouterr().err, "--seed", "without --recording")
    folder = posegsa.save(result, tmp_path / "recorded")
    assert main(["evaluate", str(folder), "--recording", files[1], "--window", "0.5:"]) == 0
    again = judged_on(posegsa.load(folder))
    (score,) = again.held_out
    assert score.samples == 150
    assert again.baselines == {}
