"""Large populations in pieces, on several devices, in a batch: the same bits as in one call on one.

One population serves all of this file, so that few programs are compiled.
"""

import math
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.experiments import tiny
from hypothesis import given
from hypothesis import strategies as st

from posegsa.errors import PosegsaWarning
from posegsa.optimisers import gsa
from posegsa.search import devices, large_populations
from posegsa.search import run as searching
from posegsa.search.build import tuning_problem
from posegsa.search.large_populations import (
    PiecewiseCosts,
    agents_in_piece,
    is_large,
    places,
    scenarios_in_piece,
    work,
)
from posegsa.search.population import population_costs
from posegsa.search.run import run_search, search_batch

pytestmark = pytest.mark.optimised

SAMPLES = 200
SCENARIOS, AGENTS = 9, 1100
"""More than the smallest piece on the four devices that tests have, 8 and 1024; and so many that
the four can be given the same work only if some of it is done twice."""

ALSO = (
    '{key="filter.gamma.1", lower=0.5, upper=50.0, scale="logarithmic"}',
    '{key="scenario.landmarks.0.weight", lower=0.2, upper=2.0}',
)


@pytest.fixture(scope="module")
def task():
    """Of a filter there is no more than these tests need, but for numbers beside k1 to k22."""
    experiment = tiny(
        f"search.agents={AGENTS}",
        "search.iterations=3",
        f"run.training_scenarios={SCENARIOS}",
        "filter.substeps=1",
        "filter.cross_vector=false",
        "gain.error_scale=8.0",  # else the gain limit makes all agents equal
        f"parameters.also=[{', '.join(ALSO)}]",
    )
    # What draws the scenarios compares no bits: as little optimised as in the other files.
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PosegsaWarning)
            return tuning_problem(experiment)
    finally:
        jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture
def on_one_device(monkeypatch):
    monkeypatch.setattr(searching, "mesh_for", lambda simulations: None)


@pytest.fixture(scope="module")
def whole(task):
    """The search by one compiled program on one device."""
    assert not is_large(task)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searching, "mesh_for", lambda simulations: None)
        found = run_search(task).search
    assert found.history.worst[0] > 1.1 * found.history.best[0], "agents differ"
    return found


@pytest.fixture
def small_pieces(monkeypatch):
    """The smallest pieces, and five parts of GSA's step."""
    monkeypatch.setattr(large_populations, "WORK", SAMPLES)
    monkeypatch.setattr(gsa, "PART", gsa.PULL_SECONDS * AGENTS**2 * 24 / 4.5)


def another(task):
    """The same with another seed."""
    return task._replace(experiment=task.experiment.replace(**{"run.seed": 7}))


@pytest.mark.usefixtures("small_pieces")
def test_pieces_give_the_bits_of_the_whole_and_say_how_far_they_are(task, whole):
    """On four devices; a whole search on two processes' devices: `test_joined_processes`."""
    assert is_large(task)
    told = []
    assert_same(run_search(task, told.append).search, whole)
    # Two chunks of the agents, two groups of the scenarios, five parts: nine calls.
    shares = [progress.share for progress in told if progress.iteration == 1]
    assert shares == pytest.approx([0, *(np.arange(1, 10) / 9)])
    assert told[-1].iteration == 3
    assert told[-1].share == 0


@pytest.mark.usefixtures("small_pieces")
def test_they_do_so_in_a_batch(task, whole):
    first, second = (found.search for found in search_batch([task, another(task)], None))
    assert_same(first, whole)
    assert second.best_cost != whole.best_cost


def test_a_batch_on_four_devices_finds_what_a_search_alone_finds_on_one(task, whole):
    assert searching.mesh_for(SCENARIOS * AGENTS).size == 4
    first, second = (found.search for found in search_batch([task, another(task)], None))
    np.testing.assert_array_equal(first.history.best, whole.history.best)
    np.testing.assert_array_equal(first.best_position, whole.best_position)
    assert second.best_cost != whole.best_cost


@pytest.mark.usefixtures("on_one_device")
def test_searches_that_are_too_much_together_run_one_by_one(task, whole, monkeypatch):
    monkeypatch.setattr(large_populations, "WORK", work(task))
    assert not is_large(task)
    told = []
    first, second = (found.search for found in search_batch([task, task], told.append))
    assert_same(first, whole)
    assert_same(second, whole)
    assert [p.share for p in told if p.iteration == 2] == [0, 0.5, 1]


@pytest.mark.usefixtures("small_pieces")
def test_all_at_once_as_on_an_accelerator_gives_the_same_bits(task, monkeypatch):
    box, rng = task.space.box, np.random.default_rng(0)
    vectors = rng.uniform(box.lower, box.upper, (AGENTS, 24)).astype(np.float32)
    in_pieces = PiecewiseCosts(task, *searching._objective(task), lambda share: None).costs(vectors)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    mesh = devices.mesh_of(jax.devices()[:2])

    def at_once(vectors, problem, space):
        return population_costs(vectors, problem, space, axis=devices.AXIS)

    everything = devices.spread((jnp.asarray(vectors), task.training, task.space), mesh)
    together = devices.collect(jax.jit(devices.on_each(mesh)(at_once))(*everything))
    np.testing.assert_array_equal(together, in_pieces)


@given(
    agents=st.integers(1, 10**5),
    scenarios=st.integers(1, 2000),
    length=st.integers(2, 10**5),
    most=st.integers(10**5, 10**9),
    turns=st.integers(2, 16),
)
def test_pieces_cover_everything_within_the_bound(agents, scenarios, length, most, turns):
    least = turns * large_populations.PIECE
    some = agents_in_piece(agents, scenarios * length, most, least)
    part = scenarios_in_piece(some, scenarios, length, most, turns if some <= least else 1)
    assert some <= agents
    assert some == agents or some % least == 0
    assert some * part * length <= most or (some <= least and part <= turns)
    assert part == scenarios or some <= least
    for count, size in ((agents, some), (scenarios, part)):
        begins = places(count, size)
        assert len(begins) == math.ceil(count / size)
        assert begins[0] == 0
        assert begins[-1] + size == count
        assert all(0 <= step <= size for step in np.diff(begins))
