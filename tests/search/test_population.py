"""Many agents on many scenarios in one call: the same as one by one; compiled once.

However they are cut, they have the same bits: `test_devices`.
"""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from setups import lasting, paper, posed, repaired_terms, search_vectors, searched

from posegsa.model.rollout import simulate_cost
from posegsa.model.schedules import ConstantGain
from posegsa.search.candidates import Candidate
from posegsa.search.population import (
    ScenarioBatch,
    costs_by_scenario,
    evaluate_population,
)


def problem_of(*settings: str, dtype: str = "float32") -> ScenarioBatch:
    """Three scenarios of a second and a half: of one shape, so that one program draws them."""
    return posed(paper(*lasting(1.5), *settings, dtype=dtype), scenarios=3)


def costs_of(vectors: np.ndarray, problem: ScenarioBatch, *settings: str) -> np.ndarray:
    """Costs (A,) of parameter vectors (A, 22), at the problem's dtype."""
    made = searched(*settings, dtype=str(problem.dtype))
    return np.asarray(evaluate_population(jnp.asarray(vectors, problem.dtype), problem, made))


# Batches ------------------------------------------------------------------------------------------


# float32: another order of operations is a rounding in each of 150 steps, and the gain limit keeps
# it from growing; what remains was measured at 1e-6.
@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-11), ("float32", 1e-4)])
def test_a_population_equals_its_agents_and_scenarios_one_by_one(
    dtype: str, tolerance: float
) -> None:
    vectors = search_vectors(4)
    with jax.enable_x64(dtype == "float64"):
        problem = problem_of(dtype=dtype)
        made = searched(dtype=dtype)
        one = jax.jit(
            lambda k, tracks, initial: (
                simulate_cost(
                    made.candidate(k).schedule,
                    tracks,
                    initial,
                    problem.weights,
                    problem.settings,
                    problem.signal,
                ).total
            )
        )
        each = np.array(
            [
                [
                    one(
                        jnp.asarray(k, dtype),
                        *jax.tree.map(lambda a, s=s: a[s], (problem.samples, problem.initial)),
                    )
                    for k in vectors
                ]
                for s in range(3)
            ]
        )
        together = costs_of(vectors, problem)
    assert together.dtype == dtype
    assert together.shape == (4,)
    np.testing.assert_allclose(together, each.mean(axis=0), rtol=tolerance)
    # Scenarios and agents differ by far more than the tolerance.
    assert each.std(axis=0).min() > 1e-3 * each.mean()
    assert each.std(axis=1).min() > 1e-3 * each.mean()


def test_costs_by_scenario_are_scenarios_by_agents() -> None:
    problem = problem_of()
    gains = jnp.asarray([2.0, 20.0])
    costs = np.asarray(costs_by_scenario(Candidate(ConstantGain(gains)), problem))
    assert costs.shape == (3, 2)
    first = jax.tree.map(lambda a: a[:1], (problem.samples, problem.initial))
    alone = costs_by_scenario(
        Candidate(ConstantGain(gains)), problem._replace(samples=first[0], initial=first[1])
    )
    np.testing.assert_allclose(alone[0], costs[0], rtol=1e-5)  # float32 sums in another batch


def test_a_disordered_agent_costs_infinity_where_order_is_not_repaired() -> None:
    off = ("fuzzy.ordering=false", "fuzzy.coverage=false", "fuzzy.centroid=sampled")
    inputs, outputs = (t[0] for t in repaired_terms(search_vectors(1)))
    in_order = np.concatenate([inputs.ravel()[2:13], outputs.ravel()[2:13]])
    by_triangle, by_term = in_order.copy(), in_order.copy()
    by_triangle[[12, 13]] = [9.0, 3.0]  # k13 > k14, foot and peak of one term
    by_term[[13, 16]] = [19.0, 12.0]  # k14 > k17, peaks of two
    by_term[14] = 25.0
    problem = problem_of(*off)
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


def test_other_numbers_are_not_compiled_anew(caplog: pytest.LogCaptureFixture) -> None:
    vectors = search_vectors(4)  # as many as above

    def costs(*settings: str) -> np.ndarray:
        return costs_of(vectors, problem_of(*settings), *settings)

    def compiled() -> list[str]:
        return [r.getMessage() for r in caplog.records if "Compiling" in r.getMessage()]

    first = costs()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        other = costs(*OTHER_NUMBERS)
        assert compiled() == []
        jax.jit(lambda x: x + 1)(other)  # new, so that this test can fail
        assert len(compiled()) == 1
    assert (np.abs(other - first) > 1e-3).all()
