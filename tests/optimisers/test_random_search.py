"""Random search: uniform, independent, and independent of the costs."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from posegsa.optimisers import RandomSearch, box, from_unit, minimise

pytestmark = pytest.mark.quick


def draws(optimiser: RandomSearch, dimensions: int, iterations: int) -> np.ndarray:
    """Positions of several iterations, (iterations, agents, dimensions)."""
    state = optimiser.init(jax.random.key(0), dimensions, jnp.float32)
    positions = []
    for _ in range(iterations):
        positions.append(np.asarray(optimiser.ask(state)))
        state = optimiser.tell(state, jnp.zeros(optimiser.agents))
    return np.array(positions)


def test_positions_are_uniform_and_independent() -> None:
    # The key is fixed, so nothing fails by chance. With 4000 draws a wrong distribution gives a
    # p-value far below 1e-3.
    x = draws(RandomSearch(agents=1000, iterations=4), 3, 4)
    for d in range(3):
        assert stats.kstest(x[..., d].ravel(), "uniform").pvalue > 1e-3
    columns = x.transpose(0, 2, 1).reshape(12, 1000)
    correlation = np.corrcoef(columns) - np.eye(12)
    assert abs(correlation).max() < 5 / np.sqrt(1000)  # five standard deviations


def test_positions_fill_the_box() -> None:
    target = box([-3, 5], [1, 5.5])
    x = from_unit(target, jnp.asarray(draws(RandomSearch(agents=2000), 2, 1)[0]))
    np.testing.assert_allclose(x.min(axis=0), target.lower, atol=0.01)
    np.testing.assert_allclose(x.max(axis=0), target.upper, atol=0.01)


def test_costs_do_not_matter() -> None:
    optimiser = RandomSearch(agents=4)
    state = optimiser.init(jax.random.key(1), 2, jnp.float32)
    one, other = (optimiser.tell(state, jnp.full(4, cost)) for cost in (0.0, 9.0))
    assert one.position.tolist() == other.position.tolist() != state.position.tolist()


def test_it_finds_a_minimum_slowly() -> None:
    # Of 25 000 points in a square the nearest is about 1 / sqrt(25 000 pi) = 4e-3 from the middle.
    search = minimise(
        lambda x: jnp.sqrt(jnp.sum(x**2, axis=1)),
        box([-0.5, -0.5], [0.5, 0.5]),
        RandomSearch(),
        jax.random.key(2),
    )
    assert 1e-4 < search.best_cost < 1.5e-2


@pytest.mark.parametrize("field", ["agents", "iterations"])
@pytest.mark.parametrize("value", [0, -3, 1.5, True, "many", None])
def test_settings_are_checked(field: str, value: Any) -> None:
    allowed = "should be (greater than or equal to 1|a valid integer)"
    message = rf"not a valid RandomSearch\n\n  {field} = .*\n    {allowed}"
    with pytest.raises(ValueError, match=message):
        RandomSearch(**{field: value})
