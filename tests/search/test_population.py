"""Many agents on many scenarios in one call: the same costs as one by one, compiled once.

`test_devices` checks that every division into pieces gives the same bits.
"""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.controllers import repaired_terms, search_vectors
from helpers.experiments import lasting, paper, posed, searched

from posegsa.filters.rollout import simulate_cost
from posegsa.model.schedules import ConstantGain, SwitchGain
from posegsa.search.candidates import Candidate
from posegsa.search.population import (
    ScenarioBatch,
    costs_by_scenario,
    evaluate_population,
    partition,
)

AGENTS, SCENARIOS = 100, 2
"""The same as in `test_population_precision`, so that both files use the same programs."""


def problem_of(*settings: str, dtype: str = "float32") -> ScenarioBatch:
    return posed(paper(*settings, dtype=dtype), scenarios=SCENARIOS)


def costs_of(vectors: np.ndarray, problem: ScenarioBatch, *settings: str) -> np.ndarray:
    """Costs (A,) of parameter vectors (A, 22), at the problem's dtype."""
    made = searched(*settings, dtype=str(problem.dtype))
    return np.asarray(evaluate_population(jnp.asarray(vectors, problem.dtype), problem, made))


# Batches ------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_a_population_equals_its_agents_and_scenarios_one_by_one() -> None:
    """`test_population_precision` checks that float32 gives the same costs."""
    vectors = search_vectors(AGENTS, seed=1)
    problem, made = problem_of(dtype="float64"), searched()
    one = jax.jit(
        lambda k, tracks, initial: (
            simulate_cost(
                made.candidate(k).applied(problem.filter), tracks, initial, problem.weights
            ).total
        )
    )
    some = [0, 1, 50, 99]
    each = np.array(
        [
            [
                one(k, *jax.tree.map(lambda a, s=s: a[s], (problem.samples, problem.initial)))
                for k in vectors[some]
            ]
            for s in range(SCENARIOS)
        ]
    )
    together = costs_of(vectors, problem)
    assert together.dtype == np.float64
    assert together.shape == (AGENTS,)
    np.testing.assert_allclose(together[some], each.mean(axis=0), rtol=1e-11)
    # Scenarios and agents differ by far more than the tolerance.
    assert each.std(axis=0).min() > 1e-3 * each.mean()
    assert each.std(axis=1).min() > 1e-3 * each.mean()


def test_costs_by_scenario_are_scenarios_by_agents() -> None:
    problem, gains = problem_of(), np.float32([2.0, 20.0, 9.0])
    costs = np.asarray(costs_by_scenario(Candidate(ConstantGain(gains)), problem))
    assert costs.shape == (SCENARIOS, 3)
    assert len(np.unique(costs)) == costs.size
    other = np.asarray(
        costs_by_scenario(Candidate(ConstantGain(gains[[2, 0, 1]])), problem.select([1, 0]))
    )
    np.testing.assert_allclose(other, costs[::-1, [2, 0, 1]], rtol=1e-5)


@pytest.mark.parametrize("start", ["given", "sensors"])
def test_few_agents_on_many_scenarios_have_the_costs_of_each_scenario(start: str) -> None:
    """A piece holds several scenarios then; `test_recorded` checks this for recordings."""
    count, gains = 12, np.float32([2.0, np.nan, 20.0, 9.0])
    given = paper(f"scenario.start={start}", *lasting(0.3), dtype="float32")
    batch = posed(given, scenarios=count)
    assert partition(count, len(gains)).scenarios > 1
    together = np.asarray(costs_by_scenario(Candidate(ConstantGain(gains)), batch))
    assert np.isfinite(together).all(axis=0).tolist() == [True, False, True, True]
    assert len(np.unique(together[:, [0, 2, 3]])) == 3 * count
    for i in range(count):
        one = costs_by_scenario(Candidate(ConstantGain(gains)), batch.select(np.array([i])))
        np.testing.assert_allclose(together[i], one[0], rtol=1e-5)


def test_few_agents_may_share_numbers() -> None:
    gains, count = np.float32([2.0, 20.0, 9.0]), 12
    batch = posed(paper(*lasting(0.3), dtype="float32"), scenarios=count)
    shared, never = jnp.float32(0.1), jnp.float32(0.0)
    each = SwitchGain(gains, gains[::-1], jnp.full(3, shared), jnp.full(3, never))
    own = costs_by_scenario(Candidate(each), batch)
    costs = costs_by_scenario(Candidate(SwitchGain(gains, gains[::-1], shared, never)), batch)
    np.testing.assert_allclose(costs, own, rtol=1e-5)


def test_a_disordered_agent_costs_infinity_where_order_is_not_repaired() -> None:
    off = ("fuzzy.ordering=false", "fuzzy.coverage=false", "fuzzy.centroid=sampled")
    inputs, outputs = (t[0] for t in repaired_terms(search_vectors(1)))
    in_order = np.concatenate([inputs.ravel()[2:13], outputs.ravel()[2:13]])
    by_triangle, by_term = in_order.copy(), in_order.copy()
    by_triangle[[12, 13]] = [9.0, 3.0]  # k13 > k14, foot and peak of one term
    by_term[[13, 16]] = [19.0, 12.0]  # k14 > k17, peaks of two terms
    by_term[14] = 25.0
    problem = problem_of(*off, *lasting(0.3))
    vectors = np.stack([in_order, by_triangle, by_term])
    costs = costs_of(vectors, problem, *off)
    assert np.isfinite(costs).tolist() == [True, False, False]
    assert np.isposinf(costs[1:]).all()


# One compilation ----------------------------------------------------------------------------------

OTHER_NUMBERS = (
    "filter.gamma=[2.0, 3.0]",
    "filter.gain_limit=1.2",
    "gain.position_weight=0.3",
    "gain.error_scale=2.0",
    "gain.rate_scale=0.5",
    "scenario.velocity_noise=0.3",
    "scenario.vectors.0.noise=0.02",
    "scenario.vectors.1.weight=0.5",
    "scenario.landmarks.0.weight=2.0",
    "scenario.landmarks.0.position=[1.0, 2.0, 0.0]",
    "filter.cross_vector_weight=0.7",
    "scenario.velocity_bias=[0.0, 0.1, 0.0]",
    "scenario.angular_velocity.0.0.frequency=2.0",
    "scenario.initial_position_estimate=[1.0, 2.0, 3.0]",
    "cost.position_weight=0.5",
    "cost.transient_window=[0, 3]",
    "cost.steady_weight=2.0",
    "fuzzy.overlap=0.02",
    "parameters.lower.11=1.0",
)


def test_other_numbers_are_not_compiled_again(caplog: pytest.LogCaptureFixture) -> None:
    vectors = search_vectors(AGENTS, seed=1)

    def costs(*settings: str) -> np.ndarray:
        return costs_of(vectors, problem_of(*settings), *settings)

    def compiled() -> list[str]:
        return [r.getMessage() for r in caplog.records if "Compiling" in r.getMessage()]

    first = costs()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        other = costs(*OTHER_NUMBERS)
        assert compiled() == []
        jax.jit(lambda x: x + 1)(other)  # a new program, to show that the test can fail
        assert len(compiled()) == 1
    assert (np.abs(other - first) > 1e-3).all()
