"""Recordings as scenarios of a search: costs by hand, padding without effect, tuned keys."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.recordings import motion
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.errors import ConfigError, MemoryLimitError, RecordingError
from posegsa.filters.observer import Observer
from posegsa.filters.rollout import simulate
from posegsa.model.schedules import ConstantGain
from posegsa.recordings.recording import Recording
from posegsa.search import memory
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.population import costs_by_scenario, evaluate_population, partition
from posegsa.search.problem import tuning_problem
from posegsa.search.recorded import (
    recorded_batch,
    recorded_problem,
    with_effect_on,
    with_starts_off,
)

BASE: dict[str, Any] = {
    "filter": {
        **{"schedule": "constant", "vector_bias": "off"},
        **{"cross_vector": False, "substeps": 1},
    },
    "parameters": {"also": []},
}
PROJECTED = pytest.mark.filterwarnings("ignore:scenario.initial_rotation:posegsa.PosegsaWarning")
GAINS = Candidate(ConstantGain(jnp.array([4.0, 9.0], jnp.float32)))


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    """One with a pose, landmarks at a tenth of the rate; one shorter, slower, attitude only."""
    pose, attitude = motion(), motion(200, velocity=None, landmarks=None, landmark_references=None)
    pose["landmarks"][np.arange(400) % 10 != 0] = np.nan
    pose["truth_rotation"][7] = np.nan
    attitude["time"] = 2 * (attitude["time"] - attitude["time"][0])
    return [
        Recording.from_arrays(name="pose", **pose, judged=np.arange(400) > 50).off(40, 0.5),
        Recording.from_arrays(name="attitude", **attitude).off(20),
    ]


def sensors_of(recording: Recording) -> tuple[int, int]:
    m = recording.measurements
    return np.shape(m.vectors)[1], np.shape(m.landmarks)[1]


def cost_by_hand(recording: Recording, gain: float, position_weight: float) -> float:
    """The cost, computed with NumPy from the filter's estimates."""
    experiment = config.from_dict(BASE)
    filter = filter_of(experiment, None, sensors_of(recording))
    assert isinstance(filter, Observer)
    filter = replace(filter, schedule=ConstantGain(jnp.float32(gain)))
    estimates = posegsa.run_filter(filter, recording)
    errors = posegsa.recording_errors(estimates, recording)
    chord = np.degrees(2 * np.sin(np.radians(errors.attitude.total) / 2))
    cost = posegsa.rmse(chord, recording.judged)
    if errors.position is not None:
        cost += position_weight * posegsa.rmse(errors.position, recording.judged)
    return cost


def test_the_cost_is_that_of_the_filter_on_each_recording(recordings: list[Recording]) -> None:
    batch = recorded_batch(config.from_dict(BASE), recordings, position_weight=100.0)
    assert batch.samples.time.shape == (2, 400)
    costs = np.asarray(costs_by_scenario(GAINS, batch))
    expected = [[cost_by_hand(one, gain, 100.0) for gain in (4.0, 9.0)] for one in recordings]
    np.testing.assert_allclose(costs, expected, rtol=2e-4)


def test_many_recordings_have_the_costs_of_each(recordings: list[Recording]) -> None:
    """Here a piece of the population holds several recordings, above each is by itself."""
    experiment, count = config.from_dict(BASE), 6
    assert partition(2 * count, 2).scenarios > 1
    many = recorded_batch(experiment, recordings * count, position_weight=100.0)
    one = recorded_batch(experiment, recordings, position_weight=100.0)
    together, each = (np.asarray(costs_by_scenario(GAINS, batch)) for batch in (many, one))
    np.testing.assert_allclose(together, np.tile(each, (count, 1)), rtol=1e-5)


def test_samples_that_are_not_judged_do_not_count(recordings: list[Recording]) -> None:
    one = recordings[0]
    assert one.truth is not None
    spoilt = one.truth.each(np.copy)
    spoilt.rotation[:51] = np.eye(3)  # not judged
    assert spoilt.position is not None
    spoilt.position[:51] = 99.0
    changed = Recording(**{**vars(one), "truth": spoilt})
    experiment = config.from_dict(BASE)
    costs = [
        np.asarray(costs_by_scenario(GAINS, recorded_batch(experiment, [each, recordings[1]], 1.0)))
        for each in (one, changed)
    ]
    np.testing.assert_array_equal(costs[0], costs[1])


def also(*keys: str, schedule: str = "fuzzy") -> config.Experiment:
    listed = [{"key": key, "lower": 0.1, "upper": 1.0} for key in keys]
    filter = BASE["filter"] | {"gamma": [1.0, 1.0], "schedule": schedule}
    return config.from_dict(BASE | {"parameters": {"also": listed}, "filter": filter})


def kept(experiment: config.Experiment, vectors: int, landmarks: int, **strict: bool) -> list[str]:
    found = with_effect_on(experiment, vectors, landmarks, **strict)
    return [one.key for one in found.also]


