"""A population divided among devices, in pieces of one shape: a search gives the same bits.

For several processes see `test_joined_processes`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same
from helpers.controllers import search_vectors
from helpers.experiments import paper, posed, searched, tiny
from hypothesis import given
from hypothesis import strategies as st

from posegsa.search import devices
from posegsa.search import run_search as searching
from posegsa.search.population import AGENTS_PER_PIECE, LANES, partition, population_costs
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.run_search import run_search, search_batch

pytestmark = [
    pytest.mark.optimised,
    pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning"),
]

SCENARIOS, AGENTS = 9, 100
"""Chosen so that two and four devices get the same number of pieces only with padding."""


def test_small_searches_stay_on_one_device_and_large_ones_use_all():
    assert devices.mesh_for(devices.SIMULATIONS_PER_DEVICE - 1) is None
    assert devices.mesh_for(10**6).devices.size == len(jax.devices()) == 4
    assert devices.mesh_for(2 * devices.SIMULATIONS_PER_DEVICE).devices.size == 2


@pytest.mark.parametrize(
    ("scenarios", "agents"), [(25, 96), (4, 32), (3, 6), (24, 10), (8, 10), (8, 100)]
)
def test_pieces_have_one_shape_on_one_device_and_on_two(scenarios, agents):
    """The rounding of a simulation may depend on the shape of its piece."""
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
        assert cut.agents <= AGENTS_PER_PIECE + LANES
        assert cut.scenarios == 1 or cut.scenarios * agents <= 2 * AGENTS_PER_PIECE
        assert cut.scenarios != 2  # two are slow


@pytest.mark.usefixtures("x64")
def test_costs_on_several_devices_are_of_the_runs_own_precision():
    mesh = devices.mesh_of(jax.devices()[:2])

    def costs(vectors, problem, space):
        return population_costs(vectors, problem, space, axis=devices.AXIS)

    given = search_vectors(37), posed(paper(), scenarios=2), searched()
    found = jax.eval_shape(devices.on_each(mesh)(costs), *given)
    assert (found.shape, found.dtype) == ((37,), np.float64)


@pytest.fixture(scope="module")
def task() -> TuningProblem:
    """A search with a filter that is as small as these tests allow."""
    return tuning_problem(
        tiny(
            f"search.agents={AGENTS}",
            "search.iterations=3",
            f"run.training_scenarios={SCENARIOS}",
            "filter.substeps=1",
            "filter.cross_vector=false",
            "gain.error_scale=8.0",  # otherwise the gain limit makes all agents equal
        )
    )


def found_on(count: int, task: TuningProblem):
    """The result of a search on `count` devices."""
    with pytest.MonkeyPatch.context() as patch:
        mesh = devices.mesh_of(jax.devices()[:count])
        patch.setattr(searching, "mesh_for", lambda simulations: mesh)
        return run_search(task).search


@pytest.fixture(scope="module")
def alone(task):
    """The search on one device."""
    found = found_on(1, task)
    assert found.history.worst[0] > 1.1 * found.history.best[0], "agents differ"
    return found


@pytest.mark.parametrize("count", [2, 4])
def test_a_search_finds_the_same_bits_on_several_devices(task, alone, count):
    assert_same(found_on(count, task), alone)


def test_a_batch_on_four_devices_finds_what_a_search_alone_finds_on_one(task, alone):
    assert devices.mesh_for(SCENARIOS * AGENTS).size == 4
    other = task._replace(experiment=task.experiment.replace(**{"run.seed": 7}))
    first, second = (found.search for found in search_batch([task, other], None))
    np.testing.assert_array_equal(first.history.best, alone.history.best)
    np.testing.assert_array_equal(first.best_position, alone.best_position)
    assert second.best_cost != alone.best_cost


def test_all_at_once_as_on_an_accelerator_gives_the_same_bits(task, monkeypatch):
    box, rng = task.space.box, np.random.default_rng(0)
    vectors = rng.uniform(box.lower, box.upper, (AGENTS, 22)).astype(np.float32)

    def costs_on(count):
        def costs(vectors, problem, space):
            return population_costs(vectors, problem, space, axis=devices.AXIS)

        mesh = devices.mesh_of(jax.devices()[:count])
        everything = devices.spread((jnp.asarray(vectors), task.training, task.space), mesh)
        return devices.collect(jax.jit(devices.on_each(mesh)(costs))(*everything))

    in_pieces = costs_on(4)
    monkeypatch.setattr(jax, "default_backend", lambda: "tpu")  # a GPU: `test_gpu_loop`
    np.testing.assert_array_equal(costs_on(2), in_pieces)
