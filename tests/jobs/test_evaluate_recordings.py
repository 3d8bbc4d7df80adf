"""`evaluate` on recordings: the same recordings for every filter."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.messages import assert_told
from helpers.recordings import bench
from helpers.recordings import short_parts as short_parts

import posegsa
from posegsa import config
from posegsa.cli.command import main
from posegsa.errors import ArgumentError
from posegsa.judging import recorded_baselines
from posegsa.judging.evaluation import CONSTANT, EKF, TUNED, Description
from posegsa.judging.recorded import RecordingResult, judge_on_recordings
from posegsa.judging.recorded_kalman import recorded_kalman_estimates, tune_recorded_kalman
from posegsa.judging.result import TuneResult
from posegsa.model.scenario import Scenario
from posegsa.recordings.recording import Recording
from posegsa.saving.run import write_run
from posegsa.search.recorded import recorded_problem
from posegsa.search.run import Found, first_search
from posegsa.steps import Step

pytestmark = pytest.mark.usefixtures("short_parts")

GAMMA, SCALE = (
    {"key": key, "lower": 0.01, "upper": upper}
    for key, upper in (("filter.gamma", 5.0), ("gain.error_scale", 1.0))
)
TINY = {
    "filter": {"vector_bias": "off", "cross_vector": False, "gamma_law": "fixed"},
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
def result(recordings: list[Recording]) -> RecordingResult:
    """A smooth gain from the middle of its box; its quality does not matter here."""
    problem = recorded_problem(config.from_dict(TINY), recordings[:1], "smooth", 100.0)
    return judge_on_recordings(
        problem, Found(first_search(problem), 0, 0), 100.0, recordings[:1], []
    )


def test_other_filters_stand_beside_it_on_the_same_recordings(
    result: RecordingResult, recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegsa.judging.kalman.MAX_EVALUATIONS", 40)
    monkeypatch.setattr("posegsa.judging.kalman.CHECK_INTERVAL", 40)
    told: list[Step] = []
    judged = posegsa.evaluate(
        result, recordings=recordings[1], training=recordings[0], progress=told.append
    )
    assert list(judged.baselines) == [CONSTANT, EKF]
    searched = (step.about for step in told if step.name == "searching")
    assert list(dict.fromkeys(searched)) == [CONSTANT, EKF]
    for (score,) in (judged.held_out, *judged.baselines.values()):
        assert score.name == "bench"
        assert score.errors["judged"].samples == 200
    (ekf,) = judged.baselines[EKF]
    assert ekf.errors["judged"].position < 0.5  # type: ignore[operator]  # there is a position
    assert f"{EKF}, held out" in judged.table()
    # The judged estimates are those of this recording and this part.
    found = tune_recorded_kalman(result.experiment, recordings[:1], result.position_weight)
    (estimates,) = recorded_kalman_estimates(found, result.experiment, recordings[1:])
    again = posegsa.recording_errors(estimates, recordings[1]).rmse()["judged"]
    assert again == ekf.errors["judged"]


def test_what_cannot_be_judged_is_refused(result: RecordingResult) -> None:
    with pytest.raises(ArgumentError, match="recordings: none"):
        posegsa.evaluate(result, recordings=[])
    with pytest.raises(ArgumentError, match="recordings = 'bench'"):
        posegsa.evaluate(result, recordings="bench")  # type: ignore[call-overload]  # wrong on purpose


# A run on simulated scenarios ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def run() -> TuneResult:
    return posegsa.tune(tiny())


NOISES = Description(
    kind="Kalman",
    numbers={name: [0.1] for name in ("angular_velocity", "landmark", "vector")},
    also={},
    evaluations=20,
)


@pytest.fixture
def noises(run: TuneResult, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces the Kalman filter's search on scenarios, which `test_evaluate` runs."""

    def tune_kalman(experiment: config.Experiment, one: object, **choices: object) -> Description:
        assert experiment == run.experiment
        assert isinstance(one, Scenario)
        assert choices == {"vector_biases": False, "cost": None}
        return NOISES

    monkeypatch.setattr(recorded_baselines, "tune_kalman", tune_kalman)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.usefixtures("noises")
