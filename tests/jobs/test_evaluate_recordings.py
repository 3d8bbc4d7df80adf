"""`evaluate` on recordings: the same recordings for every filter."""

import numpy as np
import pytest
from recorded_motion import motion

import posegsa
from posegsa import config
from posegsa.errors import ArgumentError
from posegsa.judging.evaluation import CONSTANT, EKF
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.recorded_kalman import recorded_kalman_estimates, tune_recorded_kalman
from posegsa.recordings.recording import Recording

TINY = {
    "filter": {"vector_bias": "off", "cross_vector": False},
    "parameters": {"also": [{"key": "gain.error_scale", "lower": 0.01, "upper": 1.0}]},
    "search": {"optimiser": "de", "agents": 8, "iterations": 2},
}


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    one_landmark = {
        "landmarks": motion()["landmarks"][:, :1],
        "landmark_references": motion()["landmark_references"][:1],
    }
    rng = np.random.default_rng(0)
    given = motion(200, **{k: v[:200] if k == "landmarks" else v for k, v in one_landmark.items()})
    given["vectors"] = given["vectors"] + 0.05 * rng.normal(size=given["vectors"].shape)
    made = Recording.from_arrays(name="bench", **given, landmark_weights=0.1)
    return [made.off(50, 1, seed=seed) for seed in range(2)]


@pytest.fixture(scope="module")
def result(recordings: list[Recording]) -> RecordingResult:
    return posegsa.tune(config.from_dict(TINY), recordings=recordings[0], schedule="smooth")


@pytest.mark.usefixtures("compile_fast")
def test_other_filters_stand_beside_it_on_the_same_recordings(
    result: RecordingResult, recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegsa.judging.kalman.MOST", 40)
    monkeypatch.setattr("posegsa.judging.kalman.CHECKED", 40)
    said: list[str] = []
    judged = posegsa.evaluate(
        result, recordings=recordings[1], training=recordings[0], progress=said.append
    )
    assert list(judged.baselines) == [CONSTANT, EKF]
    assert said == [f"searching: {CONSTANT}", f"searching: {EKF}"]
    for (score,) in (judged.held_out, *judged.baselines.values()):
        assert score.name == "bench"
        assert score.errors["judged"].samples == 200
    (ekf,) = judged.baselines[EKF]
    assert ekf.errors["judged"].position < 0.5  # type: ignore[operator]
    assert f"{EKF}, held out" in judged.table()
    # The filter's estimates are judged, not those of another recording or part.
    found = tune_recorded_kalman(result.experiment, recordings[:1], result.position_weight)
    (estimates,) = recorded_kalman_estimates(found, result.experiment, recordings[1:])
    again = posegsa.recording_errors(estimates, recordings[1]).rmse()["judged"]
    assert again == ekf.errors["judged"]


def test_what_cannot_be_judged_is_refused(result: RecordingResult) -> None:
    with pytest.raises(ArgumentError, match="recordings: none"):
        posegsa.evaluate(result, recordings=[])
    with pytest.raises(ArgumentError, match="recordings = 'bench'"):
        posegsa.evaluate(result, recordings="bench")  # type: ignore[call-overload]
