"""`minimise`: stopping conditions, many keys, objectives on the host, refused arguments."""

import sys
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.searches import AGENTS, ITERATIONS, steered
from jax import Array

from posegsa.optimisers import (
    Adam,
    ParticleSwarm,
    PolishedGSA,
    RandomSearch,
    Search,
    Until,
    advance,
    ask,
    box,
    minimise,
    start,
    tell,
)

SWARM, BOX, KEY = (
    ParticleSwarm(agents=AGENTS, iterations=ITERATIONS),
    box([-1, -2, 0], [1, 3, 0]),
    jax.random.key(1),
)


@pytest.fixture(scope="module")
def whole() -> Search:
    return minimise(steered, BOX, SWARM, KEY)


def first(condition: np.ndarray) -> int:
    """Number of iterations after which a condition first holds."""
    return int(np.argmax(condition)) + 1


@pytest.mark.parametrize("chunk", [None, 7])
def test_a_target_stops_the_search_when_it_is_reached(whole: Search, chunk: int | None) -> None:
    best = np.asarray(whole.history.best)
    target = float(best[12])
    seen: list[int] = []
    search = minimise(
        steered,
        BOX,
        SWARM,
        KEY,
        target=target,
        chunk=chunk,
        callback=lambda s: seen.append(int(s.iteration)),
    )
    assert search.iteration == first(best <= target) <= 13
    assert search.best_cost <= target
    assert jnp.isnan(search.history.best[int(search.iteration) :]).all()
    if chunk is not None:
        assert seen[-1] == search.iteration, "chunks after the end are not run"
        assert seen[:-1] == list(range(7, seen[-1], 7))


def test_stagnation_stops_the_search(whole: Search) -> None:
    best = np.asarray(whole.history.best, np.float64)
    for patience, tolerance in ((3, 0.0), (5, 0.5)):
        search = minimise(steered, BOX, SWARM, KEY, patience=patience, tolerance=tolerance)
        still = [
            i >= patience and best[i] >= best[i - patience] * (1 - tolerance) for i in range(40)
        ]
        assert any(still)
        assert search.iteration == first(np.array(still))


def test_evaluations_stop_the_search(whole: Search) -> None:
    for evaluations, iterations in ((5, 0), (6, 1), (65, 10), (10**6, 40)):
        search = minimise(steered, BOX, SWARM, KEY, evaluations=evaluations)
        assert search.iteration == iterations
        assert jnp.array_equal(search.history.best[:iterations], whole.history.best[:iterations])


def test_time_stops_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(100))
    ticking = SimpleNamespace(monotonic=lambda: float(next(clock)))  # only for this module
    monkeypatch.setattr(sys.modules["posegsa.optimisers.minimisation"], "time", ticking)
    search = minimise(steered, BOX, SWARM, KEY, seconds=3.0, chunk=7)
    assert search.iteration == 21, "one second per chunk"


def test_several_keys_give_what_each_gives_alone(whole: Search) -> None:
    keys = jnp.stack([KEY, jax.random.key(2)])
    seen: list[Any] = []
    many = minimise(  # with a target that is never reached, to use the program of the search below
        steered,
        BOX,
        SWARM,
        keys,
        target=-1.0,
        chunk=20,
        callback=lambda s: seen.append(s.iteration.tolist()),
    )
    assert seen == [[20, 20], [40, 40]]
    assert_same(jax.tree.map(lambda a: a[0], many._replace(state=None)), whole._replace(state=None))
    assert many.best_cost[0] != many.best_cost[1]
    until = minimise(steered, BOX, SWARM, keys, target=float(whole.history.best[12]))
    assert (until.iteration < 40).any()
    assert (until.best_cost <= until.history.best[:, 0]).all()


def test_until_works_inside_ones_own_jit(whole: Search) -> None:
    @jax.jit
    def run(target: Array) -> Search:
        started = start(SWARM, BOX, KEY)
        return advance(SWARM, steered, BOX, started, 40, Until(target=target))

    target = whole.history.best[12]
    assert run(target).iteration == first(np.asarray(whole.history.best) <= target)


