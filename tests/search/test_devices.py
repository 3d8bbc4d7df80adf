"""A search on several devices, in a batch, in other pieces: the same bits as alone."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from experiments import tiny
from hypothesis import given
from hypothesis import strategies as st
from setups import search_vectors

from posegsa.errors import PosegsaWarning
from posegsa.search import devices
from posegsa.search import run as search
from posegsa.search.build import TuningProblem, tuning_problem
from posegsa.search.population import (
    LANES,
    PIECE,
    evaluate_population,
    partition,
    population_costs,
)
from posegsa.search.run import run_search, search_batch

pytestmark = pytest.mark.optimised

OWN = [
    *("search.agents=11", "run.training_scenarios=3"),
    *("filter.substeps=1", "filter.cross_vector=false"),
]
"""No number of devices here divides 11 agents; of a filter there is no more than they need."""


def bits(found) -> list[bytes]:
    def numbers(leaf):
        key = jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return jax.random.key_data(leaf) if key else leaf

    return [np.asarray(numbers(leaf)).tobytes() for leaf in jax.tree.leaves(found.search)]


@pytest.fixture(scope="module")
def task():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)
        return tuning_problem(tiny(*OWN))


@pytest.fixture(scope="module")
def alone(task):
    return bits(run_search(task))


def test_a_search_is_the_same_on_several_devices(task, alone, monkeypatch):
    """On four; on two, in processes of their own, in `test_joined_processes`."""
    mesh = devices.mesh_of(jax.devices()[:4])
    monkeypatch.setattr(search, "mesh_for", lambda simulations: mesh)
    assert bits(run_search(task)) == alone


def test_a_batch_finds_what_a_search_alone_finds(task):
    """The first of two with other seeds; all else of a batch is tested without optimisation."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)
        other = tuning_problem(tiny(*OWN, "run.seed=5"))
    single = run_search(task).search
    first, second = (found.search for found in search_batch([task, other], None))
    np.testing.assert_array_equal(first.history.best, single.history.best)
    np.testing.assert_array_equal(first.best_position, single.best_position)
    assert first.best_cost != second.best_cost


def test_small_searches_stay_on_one_device_and_large_ones_use_all():
    assert devices.mesh_for(devices.SIMULATIONS_PER_DEVICE - 1) is None
    assert devices.mesh_for(10**6).devices.size == len(jax.devices()) == 4
    assert devices.mesh_for(2 * devices.SIMULATIONS_PER_DEVICE).devices.size == 2


@pytest.mark.parametrize(("scenarios", "agents"), [(25, 96), (4, 32), (3, 6), (24, 10), (8, 100)])
def test_pieces_have_one_shape_on_one_device_and_on_two(scenarios, agents):
    """In a piece of another shape a simulation may be rounded otherwise."""
    one, two = (partition(scenarios, agents, shards=shards) for shards in (1, 2))
    assert (one.scenarios, one.agents) == (two.scenarios, two.agents)


@given(
    scenarios=st.integers(1, 100),
    agents=st.integers(1, 3000),
    shards=st.integers(1, 9),
    piecewise=st.booleans(),
)
def test_tasks_cover_everything_in_as_many_pieces_for_each_shard(
    scenarios, agents, shards, piecewise
):
    cut = partition(scenarios, agents, shards=shards, piecewise=piecewise)
    assert cut.groups * cut.scenarios >= scenarios
    assert cut.chunks * cut.agents >= agents
    assert cut.groups * cut.chunks % shards == 0
    if piecewise:
        assert cut.agents <= PIECE + LANES
        assert cut.scenarios == 1 or cut.scenarios * agents <= 2 * PIECE
        assert cut.scenarios != 2  # which is slow


@pytest.mark.parametrize("count", [1, 2])
def test_all_at_once_as_on_an_accelerator_gives_the_same_bits(
    task: TuningProblem, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    vectors = jnp.asarray(search_vectors(37), "float32")
    mesh = devices.mesh_of(jax.devices()[:count])
    in_pieces = evaluate_population(vectors, task.training, task.space)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    axis = None if mesh is None else devices.AXIS

    def at_once(vectors, problem, space):
        return population_costs(vectors, problem, space, axis=axis)

    everything = devices.spread((vectors, task.training, task.space), mesh)
    together = devices.collect(jax.jit(devices.on_each(mesh)(at_once))(*everything))
    np.testing.assert_array_equal(together, in_pieces)
