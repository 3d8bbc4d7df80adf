"""Gradient descent: Adam compared with the article, gradients of the filter, and polish."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.experiments import tiny
from jax import Array, random

from posegsa.errors import ConfigError
from posegsa.optimisers import (
    GSA,
    Adam,
    Differentiable,
    ParticleSwarm,
    Polish,
    PolishedGSA,
    RandomSearch,
    advance,
    ask,
    box,
    from_unit,
    minimise,
    start,
    tell,
)
from posegsa.optimisers.adam import MAX_BETA
from posegsa.search.keys import keys
from posegsa.search.population import evaluate_population
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import run_search

TARGET = box([-1.0, -2.0], [3.0, 2.0])
learn = jax.jit(tell, static_argnums=0)
"""`tell`, compiled once for each optimiser."""


def bowl(x: Array) -> Array:
    """Weighted squares about (2.5, -3): the minimum lies outside `TARGET` in one coordinate."""
    return 3 * (x[:, 0] - 2.5) ** 2 + 0.5 * (x[:, 1] + 3) ** 2


def bowl_gradient(x: np.ndarray) -> np.ndarray:
    return np.stack([6 * (x[:, 0] - 2.5), x[:, 1] + 3], axis=1)


@pytest.mark.usefixtures("x64")
def test_steps_against_algorithm_1() -> None:
    adam = Adam(agents=2, iterations=5, learning_rate=0.2, beta1=0.8, beta2=0.95, epsilon=1e-6)
    target = box([-1.0, -2.0], [3.0, 2.0])
    search = start(adam, target, random.key(0))
    theta = np.array(search.state.position)
    m = v = np.zeros((2, 2))
    for t in range(1, 6):
        x = np.array(ask(adam, target, search))
        np.testing.assert_allclose(x, from_unit(target, jnp.asarray(theta)), rtol=1e-12)
        gradient = bowl_gradient(x)
        search = learn(adam, target, search, np.zeros(2), gradient)
        g = gradient * 4  # the box is 4 wide
        m, v = 0.8 * m + 0.2 * g, 0.95 * v + 0.05 * g**2
        step = (m / (1 - 0.8**t)) / (np.sqrt(v / (1 - 0.95**t)) + 1e-6)
        rate = 0.5 * 0.2 * (1 + np.cos(np.pi * (t - 1) / 5))
        theta = np.clip(theta - rate * step, 0, 1)
        np.testing.assert_allclose(search.state.position, theta, rtol=1e-12)


DESCENT = Adam(agents=3, iterations=40, learning_rate=0.1)


def test_it_finds_a_minimum_on_the_face_of_the_box() -> None:
    search = minimise(bowl, TARGET, DESCENT, random.key(1))
    np.testing.assert_allclose(search.best_position, [2.5, -2], atol=0.02)
    assert DESCENT.evaluations == 40 * 3 * 23


def test_gradients_that_are_not_finite_are_counted_and_reported_as_zero() -> None:
    search = start(DESCENT, TARGET, random.key(2))
    bad = np.array([[1, np.nan], [np.inf, 1], [1, 2]])
    after = learn(DESCENT, TARGET, search, np.array([1.0, 2.0, np.nan]), bad)
    assert after.non_finite == 3
    assert after.best_cost == 1, "the cost of a position with a bad gradient is still its cost"
    assert (after.state.position == search.state.position).all()
    with pytest.raises(ValueError, match=r"gradients are a NoneType; allowed: numbers \(3, 2\)"):
        tell(DESCENT, TARGET, search, np.zeros(3))
    with pytest.raises(ValueError, match=r"gradients are float32 of shape \(3,\)"):
        tell(DESCENT, TARGET, search, np.zeros(3), np.zeros(3))


def test_an_objective_may_bring_its_own_gradient() -> None:
    calls = []

    def both(x: Array) -> tuple[Array, Array]:
        calls.append(x.shape)
        return bowl(x), jnp.stack([6 * (x[:, 0] - 2.5), x[:, 1] + 3], axis=1)

    own = minimise(Differentiable(bowl, both), TARGET, DESCENT, random.key(1))
    assert calls == [(3, 2)]
    derived = minimise(bowl, TARGET, DESCENT, random.key(1))
    np.testing.assert_allclose(own.best_position, derived.best_position, rtol=1e-5)


POLISH = PolishedGSA(agents=5, iterations=282, share=276 / 282, starts=2, g0=50.0)


def both(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`bowl` and its gradient, on the host."""
    return 3 * (x[:, 0] - 2.5) ** 2 + 0.5 * (x[:, 1] + 3) ** 2, bowl_gradient(x)


def test_polish_descends_from_the_best_and_chunks_do_not_change_a_bit() -> None:
    polish = POLISH
    search, descent = polish.phases
    assert search == GSA(agents=5, iterations=6, g0=50.0)
    assert descent == Adam(agents=2, iterations=30)
    whole = minimise(bowl, TARGET, polish, random.key(3))
    first = minimise(bowl, TARGET, search, random.key(3))
    assert whole.history.best[:6].tolist() == first.history.best.tolist()
    assert whole.history.best[6] <= first.best_cost * 1.001
    assert whole.best_cost < first.best_cost
    assert polish.evaluations_spent().tolist()[5:8] == [30, 30 + 46, 30 + 92]
    for chunk in (1, 6, 4):
        assert_same(minimise(bowl, TARGET, polish, random.key(3), chunk=chunk), whole)


