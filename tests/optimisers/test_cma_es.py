"""CMA-ES of evosax as an optimiser, compared with the library of the algorithm's author."""

import sys

import cma
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.experiments import tiny

import posegsa
from posegsa.errors import ConfigError
from posegsa.optimisers import CMAES, minimise
from posegsa.optimisers.functions import ClassicalFunction

FUNCTION = ClassicalFunction("ellipsoid", 4, shift=0.6, rotation=2)
KEY = jax.random.key(0)


def by_pycma(seed: int) -> float:
    """Best cost that pycma finds in 40 iterations of 12 positions in the unit box."""
    options = {"bounds": [0, 1], "popsize": 12, "seed": seed + 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy([0.5] * 4, 0.3, options)
    lower, width = np.asarray(FUNCTION.box.lower), np.asarray(FUNCTION.box.upper)
    width = width - lower
    best = np.inf
    for _ in range(40):
        asked = strategy.ask()
        costs = np.asarray(FUNCTION(jnp.asarray(lower + width * np.array(asked), jnp.float32)))
        strategy.tell(asked, costs.astype(np.float64).tolist())
        best = min(best, float(costs.min()))
    return best


def test_cma_es_of_both_libraries_agree() -> None:
    # With the same algorithm, population, sigma and budget, the costs of 4 keys after 40 steps
    # agree within their spread. The function has rotated axes scaled 10^6 : 1, off the middle.
    keys = jax.random.split(KEY, 4)
    found = minimise(FUNCTION, FUNCTION.box, CMAES(agents=12, iterations=40), keys)
    one = np.log10(np.asarray(found.best_cost))
    other = np.log10([by_pycma(seed) for seed in range(4)])
    assert abs(np.median(one) - np.median(other)) < max(np.ptp(one), np.ptp(other))
    assert max(np.median(one), np.median(other)) < 5, "random points cost some 10^9"


def test_a_search_in_chunks_is_the_same() -> None:
    optimiser = CMAES(agents=6, iterations=5)
    search = minimise(FUNCTION, FUNCTION.box, optimiser, KEY)
    assert_same(search, minimise(FUNCTION, FUNCTION.box, optimiser, KEY, chunk=2))
    assert search.history.best[-1] < search.history.best[0]


def test_positions_beyond_the_box_are_mirrored_into_it() -> None:
    optimiser = CMAES(agents=12, iterations=40)
    state = optimiser.init(KEY, 4, jnp.float32)
    asked = jnp.tile(jnp.asarray([[-0.25, 1.5, 2.25, jnp.nan]], jnp.float32), (12, 1))
    assert optimiser.ask(state._replace(asked=asked))[0].tolist() == [0.25, 0.5, 0.25, 0.5]


@pytest.mark.parametrize("sigma", [0.0, 1e-13])
def test_a_search_that_can_not_spread_is_refused(sigma: float) -> None:
    said = rf"sigma = {sigma}\s+should be greater than or equal to 1e-09"
    with pytest.raises(ConfigError, match=said):
        CMAES(sigma=sigma)


def test_the_smallest_spread_stays_finite() -> None:
    search = minimise(FUNCTION, FUNCTION.box, CMAES(agents=6, iterations=5, sigma=1e-9), KEY)
    assert search.non_finite == 0
    assert jnp.isfinite(search.state.asked).all()


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_without_its_library_it_is_read_but_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [m for m in sys.modules if m.split(".")[0] == "evosax"]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, "evosax", None)
    experiment = tiny("search.optimiser=cma_es")
    assert experiment.search.size_in_words() == "6 agents x 4 iterations"
    for run in (
        lambda: posegsa.tune(experiment),
        lambda: posegsa.compare(
            experiment, optimisers=["gsa", "cma_es"], evaluations=24, repeats=1
        ),
        lambda: minimise(FUNCTION, FUNCTION.box, experiment.search, KEY),
    ):
        with pytest.raises(ConfigError, match=r"evosax.*pip install '\.\[compare\]'"):
            run()
