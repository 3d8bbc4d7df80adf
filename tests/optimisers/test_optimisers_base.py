"""The box, the loop, its history, and properties that every optimiser must have."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.searches import AGENTS, ITERATIONS, Fixed, fixed_search, sphere, steered
from hypothesis import given
from hypothesis import strategies as st
from jax import Array

from posegsa.optimisers import (
    GSA,
    Box,
    DifferentialEvolution,
    Optimiser,
    ParticleSwarm,
    RandomSearch,
    Search,
    advance,
    box,
    from_unit,
    minimise,
    start,
)
from posegsa.optimisers.ask_tell import uniform

SIZE = {"agents": AGENTS, "iterations": ITERATIONS}
OPTIMISERS = [
    GSA(**SIZE),
    GSA(random="agent", bounds="reflect", **SIZE),
    RandomSearch(**SIZE),
    ParticleSwarm(**SIZE),
    DifferentialEvolution(**SIZE),
]
TARGET, KEY = box([-1, -2, 0], [1, 2, 0]), jax.random.key(1)


@cache
def searched(optimiser: Optimiser) -> list[Search]:
    """A search of `TARGET` before its first iteration and after each iteration."""
    seen = [start(optimiser, TARGET, KEY)]
    minimise(steered, TARGET, optimiser, KEY, chunk=1, callback=seen.append)
    return seen


# The box


def test_box_keeps_bounds_and_their_dtype() -> None:
    low, high = box([-1, 2], [3.5, 2])
    assert low.tolist() == [-1, 2]
    assert high.tolist() == [3.5, 2]
    assert low.dtype == high.dtype == jnp.float32
    with jax.enable_x64(True):
        assert box([0], [1]).lower.dtype == jnp.float64
        bounds = np.zeros(1, np.float32), np.ones(1, np.float32)
        assert box(*bounds).lower.dtype == jnp.float32


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([0, 2], [1, 1.5], r"lower\[1\] = 2.0, upper\[1\] = 1.5; allowed: lower <= upper"),
        ([0, np.nan], [1, 1], r"lower\[1\] = nan; allowed: a finite float32 number"),
        ([0], [np.inf], r"upper\[0\] = inf; allowed: a finite float32"),
        ([0], [1e300], r"upper\[0\] = inf; allowed: a finite float32"),
        ([0, 0], [1], r"lower has shape \(2,\), upper \(1,\); allowed: equal shapes"),
        (0.0, 1.0, r"lower has shape \(\); allowed: \(dimensions,\)"),
        ([], [], r"lower has shape \(0,\); allowed"),
    ],
)
def test_box_refuses(lower: Any, upper: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"box: {message}"):
        box(lower, upper)


FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False)


@given(FINITE, FINITE, st.floats(0, 1, width=32, allow_subnormal=False))
def test_from_unit_never_leaves_the_box(a: float, b: float, u: float) -> None:
    low, high = sorted((a, b))
    target = box([low, low, low, low], [high, high, high, low])
    x = from_unit(target, jnp.asarray([u, 0, 1, u], jnp.float32))
    assert low <= x[0] <= high
    assert x[1:].tolist() == [low, high, low]


def test_from_unit_maps_every_row() -> None:
    x = from_unit(box([0, -2], [10, 2]), jnp.array([[0.5, 0.5], [0.25, 1]]))
    assert x.tolist() == [[5, 0], [2.5, 2]]


# Every optimiser


@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_optimisers_keep_the_protocol(optimiser: Optimiser) -> None:
    assert hash(optimiser) == hash(type(optimiser)(**vars(optimiser)))
    with pytest.raises(ValueError, match="frozen"):
        optimiser.agents = 3
    for x64, dtype in ((False, jnp.float32), (True, jnp.float64)):
        with jax.enable_x64(x64):
            state = jax.eval_shape(lambda key, dtype=dtype: optimiser.init(key, 3, dtype), KEY)
            told = jax.eval_shape(optimiser.tell, state, jax.ShapeDtypeStruct((AGENTS,), dtype))
            assert jax.tree.map(jnp.shape, told) == jax.tree.map(jnp.shape, state)
            for s in (state, told):
                asked = jax.eval_shape(optimiser.ask, s)
                assert (asked.shape, asked.dtype) == ((AGENTS, 3), dtype)
    before = None
    for search in searched(optimiser):
        x = np.asarray(optimiser.ask(search.state))
        assert x.shape == (AGENTS, 3)
        assert np.all((x >= 0) & (x <= 1))
        assert not np.array_equal(x, before)
        before = x


@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_chunks_do_not_change_a_bit(optimiser: Optimiser) -> None:
    whole = minimise(steered, TARGET, optimiser, KEY)
    one_by_one = searched(optimiser)
    assert [int(s.iteration) for s in one_by_one] == list(range(ITERATIONS + 1))
    assert_same(one_by_one[-1], whole)
    for chunk, stops in ((3, [*range(3, ITERATIONS, 3), ITERATIONS]), (100, [ITERATIONS])):
        seen: list[Search] = []
        assert_same(
            minimise(steered, TARGET, optimiser, KEY, chunk=chunk, callback=seen.append), whole
        )
        assert [int(s.iteration) for s in seen] == stops
        assert_same(seen[-1], whole)


@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_fixed_coordinates_stay_fixed(optimiser: Optimiser) -> None:
    target = box([0, 0.1, -1 / 3], [1, 0.1, -1 / 3])
    search = minimise(steered, target, optimiser, jax.random.key(3))
    assert search.history.worst.tolist() == [0] * ITERATIONS
    assert search.best_position[1:].tolist() == target.lower[1:].tolist()


def test_same_key_same_search() -> None:
    one, again, other = (
        minimise(steered, TARGET, OPTIMISERS[0], jax.random.key(seed)) for seed in (4, 4, 5)
    )
    assert_same(one, again)
    assert not jnp.array_equal(one.best_position, other.best_position)


# The loop and its history


def test_a_search_that_has_not_begun() -> None:
    search = start(RandomSearch(agents=2, iterations=3), box([0, 4], [1, 4]), jax.random.key(0))
    assert search.best_position.tolist() == [0.5, 4]
    assert search.best_cost == jnp.inf
    assert search.iteration == search.non_finite == 0
    for record in search.history[:3]:
        assert jnp.isnan(record).all()
    assert search.history.non_finite.tolist() == [0, 0, 0]


def test_the_record_against_plain_numpy() -> None:
    optimiser = RandomSearch(**SIZE)
    *states, search = searched(optimiser)
    asked = [np.asarray(optimiser.ask(seen.state)) for seen in states]
    positions = [
        np.asarray(TARGET.lower) + x * np.subtract(TARGET.upper, TARGET.lower) for x in asked
    ]
    costs = [(x**2).sum(axis=1) for x in positions]
    lowest = np.minimum.accumulate(np.min(costs, axis=1))
    np.testing.assert_allclose(search.history.best, lowest, rtol=1e-6)
    np.testing.assert_allclose(search.history.mean, np.mean(costs, axis=1), rtol=1e-6)
    np.testing.assert_allclose(search.history.worst, np.max(costs, axis=1), rtol=1e-6)
    best = np.unravel_index(np.argmin(costs), (ITERATIONS, AGENTS))
    np.testing.assert_allclose(search.best_position, positions[best[0]][best[1]], atol=1e-6)
    assert search.best_cost == search.history.best[-1]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_cost_that_is_not_finite_never_wins(bad: float) -> None:
    search = fixed_search([bad, 3, bad, 2, 7])
    told = search.state.told
    assert told[1::2].tolist() == [3, 2]
    assert told[4] == 7
    assert jnp.all((told[0:4:2] > 7) & (told[0:4:2] < 7.00001))
    assert search.best_cost == 2
    assert search.best_position.tolist() == [3]
    assert search.non_finite == 2
    first = [float(record[0]) for record in search.history]
    assert first == [2, 4, 7, 2]
    search = fixed_search([bad, bad, 1, 5, bad], search)
    assert search.best_cost == 1
    assert search.best_position.tolist() == [2]
    assert search.non_finite == 5
    assert search.history.non_finite.tolist() == [2, 3, 0]
    assert search.state.told[2:4].tolist() == [1, 5]
    assert search.state.told[0] > 7, "no better than what the search has seen before"


def test_iterations_without_a_finite_cost() -> None:
    nothing = [np.nan, np.inf, -np.inf, np.nan, np.nan]
    search = fixed_search(nothing)
    assert jnp.all(search.state.told > 1e15)
    assert jnp.isfinite(jnp.sum(search.state.told**2)), "values calculated from it stay finite"
    assert search.best_cost == jnp.inf
    assert search.best_position.tolist() == [2]
    assert search.history.best[0] == jnp.inf
    assert jnp.isnan(search.history.mean[0])
    assert jnp.isnan(search.history.worst[0])
    search = fixed_search(nothing, fixed_search([5, 4, 3, 4, 5], search))
    assert jnp.all((search.state.told > 5) & (search.state.told < 5.00001))
    assert search.best_cost == 3
    assert search.non_finite == 10
    np.testing.assert_array_equal(search.history.best, [np.inf, 3, 3])
    np.testing.assert_allclose(search.history.mean, [np.nan, 4.2, np.nan], rtol=1e-6)


@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_a_population_without_a_finite_cost_continues(optimiser: Optimiser) -> None:
    search = minimise(steered, box([0, 0, 2e6], [1, 1, 2e6]), optimiser, jax.random.key(7))
    assert search.non_finite == AGENTS * ITERATIONS
    assert search.history.non_finite.tolist() == [AGENTS] * ITERATIONS
    assert jnp.isfinite(optimiser.ask(search.state)).all()


def test_advance_lives_in_the_callers_jit_and_compiles_once() -> None:
    optimiser, target = RandomSearch(agents=4, iterations=9), box([-1], [1])
    traces = []

    @jax.jit
    def run(search: Search, centre: Array, stop: int) -> Search:
        def distance(x: Array) -> Array:
            traces.append(x.shape)
            return jnp.abs(x[:, 0] - centre)

        return advance(optimiser, distance, target, search, stop)

    search = run(start(optimiser, target, jax.random.key(8)), jnp.float32(0), 0)
    assert search.iteration == 0
    first = len(traces)
    for stop in (1, 4, 4, 9, 20):
        search = run(search, jnp.float32(0.5), stop)
        assert search.iteration == min(stop, 9)
    assert len(traces) == first
    assert search.best_cost == jnp.abs(search.best_position[0] - 0.5)


def test_minimise_compiles_once_per_objective() -> None:
    traces = []

    def counted(x: Array) -> Array:
        traces.append(x.shape)
        return sphere(x)

    optimiser = RandomSearch(agents=4, iterations=5)
    minimise(counted, box([-1], [1]), optimiser, jax.random.key(0))
    first = len(traces)
    for chunk in (1, 2, 5):
        minimise(counted, box([-2], [3]), optimiser, jax.random.key(chunk), chunk=chunk)
    assert len(traces) == first


@pytest.mark.parametrize("chunk", [0, -1, 2.5, True])
def test_minimise_refuses_a_chunk(chunk: Any) -> None:
    message = f"minimise: chunk = {chunk}; allowed: a whole number from 1"
    with pytest.raises(ValueError, match=message):
        minimise(sphere, box([0], [1]), Fixed(), jax.random.key(0), chunk=chunk)


def test_objective_of_the_wrong_shape() -> None:
    with pytest.raises(
        ValueError, match=r"costs are float32 of shape \(5, 1\); allowed: real numbers \(5,\)"
    ):
        minimise(lambda x: x, box([0], [1]), Fixed(), jax.random.key(0))


def test_costs_of_another_dtype_are_cast() -> None:
    with jax.enable_x64(True):
        bounds = Box(jnp.zeros(1), jnp.ones(1))
        search = minimise(
            lambda x: jnp.arange(5, dtype=jnp.int32), bounds, Fixed(), jax.random.key(0)
        )
        assert search.best_cost.dtype == jnp.float64
        assert search.history.worst.tolist() == [4, 4, 4]


def test_a_key_means_the_same_in_every_dtype() -> None:
    with jax.enable_x64(True):
        key = jax.random.key(9)
        single, double = (uniform(key, (50,), dtype) for dtype in (jnp.float32, jnp.float64))
        assert single.dtype == jnp.float32
        assert double.dtype == jnp.float64
        assert single.tolist() == double.tolist()