@pytest.mark.quick
def test_each_recording_is_tuned_from_starts_off_its_truth_too(recordings: list[Recording]) -> None:
    starts = ((40.0, 1.0), (150.0, 5.0))
    given = [recordings[0].off(3.0, 0.1), recordings[0].window(1)]
    found = with_starts_off(given, starts)
    assert found[: len(given)] == given
    off = []
    for one in found[len(given) :]:
        truth, start = one.truth, one.initial()
        assert truth is not None
        assert truth.position is not None
        turned = Rotation.from_matrix(start.rotation @ truth.rotation[0].T)
        distance = np.linalg.norm(start.position - truth.position[0])
        off.append((np.degrees(turned.magnitude()), distance))
    np.testing.assert_allclose(off, starts * len(given))
    truth = recordings[0].truth
    assert truth is not None
    rotation = truth.rotation.copy()
    rotation[0] = np.nan
    late = replace(recordings[0], truth=truth._replace(rotation=rotation))
    assert with_starts_off([late], ()) == [late]
    with pytest.raises(RecordingError, match=r"not known at the first .*starts_off = \[\]"):
        with_starts_off([late], starts)
    own = config.Experiment().replace(**{"objective.starts_off": starts})
    batch = recorded_problem(own, recordings, 10.0, strict=False).training
    assert batch.initial.place[0].shape == (3 * len(recordings),)


@pytest.mark.quick
def test_of_the_default_numbers_only_those_with_an_effect_are_tuned() -> None:
    constant, smooth = (
        config.override(config.Experiment(), [f"filter.schedule={kind}"])
        for kind in ("constant", "smooth")
    )
    assert kept(constant, 2, 0) == ["filter.gamma", "filter.vector_bias_gain"]
    assert kept(smooth, 0, 4) == [
        "scenario.landmarks.0.weight",
        "filter.length",
        "filter.gamma",
        "gain.smoothing",
        "gain.error_scale",
    ]
    # The numbers of the configurations that come with posegsa were not chosen by a user either.
    assert "filter.vector_walk" not in kept(config.load("recommended"), 0, 4)
    landmarks = config.override(config.load("landmarks"), ["filter.schedule=constant"])
    assert kept(landmarks, 0, 3) == [
        *("filter.length", "filter.length_growth", "filter.gamma.0", "filter.gamma.1"),
        "filter.bias_wait",
    ]
    own = ("scenario.landmarks.0.weight", "scenario.vectors.1.weight", "filter.gamma.1")
    for key in own:
        with pytest.raises(ConfigError, match=f"'{key}'.*1 vector and 0 landmarks"):
            with_effect_on(also(key), vectors=1, landmarks=0)
    assert kept(also(*own, "filter.gamma.0"), 1, 0, strict=False) == ["filter.gamma.0"]
    with pytest.raises(ConfigError, match=r'"gain.smoothing"\s.*no effect'):
        also("gain.smoothing", schedule="constant")


@pytest.mark.quick
def test_of_a_kalman_filters_noises_only_those_with_an_effect_are_tuned() -> None:
    kalman = config.override(config.Experiment(), ["filter.kind=kalman"])
    every = [one.key for one in config.KALMAN_ALSO]
    assert kept(kalman, 2, 1) == every
    of_landmarks = (
        "velocity",
        "linear_walk",
        "landmark",
        "initial_position",
        "initial_linear_bias",
    )
    gone = {f"filter.{name}" for name in of_landmarks}
    assert kept(kalman, 2, 0) == [key for key in every if key not in gone]
    gone = {"filter.vector", "filter.vector_walk", "filter.initial_vector_bias"}
    assert kept(kalman, 0, 1) == [key for key in every if key not in gone]
    asked = kalman.replace(
        **{"parameters.also": [{"key": "filter.vector", "lower": 1, "upper": 2}]}
    )
    with pytest.raises(ConfigError, match=r"'filter.vector'.*0 vectors and 1 landmark"):
        with_effect_on(asked, vectors=0, landmarks=1)


@pytest.mark.quick
def test_all_numbers_of_the_users_own_filter_are_tuned() -> None:
    settings = ["filter.kind=own", "filter.landmark=2.0"]
    own = config.override(config.Experiment(), settings)
    numbers = [{"key": "filter.landmark", "lower": 1.0, "upper": 3.0}]
    own = own.replace(**{"parameters.also": numbers})
    assert kept(own, 2, 0) == ["filter.landmark"]


@pytest.mark.quick
def test_weights_are_those_of_the_first_sensors() -> None:
    weights = ["scenario.vectors.0.weight=2.0", "scenario.landmarks.0.weight=0.25"]
    experiment = config.override(config.Experiment(), weights)
    filter = filter_of(experiment, None, (1, 3))
    assert isinstance(filter, Observer)
    settings = filter.settings
    assert [float(w) for w in settings.landmark_weights or ()] == [0.25, 1, 1]
    assert [float(w) for w in settings.vectors.weights or ()] == [2]


