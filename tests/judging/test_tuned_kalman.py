"""The Kalman filter as a baseline: its noises are found, and its errors are those of the filter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny

from posegsa import steps
from posegsa.config import KALMAN_ALSO
from posegsa.filters.base import Sensors
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.rollout import simulate_errors
from posegsa.judging import tuned_kalman
from posegsa.judging.baselines import variant_of
from posegsa.judging.description import Description, candidate_of
from posegsa.judging.evaluation import EKF, EKF_CLOCK, EKF_GATED, EKF_VECTORS
from posegsa.judging.metrics import error_tracks
from posegsa.judging.tuned_kalman import first_agent, kalman_experiment, tune_kalman
from posegsa.optimisers.search_box import from_unit
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import training_keys
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import TuningProblem, tuning_problem

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

TINY = tiny()
"""The experiment of `test_evaluate`, so that its programs are compiled once."""
BOUNDS = {one.key: (one.lower, one.upper) for one in KALMAN_ALSO}
NOISES = {key: float(np.sqrt(low * high)) for key, (low, high) in BOUNDS.items()}


@pytest.fixture(scope="module")
def problem() -> TuningProblem:
    return tuning_problem(TINY)


def test_the_noises_are_all_that_the_filter_has() -> None:
    assert [key.removeprefix("filter.") for key in BOUNDS] == [*KalmanNoise._fields]
    assert all(0 < low < high for low, high in BOUNDS.values())


@pytest.fixture(scope="module")
def reports() -> list[steps.Step]:
    """What the searches of `found` report, after them."""
    return []


@pytest.fixture(scope="module")
def found(problem, reports):
    """Two searches of one generation, with the program of `test_evaluate`."""
    patch = pytest.MonkeyPatch()
    patch.setattr(tuned_kalman, "CHECK_INTERVAL", 20)
    patch.setattr(tuned_kalman, "MAX_EVALUATIONS", 40)
    beside = variant_of(problem, kalman_experiment(TINY, EKF))
    with steps.listening(reports.append):
        steps.begin("judging", 1, 2)
        yield [tune_kalman(beside) for _ in range(2)]
    patch.undo()


def test_a_search_reports_how_far_it_is(found, reports) -> None:
    shares = [one.done for one in reports]
    assert shares[0] == 1.0
    assert all(1.0 < share <= 2.0 for share in shares[1:])
    assert all(np.isfinite(one.best_cost) for one in reports[1:])


def test_noises_are_found_within_their_bounds_and_the_same_again(found) -> None:
    first, again = found
    assert first == again
    assert first.kind == "kalman"
    assert first.numbers == {}
    assert first.evaluations in (20, 40)
    expected = set(BOUNDS) - {"filter.vector_walk", "filter.initial_vector_bias"}
    assert set(first.also) == expected, "there are no such states"
    for key, noise in first.also.items():
        low, high = BOUNDS[key]
        assert low * (1 - 1e-6) <= noise <= high * (1 + 1e-6), key


def test_tracks_are_those_of_the_filter_one_by_one() -> None:
    """They are simulated in groups of 16; the last group is padded."""
    experiment = kalman_experiment(TINY, EKF)
    noises = NOISES | {"filter.vector": 0.1, "filter.landmark": 0.1}
    batch = scenario_batch(experiment, training_keys(0, 3))
    several = jax.device_get(batch).select(np.arange(26) % 3)
    candidate = candidate_of(Description("kalman", {}, noises, 20), experiment)
    tracks = error_tracks(candidate, several)
    noise = {key.removeprefix("filter."): jnp.float32(n) for key, n in noises.items()}
    filter, alone = (
        KalmanFilter(KalmanNoise(**noise), vector_biases=False),
        jax.jit(simulate_errors),
    )
    for i in range(3):
        scenario = jax.tree.map(lambda a, i=i: a[i], (several.samples, several.initial))
        for ours, theirs in zip(tracks, alone(filter, *scenario), strict=True):
            for same in range(i, 26, 3):
                np.testing.assert_allclose(ours[same], theirs, rtol=1e-3, atol=1e-5)
    assert tracks.position.shape == (26, 200)
    assert not np.allclose(tracks.position[0], tracks.position[1])


def test_only_with_vector_biases_are_there_such_states(problem) -> None:
    for name in (EKF, EKF_VECTORS):
        experiment = kalman_experiment(TINY, name)
        batch = variant_of(problem, experiment).training
        start = batch.filter.start(jax.tree.map(lambda a: a[0], batch.initial), Sensors(2, 1))
        assert len(start.covariance) == (18 if name == EKF_VECTORS else 12)
        assert batch.samples.sample.vectors.each[0].measured[0].shape == (3, 200), (
            "each, as measured"
        )


def test_it_reads_what_was_made_for_an_observer_that_learns_the_vectors_biases() -> None:
    learning = tuning_problem(tiny("filter.vector_bias=estimated"))
    experiment = kalman_experiment(learning.experiment, EKF_VECTORS)
    batch = variant_of(learning, experiment).training
    assert batch.samples is learning.training.samples, "nothing is drawn again"
    again = scenario_batch(experiment, training_keys(0, 3))
    candidate = candidate_of(Description("kalman", {}, NOISES, 0), experiment)
    agent = jax.tree.map(lambda a: a[None], candidate)
    costs = [np.asarray(costs_by_scenario(agent, each)) for each in (batch, again)]
    np.testing.assert_allclose(*costs, rtol=1e-4)


@pytest.mark.parametrize("name", [EKF_GATED, EKF_CLOCK])
def test_the_first_agent_has_the_configured_noises_and_schedules_without_effect(
    problem, name
) -> None:
    """So that a search of schedules can't begin worse than without them."""
    there = variant_of(problem, kalman_experiment(TINY, name))
    plain = variant_of(problem, kalman_experiment(TINY, EKF_VECTORS))
    first = from_unit(there.space.box, first_agent(there))
    agent = jax.tree.map(lambda a: a[None], there.space.candidate(first))
    costs = costs_by_scenario(agent, there.training)
    noises = Candidate(None, agent.values, agent.keys)
    np.testing.assert_allclose(costs, costs_by_scenario(noises, plain.training), rtol=1e-5)
