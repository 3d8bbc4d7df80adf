"""Per-scenario metrics against their definitions, by hand and on real runs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny

from posegsa.filters.rollout import ErrorTrack
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.judging.trajectory import trajectory_on
from posegsa.model.schedules import ConstantGain
from posegsa.search import groups
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import cost_weights
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import tuning_problem

EXPERIMENT = tiny("cost.transient_window=[0, 50]", "cost.steady_window=[100, 199]")

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


@pytest.fixture(scope="module")
def posed():
    """Six scenarios of a tuning run of this size."""
    return tuning_problem(EXPERIMENT).scenarios


@pytest.fixture(scope="module")
def tracks(posed):
    return error_tracks(Candidate(ConstantGain(jnp.float32(20))), posed)


def made(attitude, position, posed) -> ErrorTrack:
    """An ErrorTrack with given errors, (S, 200) each."""
    S = len(attitude)
    return ErrorTrack(
        attitude=np.float32(attitude),
        position=np.float32(position),
        gain=np.ones((S, 200), np.float32),
        distance=np.float32(2 * np.asarray(position)),
        bias=np.zeros((S, 6)),
        vector_bias=np.zeros((S, 0, 3)),
    )


def test_the_cost_is_the_running_cost(posed, tracks):
    found, _ = metrics_of(tracks, posed)
    running = costs_by_scenario(Candidate(ConstantGain(jnp.float32([20]))), posed)[:, 0]
    np.testing.assert_allclose(found.cost, running, rtol=1e-5)
    np.testing.assert_allclose(found.transient + found.steady, found.cost)


def test_a_program_that_is_not_optimised_computes_the_same(posed, tracks):
    found = error_tracks(Candidate(ConstantGain(jnp.float32(20))), posed, optimised=False)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(tracks), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)


def test_the_distance_is_from_the_estimated_to_the_true_position(posed, tracks):
    assert tracks.distance.shape == tracks.position.shape == (6, 200)
    run = trajectory_on(Candidate(ConstantGain(jnp.float32(20))), posed, 3)
    away = np.linalg.norm(run.position_est - run.position, axis=1)
    np.testing.assert_allclose(tracks.distance[3], away, rtol=1e-4, atol=1e-5)
    assert np.abs(tracks.distance - tracks.position).max() > 0.01, "they are two things"


def test_settling_is_the_last_time_outside(posed):
    position = np.zeros((4, 200))
    position[0, :37] = 1.0  # outside until sample 36
    position[1, 100] = 0.6  # outside again
    position[2, 199] = 0.6  # outside at the very end
    attitude = np.zeros((4, 200))
    found, _ = metrics_of(made(attitude, position, posed), posed.select(slice(4)))
    np.testing.assert_allclose(found.settling_position, [0.37, 1.01, np.inf, 0.0], atol=1e-6)
    np.testing.assert_array_equal(found.settling_attitude, 0)


def test_rms_and_angles_are_in_degrees_and_metres(posed):
    distance = np.sin(np.radians(30) / 2) ** 2
    found, bands = metrics_of(
        made(np.full((2, 200), distance), np.full((2, 200), 0.25), posed), posed.select(slice(2))
    )
    np.testing.assert_allclose(found.rms_attitude, 30, rtol=1e-6)
    np.testing.assert_allclose(found.rms_position, 0.25, rtol=1e-6)
    np.testing.assert_allclose(found.rms_distance, 0.5, rtol=1e-6)
    np.testing.assert_allclose(found.initial_angle, 30, rtol=1e-6)
    np.testing.assert_allclose(bands.attitude, 30, rtol=1e-6)


@pytest.mark.parametrize("weight", [0.0, 5e-324])
def test_the_rms_is_that_of_the_window_also_where_it_has_no_weight(posed, tracks, weight):
    """The weight 5e-324 is 0 in float32."""
    cost = EXPERIMENT.cost.model_copy(update={"steady_weight": weight})
    weights = cost_weights(cost, 200, jnp.dtype("float32"))
    found, _ = metrics_of(tracks, posed._replace(weights=weights))
    assert found.steady.tolist() == [0.0] * 6
    weighted, _ = metrics_of(tracks, posed)
    np.testing.assert_array_equal(found.rms_attitude, weighted.rms_attitude)
    np.testing.assert_array_equal(found.rms_position, weighted.rms_position)


def test_divergence_is_lost_errors_or_no_finite_cost(posed):
    attitude, position = np.zeros((4, 200)), np.zeros((4, 200))
    attitude[1, -120:] = 0.9  # 143 degrees over the last second
    position[2, -120:] = 6.0
    position[3, 150:] = np.nan
    found, bands = metrics_of(made(attitude, position, posed), posed.select(slice(4)))
    assert found.diverged.tolist() == [False, True, True, True]
    assert found.cost[3] == np.inf
    assert np.isfinite(bands.position).all(), "runs without a cost are left out of the bands"


def test_the_bias_error_is_against_the_true_bias(posed, tracks):
    found, _ = metrics_of(tracks, posed)
    true = np.asarray(EXPERIMENT.scenario.angular_velocity_bias)
    np.testing.assert_allclose(
        found.bias_angular, np.linalg.norm(tracks.bias[:, :3] - true, axis=1), rtol=1e-5
    )


def test_groups_give_what_one_call_gives(posed, tracks, monkeypatch):
    monkeypatch.setattr(groups, "SCENARIOS", 4)  # of six, so the last group is padded
    monkeypatch.setattr(groups, "LENGTH", 200)
    again = error_tracks(Candidate(ConstantGain(jnp.float32(20))), posed)
    for whole, parts in zip(jax.tree.leaves(tracks), jax.tree.leaves(again), strict=True):
        np.testing.assert_allclose(parts, whole, rtol=1e-4, atol=1e-6)