@pytest.mark.quick
def test_recordings_too_large_for_the_memory_are_refused(
    recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = config.from_dict(BASE)
    own = memory.needs(experiment, recorded=memory.RecordedSize(2, 400, 2, 3))
    assert set(own) == {"recordings", "search.agents", "search.iterations"}
    much = memory.needs(experiment, recorded=memory.RecordedSize(2, 4_000_000, 2, 3))
    assert much["recordings"] == 10_000 * own["recordings"]
    monkeypatch.setattr(memory, "COMPILER", 0)
    monkeypatch.setattr(memory, "available", lambda: own["recordings"])
    with pytest.raises(MemoryLimitError, match=r"recordings = 2\n.* 400 samples"):
        recorded_problem(experiment, recordings, 1.0)


@pytest.mark.quick
def test_the_true_pose_is_no_signal_on_recordings(recordings: list[Recording]) -> None:
    oracle = config.override(config.Experiment(), ["gain.signal=pose"])
    with pytest.raises(ConfigError, match="true pose"):
        recorded_problem(oracle, recordings, 1.0)


# Recordings and simulated scenarios ---------------------------------------------------------------


def mixed(*settings: str, share: float = 0.25) -> config.Experiment:
    """Half a second of the recommended scenarios, with a share of the cost on recordings."""
    data = BASE | {
        "scenario": {"duration": 0.5},
        "cost": {"transient_window": [0, 9], "steady_window": [20, 45]},
        "run": {"training_scenarios": 2, "held_out_scenarios": 3},
        "objective": {"simulated_share": share},
        "family": {"duration": [0.5, 0.5]},
    }
    return config.override(config.from_dict(data), settings)


@pytest.fixture(scope="module")
def one_landmark() -> Recording:
    """A recording with the sensors of the recommended scenario."""
    given = motion(100)
    for name, part in (("landmarks", np.s_[:, :1]), ("landmark_references", np.s_[:1])):
        given[name] = given[name][part]
    return Recording.from_arrays(name="one", **given).off(40, 0.5)


@PROJECTED
def test_a_simulated_scenario_counts_by_its_root_mean_squares(one_landmark: Recording) -> None:
    problem = recorded_problem(mixed(), [one_landmark], 100.0)
    assert problem.simulated.bias.shape[0] == 5
    assert problem.beside is not None
    costs = np.asarray(costs_by_scenario(GAINS, problem.beside))
    assert costs.shape == (2, 2)
    weight = np.zeros(50)
    weight[:10], weight[20:46] = 0.3, 1.0
    for i in range(2):
        one = problem.beside.select(np.array(i))
        filter = Candidate(ConstantGain(jnp.float32(9))).applied(one.filter)
        est = simulate(filter, one.samples, one.initial)
        assert one.samples.truth is not None
        w, x, y, z = one.samples.truth.attitude
        true = Rotation.from_quat(np.stack([x, y, z, w], axis=1))
        P = true.apply(np.stack(one.samples.truth.origin, axis=1))
        angle = (Rotation.from_matrix(np.asarray(est.rotation)) * true.inv()).magnitude()
        chord = np.degrees(2 * np.sin(angle / 2))
        off = np.linalg.norm(np.asarray(est.position) - P, axis=1)
        attitude, position = (np.sqrt(np.average(e**2, weights=weight)) for e in (chord, off))
        np.testing.assert_allclose(costs[i, 1], attitude + 100 * position, rtol=1e-3)


@PROJECTED
def test_each_group_has_its_share_of_what_is_minimised(one_landmark: Recording) -> None:
    problem = recorded_problem(mixed(share=0.25), [one_landmark], 100.0)
    assert problem.beside is not None
    vectors = jnp.log(jnp.array([[4.0], [9.0]], jnp.float32))
    apart = [
        np.asarray(costs_by_scenario(GAINS, each)) for each in (problem.training, problem.beside)
    ]
    expected = 0.75 * apart[0].mean(axis=0) + 0.25 * apart[1].mean(axis=0)
    costs = evaluate_population(
        vectors,
        problem.training,
        problem.space,
        objective=problem.experiment.objective,
        beside=problem.beside,
    )
    np.testing.assert_allclose(costs, expected, rtol=1e-5)


@PROJECTED
def test_a_scenario_that_ends_before_its_cost_window_costs_nothing(one_landmark: Recording) -> None:
    short = mixed("family.duration=[0.05, 0.05]", "cost.transient_weight=0.0")
    problem = recorded_problem(short, [one_landmark], 100.0)
    assert problem.beside is not None
    np.testing.assert_array_equal(costs_by_scenario(GAINS, problem.beside), 0.0)


@pytest.mark.quick
def test_recordings_with_other_sensors_are_refused_beside_scenarios(
    recordings: list[Recording],
) -> None:
    for given, words in (  # both together, as above, so that nothing is compiled
        (recordings, "pose has 2 vectors and 3 landmarks; allowed with simulated scenarios"),
        (recordings[::-1], r"attitude has no position \(attitude only\)"),
    ):
        with pytest.raises(ConfigError, match=f"simulated_share = 0.25: {words}"):
            recorded_problem(mixed(), given, 1.0)
    with pytest.raises(ConfigError, match=r"simulated_share = 0.25.*0.0 without recordings"):
        tuning_problem(mixed())