def test_any_search_is_polished_by_a_class_of_both() -> None:
    class PolishedSwarm(Polish, ParticleSwarm):
        searching = ParticleSwarm

    still = {"inertia": 0.0, "cognitive": 0.0, "social": 0.0}
    polish = PolishedSwarm(agents=5, iterations=60, starts=2, share=0.8, **still)
    swarm, descent = polish.phases
    assert swarm == ParticleSwarm(agents=5, iterations=12, **still)
    assert (descent.agents, descent.iterations) == (2, 5 * 48 // 46)
    longer = PolishedSwarm(agents=5, iterations=282, starts=2, share=276 / 282, **still)
    search = minimise(both, TARGET, longer, random.key(3), python_objective=True)
    assert search.best_cost < search.history.best[5]
    with pytest.raises(ConfigError, match=r"share = 0\.5\s+leaves 30 of 6 x 10 .* at least 184"):
        PolishedGSA(agents=6, iterations=10)
    with pytest.raises(ValueError, match="of several phases"):
        ask(polish, TARGET, start(polish, TARGET, random.key(3)))


def test_polish_on_the_host_is_what_it_is_compiled() -> None:
    begin = start(POLISH, TARGET, random.key(5))
    search = advance(POLISH, both, TARGET, begin, 100, python_objective=True)
    compiled = minimise(bowl, TARGET, POLISH, random.key(5))
    assert search.iteration == compiled.iteration == POLISH.total_iterations == 36
    np.testing.assert_allclose(search.history.best, compiled.history.best, rtol=1e-5)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"learning_rate": -1}, "learning_rate = -1"),
        ({"beta1": 1.0}, r"beta1 = 1\.0 should be less than or equal to 0.999999"),
        ({"beta2": 1 - 1e-9}, "beta2 = 0.999999999"),
        ({"epsilon": 0.0}, r"epsilon = 0\.0 should be greater than or equal to 1\.17549e-38"),
        ({"gradient_price": 0}, "gradient_price = 0"),
    ],
)
def test_settings_out_of_range_are_refused(setting: dict, message: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Adam(**setting)
    assert re.match(f"not a valid Adam {message}", " ".join(str(refused.value).split()))


def inclined(x: Array) -> Array:
    return x[:, 1] * x[:, 0]


def test_the_outermost_settings_stay_finite_without_a_slope() -> None:
    tiny = float(np.finfo(np.float32).tiny)
    extreme = Adam(agents=3, iterations=5, beta1=MAX_BETA, beta2=MAX_BETA, epsilon=tiny)
    for slope in (0.0, 1e-30, 1.0):  # a coordinate that the box fixes
        target = box([-1.0, slope], [3.0, slope])
        search = minimise(inclined, target, extreme, random.key(4))
        assert jnp.isfinite(search.state.position).all(), slope
        assert search.non_finite == 0


SMALL = [
    "run.dtype=float64",
    "run.training_scenarios=1",
    "search.optimiser=adam",
    "search.agents=2",
    "search.iterations=1",
    "filter.substeps=1",
    "filter.cross_vector=false",
    "gain.smoothing=0.0",
    "gain.error_scale=8.0",
    "scenario.duration=1.0",
    "cost.transient_window=[0, 20]",
    "cost.steady_window=[50, 99]",
]


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_gradients_of_the_filter_against_central_differences() -> None:
    # After one step of Adam the first moment is (1 - beta1) times the gradient.
    with jax.enable_x64(True):
        task = tuning_problem(tiny(*SMALL))
        search = run_search(task).search
        assert search.iteration == 1
        box = task.space.box
        lower, width = np.asarray(box.lower), np.asarray(box.upper - box.lower)
        first = task.experiment.search.init(keys(0).search, 22, jnp.float64).position
        gradient = np.asarray(search.state.moments.mu) / 0.1
        h = 1e-6
        moves = np.concatenate([h * np.eye(22), -h * np.eye(22)])
        for i in range(2):
            at = lower + width * (np.asarray(first[i]) + moves)
            costs = np.asarray(evaluate_population(jnp.asarray(at), task.training, task.space))
            differences = (costs[:22] - costs[22:]) / (2 * h)
            np.testing.assert_allclose(gradient[i], differences, rtol=1e-4, atol=1e-6)
        assert np.abs(gradient).max() > 0.01
        # The first costs of the optimiser belong to the same positions.
        costs = evaluate_population(
            jnp.asarray(np.tile(lower + width * np.asarray(first), (22, 1))),
            task.training,
            task.space,
        )
        np.testing.assert_allclose(search.best_cost, costs.min(), rtol=1e-9)


def test_random_search_spends_an_evaluation_an_agent() -> None:
    assert RandomSearch(agents=4, iterations=3).evaluations_spent().tolist() == [4, 8, 12]
