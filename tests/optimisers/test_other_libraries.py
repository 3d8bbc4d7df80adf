"""Strategies of evosax and pycma as optimisers, compared with each other."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.experiments import tiny

import posegsa
from posegsa.errors import ArgumentError, CheckpointError, ConfigError, PosegsaWarning
from posegsa.optimisers import CMAES, box, minimise, start
from posegsa.optimisers.evosax import Evosax, EvosaxState
from posegsa.optimisers.functions import ClassicalFunction
from posegsa.optimisers.pycma import PyCMA

FUNCTION = ClassicalFunction("ellipsoid", 4, shift=0.6, rotation=2)
KEY = jax.random.key(0)


def test_cma_es_of_both_libraries_agree() -> None:
    # With the same algorithm, population, sigma and budget, the costs of 4 keys after 40 steps
    # agree within their spread. The function has rotated axes scaled 10^6 : 1, off the middle.
    keys = jax.random.split(KEY, 4)
    one = np.log10(
        np.asarray(
            minimise(FUNCTION, FUNCTION.box, CMAES(agents=12, iterations=40), keys).best_cost
        )
    )
    other = np.log10(
        [
            float(minimise(FUNCTION, FUNCTION.box, PyCMA(agents=12, iterations=40), key).best_cost)
            for key in keys
        ]
    )
    assert abs(np.median(one) - np.median(other)) < max(np.ptp(one), np.ptp(other))
    assert max(np.median(one), np.median(other)) < 5, "random points cost some 10^9"


def test_a_population_of_evosax_begins_with_its_own_costs() -> None:
    swarm = Evosax(strategy="PSO", agents=6, iterations=5)
    search = minimise(FUNCTION, FUNCTION.box, swarm, KEY)
    again = minimise(FUNCTION, FUNCTION.box, swarm, KEY, chunk=2)
    assert_same(search, again)
    assert isinstance(search.state, EvosaxState)
    best = search.history.best
    assert best[-1] < best[0]
    assert search.state.strategy.best_fitness == search.best_cost


def test_positions_beyond_the_box_are_mirrored_into_it() -> None:
    optimiser = CMAES(agents=12, iterations=40)
    state = optimiser.init(KEY, 4, jnp.float32)
    asked = jnp.tile(jnp.asarray([[-0.25, 1.5, 2.25, jnp.nan]], jnp.float32), (12, 1))
    assert optimiser.ask(state._replace(asked=asked))[0].tolist() == [0.25, 0.5, 0.25, 0.5]


def test_pycma_keeps_its_state_and_numpys_generator() -> None:
    optimiser = PyCMA(agents=6, iterations=5)
    state = optimiser.init(KEY, 3, jnp.float32)
    before = np.random.get_state()[1].tolist()  # noqa: NPY002 - the global generator
    told = [optimiser.tell(state, jnp.arange(6.0)) for _ in range(2)]
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002 - the same
    assert (optimiser.ask(told[0]) == optimiser.ask(told[1])).all()
    assert (optimiser.ask(told[0]) != optimiser.ask(state)).any()
    assert ((optimiser.ask(state) >= 0) & (optimiser.ask(state) <= 1)).all()


def test_a_search_by_pycma_continues_in_the_process_that_started_it() -> None:
    optimiser, seen = PyCMA(agents=6, iterations=5), []
    whole = minimise(FUNCTION, FUNCTION.box, optimiser, KEY, chunk=2, callback=seen.append)
    again = minimise(FUNCTION, FUNCTION.box, optimiser, KEY, search=seen[0])
    assert (again.history.best == whole.history.best).all()
    other = minimise(FUNCTION, FUNCTION.box, PyCMA(agents=7, iterations=5), KEY)
    with pytest.raises(ArgumentError, match="search"):
        minimise(FUNCTION, FUNCTION.box, optimiser, KEY, search=other)
    stranger = seen[0]._replace(
        state=seen[0].state._replace(strategy=(5, seen[0].state.strategy[1]))
    )
    with pytest.raises(ArgumentError, match=r"strategy\[0\] is int; .*CMAEvolutionStrategy"):
        minimise(FUNCTION, FUNCTION.box, optimiser, KEY, search=stranger)


def test_tune_by_pycma_writes_a_folder_without_checkpoints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegsa.saving.result_files.draw", lambda *_: {})
    by_pycma = tiny("search.optimiser=pycma")
    with pytest.warns(PosegsaWarning) as said:
        result = posegsa.tune(by_pycma, out=tmp_path)
    messages = [str(w.message) for w in said if "search.optimiser" in str(w.message)]
    assert len(messages) == 1
    assert "'pycma'" in messages[0]
    assert "can't be resumed" in messages[0]
    assert np.isfinite(result.best_cost)
    assert posegsa.load(tmp_path).best_cost == result.best_cost
    assert not (tmp_path / "checkpoints").exists()
    with pytest.raises(
        CheckpointError, match=r"no checkpoint to resume from; .*state can.t be saved"
    ):
        posegsa.tune(by_pycma, resume=tmp_path)


def test_an_unknown_strategy_is_refused_by_name() -> None:
    unknown = tiny("search.optimiser=evosax", "search.strategy=CMAES").search
    with pytest.raises(ConfigError, match=r"strategy = 'CMAES' of evosax; allowed: .*CMA_ES"):
        start(unknown, box([0], [1]), KEY)


@pytest.mark.parametrize("made", [Evosax, CMAES, PyCMA])
def test_a_search_that_can_not_spread_is_refused(made: type) -> None:
    for sigma in (0.0, 1e-13):
        with pytest.raises(
            ConfigError, match=rf"sigma = {sigma}\s+should be greater than or equal to 1e-09"
        ):
            made(sigma=sigma)


def test_the_smallest_spread_stays_finite() -> None:
    search = minimise(FUNCTION, FUNCTION.box, CMAES(agents=6, iterations=5, sigma=1e-9), KEY)
    assert search.non_finite == 0
    assert jnp.isfinite(search.state.asked).all()


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
@pytest.mark.parametrize(("name", "library"), [("cma_es", "evosax"), ("pycma", "cma")])
def test_without_its_library_it_is_read_but_not_run(
    monkeypatch: pytest.MonkeyPatch, name: str, library: str
) -> None:
    for module in [m for m in sys.modules if m.split(".")[0] == library]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, library, None)
    experiment = tiny(f"search.optimiser={name}")
    assert experiment.search.size_in_words() == "6 agents x 4 iterations"
    for run in (
        lambda: posegsa.tune(experiment),
        lambda: posegsa.compare(experiment, optimisers=["gsa", name], evaluations=24, repeats=1),
        lambda: minimise(FUNCTION, FUNCTION.box, experiment.search, KEY),
    ):
        with pytest.raises(ConfigError, match=rf"{library}.*pip install '\.\[compare\]'"):
            run()
