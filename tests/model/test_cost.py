"""The cost: its windows by hand, against the reference, and accumulated inside a simulation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.controllers import search_vectors
from helpers.experiments import PAPER, lasting, paper, space
from helpers.filters import start
from helpers.measurements import cost_of_estimates, sensed, tracked, trajectory_cost

from posegsa.config import CostConfig, ObjectiveConfig
from posegsa.filters.rollout import simulate, simulate_cost
from posegsa.model.cost import SquaredErrors, sample_error
from posegsa.model.schedules import FuzzyGain
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import cost_weights
from posegsa.search.population import over_scenarios

HAND = CostConfig(
    transient_weight=0.5,
    steady_weight=3.0,
    position_weight=0.25,
    transient_window=(1, 3),
    steady_window=(5, 6),
)


POWERS = jnp.asarray([2.0**k for k in range(8)])
"""Powers of two: their sum shows which samples it includes."""


def test_windows_include_both_ends() -> None:
    parts = trajectory_cost(POWERS, jnp.zeros(8), cost_weights(HAND, 8, jnp.dtype("float32")))
    assert float(parts.transient) == 0.5 * (2 + 4 + 8)
    assert float(parts.steady) == 3 * (32 + 64)
    assert float(parts.total) == 0.5 * 14 + 3 * 96


def test_the_position_error_is_weighted_against_the_attitude_error() -> None:
    weights = cost_weights(HAND, 8, jnp.dtype("float32"))
    parts = trajectory_cost(jnp.zeros(8), POWERS, weights)
    assert float(parts.total) == 0.25 * (0.5 * 14 + 3 * 96)
    assert float(sample_error(jnp.asarray(0.5), jnp.asarray(8.0), weights)) == 2.5


def test_windows_may_overlap_and_hold_one_sample() -> None:
    config = CostConfig(transient_window=(0, 2), steady_window=(2, 2), transient_weight=1.0)
    parts = trajectory_cost(POWERS[:3], jnp.zeros(3), cost_weights(config, 3, jnp.dtype("float32")))
    assert (float(parts.transient), float(parts.steady)) == (7, 4)


@pytest.mark.usefixtures("x64")
def test_the_papers_cost_against_the_reference() -> None:
    attitude, position = np.random.default_rng(0).random((2, 5, 1500))
    weights = cost_weights(PAPER.cost, 1500, jnp.dtype("float64"))
    costs = trajectory_cost(jnp.asarray(attitude), jnp.asarray(position), weights).total
    expected = [reference.cost(*errors) for errors in zip(attitude, position, strict=True)]
    np.testing.assert_allclose(costs, expected, rtol=1e-13)  # 1100 terms, summed in other orders


@pytest.mark.usefixtures("x64")
def test_the_trajectory_form_equals_the_running_form() -> None:
    experiment = paper(*lasting(2.0))
    truth, measurements = sensed(np.full(200, 0.01), [[0.6, 0, 0.8], [0, 1, 0]], [[0.5, 1.4, 1]])
    schedule = FuzzyGain(space().controller(jnp.asarray(search_vectors(1, seed=1)[0])))
    filter = replace(filter_of(experiment), schedule=schedule)
    scenario = tracked(measurements, truth, filter, "float64")
    weights = cost_weights(experiment.cost, 200, jnp.dtype("float64"))
    given = filter, scenario, start("float64")
    running = jax.jit(simulate_cost)(*given, weights)
    whole = cost_of_estimates(simulate(*given), scenario, weights)
    np.testing.assert_allclose(running, whole, rtol=1e-12)
    assert float(running.transient) > 0 < float(running.steady)


def test_objectives_over_scenarios_by_hand():
    costs = jnp.float32([[1, 5], [2, 5], [3, 5], [10, 5]])  # (scenarios, agents)

    def of(**settings):
        return np.asarray(over_scenarios(costs, ObjectiveConfig(**settings)))

    np.testing.assert_allclose(of(), [4, 5])
    np.testing.assert_allclose(of(name="median"), [2.5, 5])
    np.testing.assert_allclose(of(name="worst"), [10, 5])
    np.testing.assert_allclose(of(name="cvar", level=0.5), [6.5, 5])
    np.testing.assert_allclose(of(name="cvar", level=0.75), [10, 5])
    deviation = np.std([1, 2, 3, 10])
    np.testing.assert_allclose(of(name="mean_std", factor=2.0), [4 + 2 * deviation, 5], rtol=1e-6)


@pytest.mark.parametrize("name", ["mean", "median", "worst", "cvar", "mean_std"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_objective_forgives_a_scenario_that_diverges(name, bad):
    costs = jnp.float32([[1], [2], [3], [4], [bad]])
    assert not np.isfinite(over_scenarios(costs, ObjectiveConfig(name=name)))[0]


@pytest.mark.quick
def test_on_recordings_a_filter_that_diverged_costs_infinity() -> None:
    one, bad = jnp.float32(0.01), [jnp.float32(np.nan), jnp.float32(np.inf)]
    for squares in [(b, one) for b in bad] + [(one, b) for b in bad]:
        assert SquaredErrors(*squares).cost(jnp.float32(100)) == np.inf
    expected = np.degrees(2 * 0.1) + 100 * 0.1
    assert SquaredErrors(one, one).cost(jnp.float32(100)) == pytest.approx(expected, rel=1e-6)