def test_an_ordinary_function_is_minimised_on_the_host(whole: Search) -> None:
    kinds = set()

    def plain(x: np.ndarray) -> list[float]:
        kinds.add(type(x))
        return [float(row @ row) for row in x]

    search = minimise(plain, BOX, SWARM, KEY, python_objective=True, target=1e-3, chunk=10)
    assert kinds == {np.ndarray}
    assert search.best_cost <= 1e-3
    done = int(search.iteration)
    np.testing.assert_allclose(search.history.best[:done], whole.history.best[:done], rtol=1e-3)


def test_ask_and_tell_are_the_parts_of_the_loop(whole: Search) -> None:
    search, learn = start(SWARM, BOX, KEY), jax.jit(tell, static_argnums=0)
    for _ in range(3):
        positions = np.asarray(ask(SWARM, BOX, search))
        search = learn(SWARM, BOX, search, np.sum(positions**2, axis=1))
    np.testing.assert_allclose(search.history.best[:3], whole.history.best[:3], rtol=1e-6)


def test_a_gradient_on_the_host() -> None:
    adam = Adam(agents=2, iterations=20, learning_rate=0.1)
    search = minimise(lambda x: (np.sum(x**2, 1), 2 * x), BOX, adam, KEY, python_objective=True)
    assert search.best_cost < 0.02


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"key": 3}, r"key: a int; allowed: jax.random.key\(seed\)"),
        ({"key": jnp.zeros(2, jnp.uint32)}, r"key: a uint32 \(2,\); allowed"),
        ({"box": ((0, 0), (1, 1))}, r"box: a tuple; allowed: a Box, as posegsa.box\(lower"),
        ({"objective": 4.0}, "objective: a float; allowed: a function"),
        ({"optimiser": "gsa"}, r"optimiser: a str; allowed: settings such as posegsa.GSA"),
        ({"optimiser": ParticleSwarm}, "optimiser: a class; allowed: settings"),
        ({"evaluations": 0}, "evaluations = 0; allowed: a whole number from 1"),
        ({"seconds": -1}, "seconds = -1; allowed: a finite number"),
        ({"target": np.nan}, "target = nan; allowed: a finite number"),
        ({"patience": 1.5}, "patience = 1.5; allowed: a whole number from 1"),
        ({"tolerance": 0.1}, "tolerance = 0.1; allowed: with patience"),
        ({"tolerance": 0.1, "target": 1.0}, "tolerance = 0.1; allowed: with patience"),
        (
            {"python_objective": True, "key": jax.random.split(KEY, 2)},
            r"keys of shape \(2,\) on the host",
        ),
    ],
)
def test_bad_arguments_are_refused_by_name(change: dict[str, Any], message: str) -> None:
    arguments = {"objective": steered, "box": BOX, "optimiser": SWARM, "key": KEY} | change
    with pytest.raises(ValueError, match=f"minimise: {message}"):
        minimise(**arguments)


def test_a_polish_on_the_host_needs_gradients_once_it_descends() -> None:
    polish = PolishedGSA(agents=6, iterations=40, share=0.9, starts=1)
    seen: list[int] = []
    with pytest.raises(
        ValueError, match=r"objective: gradients are a NoneType; allowed: numbers \(1, 3"
    ):
        minimise(
            lambda x: np.sum(x**2, 1),
            BOX,
            polish,
            KEY,
            python_objective=True,
            chunk=1,
            callback=lambda s: seen.append(int(s.iteration)),
        )
    assert seen == [1, 2, 3, 4], "the search itself needs none"


@pytest.mark.parametrize("costs", [np.zeros((6, 1)), [[1], [2, 3]], "text", None])
def test_costs_of_another_form_are_refused(costs: Any) -> None:
    swarm = RandomSearch(agents=6, iterations=2)
    with pytest.raises(ValueError, match=r"objective: costs are .*; allowed: .*numbers \(6,\)"):
        minimise(lambda x: costs, BOX, swarm, KEY, python_objective=True)
