"""The untuned Kalman filter compared with a tuned one."""

import jax
import numpy as np
import pytest
from helpers.experiments import tiny

import posegsa
from posegsa import config
from posegsa.filters.kalman import KalmanFilter
from posegsa.judging.description import Description
from posegsa.judging.evaluation import UNTUNED
from posegsa.judging.metrics import error_tracks
from posegsa.judging.untuned import (
    SMALLEST_NOISE,
    bias_spread,
    untuned_kalman,
    with_idle_schedules,
)
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.problem import tuning_problem

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")


def noisy(**changes: object) -> config.Experiment:
    return tiny().replace(**{f"scenario.{name}": value for name, value in changes.items()})


@pytest.mark.quick
def test_its_noises_are_densities_of_the_scenario_s_own_sensors() -> None:
    vectors = [{"direction": [1.0, 0, 0], "noise": 0.3}, {"direction": [0, 0, 1.0], "noise": 0.4}]
    plain = untuned_kalman(
        noisy(sampling_time=0.0025, angular_velocity_noise=0.5, velocity_noise=0.0, vectors=vectors)
    )
    assert plain.filter.kind == "kalman"
    assert plain.filter.angular_velocity == pytest.approx(0.5 * 0.05)
    of_perfect_sensor = plain.filter.velocity
    assert of_perfect_sensor == pytest.approx(SMALLEST_NOISE * 0.05), "not 0"
    assert plain.filter.vector == pytest.approx(np.sqrt((0.09 + 0.16) / 2))
    assert plain.scenario.start == "sensors"


@pytest.mark.quick
def test_the_spread_of_biases_is_what_the_family_draws() -> None:
    fixed = noisy(angular_velocity_bias=[3.0, 0.0, 4.0])
    assert bias_spread(fixed).angular == pytest.approx(5 / np.sqrt(3))
    drawn = fixed.replace(**{"family.angular_velocity_bias": 0.25, "family.bias_scale": "off"})
    assert bias_spread(drawn).angular == 0.25
    scaled = fixed.replace(**{"family.bias_scale": [0.0, 3.0]})
    assert bias_spread(scaled).angular == pytest.approx(5 / np.sqrt(3) * np.sqrt(3))


def test_it_is_in_a_result_from_the_first_tune_on_with_the_clairvoyant() -> None:
    result = posegsa.tune(tiny())
    assert result.on_scenarios is not None
    judged = result.on_scenarios.evaluation
    assert judged.contenders[UNTUNED].filter == Description("kalman", {}, {}, 0)
    assert judged.clairvoyant is not None
    assert judged.clairvoyant.shape == (judged.scenarios,)
    assert np.all(judged.contenders[UNTUNED].metrics.initial_angle < 90), "it starts from sensors"
    assert UNTUNED in result.summary()


def test_where_no_sample_fixes_a_pose_it_is_left_out() -> None:
    """It would cost nothing there, since nothing counts before its start."""
    vectors = [{"direction": [1.0, 0.0, 0.0]}, {"direction": [0.0, 0.0, 1.0], "begin": 99.0}]
    result = posegsa.tune(noisy(vectors=vectors))
    assert result.on_scenarios is not None
    assert UNTUNED not in result.on_scenarios.evaluation.contenders


def of_kalman(*settings: str) -> config.Experiment:
    short = ["scenario.duration=2.0", "cost.steady_window=[150, 199]", "run.held_out_scenarios=2"]
    return config.override(config.load("kalman"), [*short, *settings])


def scheduled(*settings: str) -> config.Experiment:
    roles = ("filter.unknown=fuzzy", "filter.belief=ramp", "filter.belief_input=variance")
    return of_kalman("filter.vector_walk=0.01", *roles, *settings)


@pytest.mark.parametrize(
    "settings",
    [("filter.belief=off",), ("filter.vector_bias=off",)],
    ids=["walks of the vectors' biases", "belief"],
)
def test_idle_schedules_change_no_error(settings) -> None:
    problem = tuning_problem(scheduled(*settings))
    without = problem.held_out
    idle = with_idle_schedules(without, problem)
    assert isinstance(idle.filter, KalmanFilter)
    assert idle.filter.schedule.unknown is not None
    found, expected = (error_tracks(Candidate(), one, optimised=False) for one in (idle, without))
    assert expected.nees is not None
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)


@pytest.mark.quick
def test_with_idle_schedules_it_shares_the_program_of_the_filter_that_is_tuned() -> None:
    experiment = scheduled()
    problem = tuning_problem(experiment)
    untuned = problem.held_out._replace(filter=filter_of(untuned_kalman(experiment)))
    lower = problem.space.candidate(problem.space.box.lower)
    structure = jax.tree.structure(lower.applied(problem.simulated.filter))
    for one in (untuned, problem.held_out):
        assert jax.tree.structure(with_idle_schedules(one, problem).filter) == structure
    without_states = tuning_problem(scheduled("filter.vector_bias=off"))
    assert with_idle_schedules(untuned, without_states) is untuned, "that is another program anyway"


@pytest.mark.quick
@pytest.mark.parametrize("experiment", [tiny(), of_kalman()], ids=["observer", "Kalman"])
def test_beside_a_filter_without_schedules_of_noise_it_stays_as_it_is(experiment) -> None:
    problem = tuning_problem(experiment)
    untuned = problem.held_out._replace(filter=filter_of(untuned_kalman(experiment)))
    assert with_idle_schedules(untuned, problem) is untuned


@pytest.mark.quick
def test_a_user_s_own_schedules_stay_in_their_filter() -> None:
    """The space of a user's own filter has no schedules to take."""
    made = tuning_problem(scheduled())
    own = made.space.candidate(made.space.box.lower).applied(made.simulated.filter)
    problem = tuning_problem(of_kalman("filter.kind=own"), own=own)
    batch = problem.held_out
    assert with_idle_schedules(batch, problem) is batch
