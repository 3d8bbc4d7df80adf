"""The costs that optimisers get for positions without a finite cost, and their effect."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.searches import AGENTS, FIXED_BOX, ITERATIONS, Fixed, fixed_search, steered

from posegsa.optimisers import (
    GSA,
    DifferentialEvolution,
    Optimiser,
    ParticleSwarm,
    Search,
    box,
    minimise,
    start,
    tell,
)
from posegsa.optimisers.ask_tell import FailureCost
from posegsa.optimisers.gsa import masses

learn = jax.jit(tell, static_argnums=0)
"""`tell`, compiled once for each optimiser."""


@pytest.mark.parametrize("worst", [-7.0, -1e-38, 0.0, 1e-42, 1.0, 3e38, 3.4028235e38])
def test_a_failure_costs_more_than_the_worst_finite_cost(worst: float) -> None:
    told = fixed_search([np.nan, worst, worst, worst, worst]).state.told
    assert jnp.isfinite(told).all()
    assert told[0] > told[1] or worst > 3.4e38


SIZE = {"agents": AGENTS, "iterations": ITERATIONS}
KEEPING = [
    ParticleSwarm(**SIZE),
    DifferentialEvolution(**SIZE),
    DifferentialEvolution(strategy="best/1/bin", **SIZE),
]
"""Optimisers that store costs."""


def kept(optimiser: Optimiser, search: Search) -> tuple[np.ndarray, np.ndarray]:
    """The positions that an optimiser keeps, and their costs."""
    swarm = isinstance(optimiser, ParticleSwarm)
    names = ("best_position", "best_cost") if swarm else ("position", "cost")
    positions, costs = (np.asarray(getattr(search.state, name)) for name in names)
    return positions, costs


@pytest.mark.parametrize(
    ("optimiser", "shift"),
    [
        (KEEPING[0], -1000.0),
        (KEEPING[0], 1000.0),
        (KEEPING[1], -1000.0),
        (KEEPING[1], 0.0),
        (KEEPING[2], 1000.0),
    ],
)
def test_a_first_iteration_without_a_finite_cost_is_overcome(
    optimiser: Optimiser, shift: float
) -> None:
    target, key = box([-1, -1, shift], [1, 1, shift]), jax.random.key(11)
    search = start(optimiser, target, key)
    search = learn(optimiser, target, search, np.full(6, np.nan))
    search = minimise(steered, target, optimiser, key, search=search)
    positions, costs = kept(optimiser, search)
    expected = np.sum((2 * positions[:, :2] - 1) ** 2, 1) + shift
    np.testing.assert_allclose(costs, expected, atol=1e-3)
    assert np.ptp(costs) < 0.3
    assert search.best_cost == costs.min() < search.history.best[1] - 1e-3


@pytest.mark.parametrize("optimiser", KEEPING)
def test_a_failure_never_takes_the_place_of_a_real_cost(optimiser: Optimiser) -> None:
    """Costs fall with each iteration, so the worst cost is below the stored costs."""
    target, rng = box([0, 0, 0], [1, 1, 0]), np.random.default_rng(0)
    search = start(optimiser, target, jax.random.key(12))
    judged = np.zeros(6, bool)
    for iteration in range(12):
        costs = rng.uniform(0.1, 1, 6) * 0.5**iteration
        costs[rng.permutation(6)[: rng.integers(3, 6)]] = np.nan  # sometimes all but one
        before, known = kept(optimiser, search)
        search = learn(optimiser, target, search, costs)
        positions, now = kept(optimiser, search)
        stays = np.isnan(costs) & judged
        assert (positions[stays] == before[stays]).all()
        assert (now[stays] == known[stays]).all()
        better = ~np.isnan(costs) & ~(costs.astype(np.float32) >= known)
        assert (now[better] == costs[better].astype(np.float32)).all()
        judged |= ~np.isnan(costs)
        assert now.argmin() in np.flatnonzero(judged), "the best of all was judged"
    assert judged.all()


class Gravity(Fixed):
    """Gets the same costs for failures as GSA."""

    failure_cost: ClassVar[FailureCost] = GSA.failure_cost


def test_gravity_tells_a_lone_real_cost_from_failures() -> None:
    search, told = start(Gravity(), FIXED_BOX, jax.random.key(13)), []
    for costs in ([np.nan] * 5, [np.nan, 0, np.inf, np.nan, np.nan], [1, np.nan, 3, 2, 3]):
        search = learn(Gravity(), FIXED_BOX, search, np.array(costs))
        told.append(np.asarray(search.state.told))
    assert np.isfinite(told[0]).all()
    assert np.asarray(masses(told[1])).tolist() == [0, 1, 0, 0, 0]
    assert told[2].tolist() == [1, 3, 3, 2, 3], "an old cost does not weigh in"
