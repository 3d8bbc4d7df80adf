"""Filters without a fuzzy gain, found by tiny searches on drawn scenarios."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.own_filter import Complementary

from posegsa import config
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.observer import Observer, ObserverGains
from posegsa.filters.rollout import simulate_cost
from posegsa.judging.description import describe, described_filter
from posegsa.model.schedules import ConstantGain, SmoothGain
from posegsa.search.configured_filters import filter_of
from posegsa.search.population import evaluate_population
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.run_search import Found, run_search

pytestmark = pytest.mark.filterwarnings("ignore:scenario.initial_rotation:posegsa.PosegsaWarning")

FEW = [
    *("scenario.duration=0.5", "cost.transient_window=[0, 9]", "cost.steady_window=[20, 49]"),
    *("run.training_scenarios=2", "run.held_out_scenarios=1"),
]
CASES: dict[str, tuple[list[str], Any]] = {
    "constant": (["filter.schedule=constant"], None),
    "smooth": (["filter.schedule=smooth"], None),
    "believing": (
        [
            *("filter.schedule=constant", "filter.belief=smooth"),
            "scenario.landmarks=[{position=[0.5, 1.4, 1.0]}, {position=[-1.0, 0.5, 0.2]}]",
        ],
        None,
    ),
    "kalman": (["filter.kind=kalman", "filter.vector_bias=off"], None),
    "own": (
        [
            *("filter.kind=own", "filter.attitude_gain=1.0", "filter.position_gain=4.0"),
            'parameters.also=[{key="filter.attitude_gain", lower=0.1, upper=50.0, '
            'scale="logarithmic"}, {key="filter.position_gain", lower=1.0, upper=20.0}]',
        ],
        Complementary,
    ),
}


class Searched(NamedTuple):
    """A problem, and the results of two searches of it."""

    problem: TuningProblem
    found: Found
    again: Found


def problem_of(name: str) -> TuningProblem:
    settings, own = CASES[name]
    return tuning_problem(config.override(tiny(*FEW), settings), own=own)


@pytest.fixture(scope="module", params=CASES)
def searched(request: pytest.FixtureRequest) -> Searched:
    problem = problem_of(request.param)
    return Searched(problem, run_search(problem), run_search(problem))


def numbers_searched(problem: TuningProblem) -> int:
    """How many numbers the filter has that are searched."""
    schedules = {"constant": 1, "smooth": 3}
    schedule = getattr(problem.experiment.filter, "schedule", None)
    believing = getattr(problem.experiment.filter, "belief", "off") != "off"
    of_belief = 2 * 3 if believing else 0  # three numbers for vectors, three for landmarks
    return schedules.get(str(schedule), 0) + of_belief + len(problem.experiment.also)


def test_a_search_finds_the_best_that_it_saw_and_the_same_again(searched: Searched) -> None:
    problem, found, again = searched
    box = problem.space.box
    assert box.lower.shape == (numbers_searched(problem),) != (0,)
    np.testing.assert_array_equal(found.search.best_position, again.search.best_position)
    assert float(found.search.best_cost) == float(again.search.best_cost)
    history = found.search.history
    assert float(found.search.best_cost) == float(np.min(history.best)) < float(history.mean[0])
    assert (np.asarray(found.search.best_position) >= np.asarray(box.lower)).all()
    assert (np.asarray(found.search.best_position) <= np.asarray(box.upper)).all()


def test_the_numbers_matter(searched: Searched) -> None:
    """Each number that is searched changes the cost, so none of them is lost on the way."""
    problem, found, _ = searched
    box, best = problem.space.box, np.asarray(found.search.best_position)
    others = np.tile(best, (len(best) + 1, 1))
    for i, (low, high) in enumerate(zip(box.lower, box.upper, strict=True)):
        others[i, i] = low if best[i] - low > high - best[i] else high
    costs = evaluate_population(jnp.asarray(others), problem.training, problem.space)
    assert float(costs[-1]) == pytest.approx(float(found.search.best_cost), rel=1e-4)
    assert (np.asarray(costs[:-1]) != float(costs[-1])).all()


def test_the_filter_of_what_was_found_has_its_cost(searched: Searched) -> None:
    """Alone, of its stored numbers, it runs each scenario at the cost that the search saw."""
    problem, found, _ = searched
    candidate = problem.space.candidate(found.search.best_position)
    stored = describe(candidate, problem.experiment, 24)
    filter = described_filter(stored, problem.experiment, problem.own)
    kinds = {"kalman": KalmanFilter, "own": Complementary}
    assert type(filter) is kinds.get(stored.kind, Observer)
    if isinstance(filter, Observer):
        schedules = {"constant": ConstantGain, "smooth": SmoothGain}
        gains = filter.schedule
        gain = gains.gain if isinstance(gains, ObserverGains) else gains
        assert type(gain) is schedules[stored.kind]
    cost, batch = jax.jit(simulate_cost), problem.training
    assert batch.end is None, "all scenarios count to their end"
    costs = []
    for i in range(2):
        one = batch.select(np.array(i))
        parts = cost(filter, one.samples, one.initial, batch.weights)
        costs.append(float(parts.transient + parts.steady))
    assert np.mean(costs) == pytest.approx(float(found.search.best_cost), rel=1e-3)


def test_a_filter_that_is_made_serves_as_its_class_does() -> None:
    problem, made = problem_of("own"), Complementary(jnp.float32(9.0), jnp.float32(9.0))
    given = filter_of(problem.experiment, made)
    assert isinstance(given, Complementary)
    assert (float(given.attitude_gain), float(given.position_gain)) == (1.0, 4.0)
    ours, theirs = (
        run_search(tuning_problem(problem.experiment, own=own)).search
        for own in (made, lambda **numbers: Complementary(**numbers))
    )
    np.testing.assert_array_equal(ours.best_position, theirs.best_position)


def test_a_filter_of_the_users_own_that_can_not_be_is_refused() -> None:
    experiment = problem_of("own").experiment
    with pytest.raises(ArgumentError, match=r'filter: none with filter.kind = "own"'):
        tuning_problem(experiment)
    with pytest.raises(ArgumentError, match=r"filter, with filter.kind = 'observer'"):
        tuning_problem(tiny(), own=Complementary)
    with pytest.raises(ArgumentError, match=r"filter.*position_gain"):
        tuning_problem(experiment, own=lambda attitude_gain: Complementary(attitude_gain, 1.0))  # type: ignore[arg-type]  # a number less
    with pytest.raises(ArgumentError, match="filter"):
        tuning_problem(experiment, own=lambda **numbers: "fast")  # type: ignore[arg-type]  # no filter


def test_a_kalman_filter_without_the_options_for_speed_warns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.setattr("posegsa.search.run_search.run_timed", lambda *_: None)
    with pytest.warns(PosegsaWarning, match="enable_fast_path"):
        run_search(problem_of("kalman"))