def test_a_run_on_scenarios_is_judged_beside_filters_of_the_same_scenarios(
    run: TuneResult, recordings: list[Recording]
) -> None:
    told: list[Step] = []
    judged = posegsa.evaluate(run, recordings=recordings, progress=told.append)
    assert {(step.name, step.about) for step in told} == {("searching", EKF)}
    assert list(judged.baselines) == [CONSTANT, EKF]
    assert judged.filter == run.evaluation.contenders[TUNED].filter
    constant = posegsa.ConstantGain(np.float32(run.constant_gain))  # type: ignore[arg-type]  # a NumPy scalar instead of an array
    by_hand = posegsa.by_hand(constant, run.experiment)
    for i, recording in enumerate(recordings):
        for estimates, scores in (
            (run.estimate(recording), judged.held_out),
            (by_hand.estimate(recording), judged.baselines[CONSTANT]),
        ):
            again = posegsa.recording_errors(estimates, recording).rmse()
            assert scores[i].errors == again
        (estimates,) = recorded_kalman_estimates(NOISES, run.experiment, [recording])
        again = posegsa.recording_errors(estimates, recording).rmse()
        assert judged.baselines[EKF][i].errors == again
    assert "on 3 simulated scenarios" in judged.summary()
    assert f"{CONSTANT}, held out" in judged.summary()
    assert "No recording was held out" not in judged.summary()
    # Baselines that the run already has are not searched again.
    own = run.evaluation.contenders
    other = NOISES._replace(numbers=NOISES.numbers | {"landmark": [0.3]})
    known = own[CONSTANT]._replace(filter=other)
    wider = replace(run.evaluation, contenders=own | {EKF: known})
    told.clear()
    again = posegsa.evaluate(
        replace(run, evaluation=wider), recordings=recordings[0], progress=told.append
    )
    assert not told
    (estimates,) = recorded_kalman_estimates(other, run.experiment, recordings[:1])
    expected = posegsa.recording_errors(estimates, recordings[0]).rmse()
    assert again.baselines[EKF][0].errors == expected
    assert expected != judged.baselines[EKF][0].errors


def test_weights_go_in_order_whatever_a_run_was_tuned_on(
    run: TuneResult, result: RecordingResult, recordings: list[Recording]
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
    run: TuneResult, recordings: list[Recording]
) -> None:
    for arguments, words in (
        ({"training": recordings[:1]}, "training.*tuned on scenarios"),
        ({"scenarios": 7}, "scenarios with recordings"),
        ({"seed": 7}, "seed with recordings"),
        ({"cost": lambda track, time: 0.0}, r"cost = .*lambda.*configured"),
    ):
        with pytest.raises(ArgumentError, match=words):
            posegsa.evaluate(run, recordings=recordings[1:], **arguments)  # type: ignore[call-overload]  # wrong on purpose


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.usefixtures("noises")
def test_the_command_judges_runs_of_both_kinds(
    run: TuneResult,
    result: RecordingResult,
    recordings: list[Recording],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("posegsa.saving.run.draw", lambda *_: {})
    files = [str(tmp_path / name) for name in ("a.npz", "b.npz")]
    for file, recording in zip(files, recordings, strict=True):
        recording.save(file)
    folder = posegsa.save(run, tmp_path / "run")
    assert main(["evaluate", str(folder), "--recording", files[0], "--recording", files[1]]) == 0
    said = capsys.readouterr()
    assert f"searching {EKF}" in said.err
    assert (folder / "recorded.txt").read_text().strip() in said.out
    judged = posegsa.load_recorded(folder)
    assert judged.tuned_on == "scenarios"
    assert [one.name for one in judged.held_out] == ["bench", "bench"]
    assert isinstance(posegsa.load(folder), TuneResult), "the run stays"
    write_run(run, folder, same_run=True)
    assert posegsa.load_recorded(folder) == judged, "evaluating on scenarios again keeps this file"
    posegsa.save(run, folder, overwrite=True)
    assert not (folder / "recorded.json").exists(), "a file of another run would be wrong"
    assert main(["evaluate", str(folder), "--training", files[0]]) == 2
    assert_told(capsys.readouterr().err, "--training", "with --recording")
    assert main(["evaluate", str(folder), "--bridge", "hold"]) == 2
    assert_told(capsys.readouterr().err, "--bridge", "with --recording")
    bridged = ["--recording", files[0], "--longest-gap", "0.5"]
    assert main(["evaluate", str(folder), *bridged]) == 2
    assert_told(capsys.readouterr().err, "--longest-gap", "with --bridge")
    assert main(["evaluate", str(folder), "--recording", files[0], "--seed", "1"]) == 2
    assert_told(capsys.readouterr().err, "--seed", "without --recording")
    folder = posegsa.save(result, tmp_path / "recorded")
    assert main(["evaluate", str(folder)]) == 2
    assert "allowed: with --recording" in capsys.readouterr().err
    assert main(["evaluate", str(folder), "--recording", files[1], "--window", "0.5:"]) == 0
    (score,) = posegsa.load_recorded(folder).held_out
    assert score.samples == 150
    assert posegsa.load_recorded(folder).baselines == {}
