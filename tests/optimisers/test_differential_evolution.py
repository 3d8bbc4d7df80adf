"""Differential evolution, compared with a loop of the article's equations and with scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import random
from scipy import optimize

from posegsa.optimisers import DifferentialEvolution, minimise
from posegsa.optimisers.ask_tell import uniform
from posegsa.optimisers.differential_evolution import Strategy, distinct_others
from posegsa.optimisers.functions import ClassicalFunction


def test_the_first_agent_can_begin_at_a_position() -> None:
    """It is evaluated first, and kept until something costs less."""
    de = DifferentialEvolution(agents=6, iterations=2)
    at = jnp.asarray([0.25, 0.75])
    state = de.begin_at(de.init(jax.random.key(0), 2, at.dtype), at)
    np.testing.assert_array_equal(de.ask(state)[0], at)
    after = de.tell(state, jnp.arange(6.0))
    np.testing.assert_array_equal(after.position[0], at)
    assert float(after.cost[0]) == 0.0


def test_others_are_distinct_and_uniform() -> None:
    agents, draws = 5, 4000
    keys = random.split(random.key(0), draws)
    others = np.asarray(jax.jit(jax.vmap(lambda k: distinct_others(k, agents)))(keys))
    everyone = np.concatenate([np.broadcast_to(np.arange(agents), (draws, 1, agents)), others], 1)
    assert (np.diff(np.sort(everyone, axis=1), axis=1) > 0).all()
    for r in range(3):
        for i in range(agents):
            counts = np.bincount(others[:, r, i], minlength=agents)
            assert counts[i] == 0
            # Expected: 1000 of each other agent, with a standard deviation of 27.
            assert abs(np.delete(counts, i) - draws / 4).max() < 5 * 27.4


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("strategy", ["rand/1/bin", "best/1/bin"])
def test_generations_against_a_plain_loop(strategy: Strategy) -> None:
    de = DifferentialEvolution(agents=6, iterations=9, strategy=strategy, factor=0.8, crossover=0.4)
    state = de.init(random.key(1), 4, jnp.float64)
    tell, others = jax.jit(de.tell), jax.jit(distinct_others, static_argnums=1)
    rng = np.random.default_rng(1)
    x, known = np.array(state.position), np.full(6, np.inf)
    trial, redrawn, crossed = x.copy(), 0, 0
    for _ in range(6):
        costs = rng.normal(size=6)
        for i in range(6):
            if costs[i] <= known[i]:
                x[i], known[i] = trial[i], costs[i]
        _, *keys = random.split(state.key, 5)
        r = np.asarray(others(keys[0], 6))
        anew = np.asarray(uniform(keys[1], (6, 4), jnp.float64))
        drawn = np.asarray(uniform(keys[2], (6, 4), jnp.float32))
        sure = np.asarray(random.randint(keys[3], (6, 1), 0, 4))
        trial = x.copy()
        for i in range(6):
            base = x[r[0, i]] if strategy == "rand/1/bin" else x[np.argmin(known)]
            for d in range(4):
                if drawn[i, d] < 0.4 or d == sure[i, 0]:
                    trial[i, d] = base[d] + 0.8 * (x[r[1, i], d] - x[r[2, i], d])
                    crossed += 1
                    if not 0 <= trial[i, d] <= 1:
                        trial[i, d] = anew[i, d]
                        redrawn += 1
        state = tell(state, jnp.asarray(costs))
        np.testing.assert_allclose(de.ask(state), trial, rtol=1e-12)
        np.testing.assert_allclose(state.position, x, rtol=1e-12)
        assert state.cost.tolist() == known.tolist()
    assert redrawn > 0
    assert 6 * 6 < crossed < 6 * 24


def test_it_ends_where_scipys_does() -> None:
    # Same scheme, F, CR, agents, generations and bounds (redrawn): the median over seeds of each
    # is within the range of the other.
    function = ClassicalFunction("rastrigin", 4, shift=0.3)
    ours = minimise(
        function,
        function.box,
        DifferentialEvolution(agents=20, iterations=60, factor=0.5, crossover=0.7),
        random.split(random.key(2), 9),
    ).best_cost
    theirs = [
        optimize.differential_evolution(
            lambda x: np.asarray(_rastrigin(x - function.minimum)),
            list(zip(*map(np.asarray, function.box), strict=True)),
            strategy="rand1bin",
            popsize=5,
            maxiter=59,
            mutation=0.5,
            recombination=0.7,
            init="random",
            updating="deferred",
            polish=False,
            tol=0,
            rng=seed,
        ).fun
        for seed in range(9)
    ]
    assert min(theirs) < float(np.median(ours)) < max(theirs)
    assert float(min(ours)) < np.median(theirs) < float(max(ours))


def _rastrigin(z: np.ndarray) -> float:
    return float(np.sum(z**2 - 10 * np.cos(2 * np.pi * z) + 10))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"agents": 3}, "agents = 3\n    should be greater than or equal to 4"),
        (
            {"strategy": "rand/2"},
            "strategy = \"rand/2\"\n    should be 'rand/1/bin' or 'best/1/bin'",
        ),
        ({"factor": 2.5}, "factor = 2.5"),
        ({"crossover": 1.1}, "crossover = 1.1"),
    ],
)
def test_settings_out_of_range_are_refused(setting: dict, message: str) -> None:
    with pytest.raises(ValueError, match=f"not a valid DifferentialEvolution\n\n  {message}"):
        DifferentialEvolution(**setting)
