"""How a population is divided among devices: over as many as it is worth, in pieces of one shape.

That a search on several devices has the same bits as on one: `test_large_populations`, and in
processes of their own `test_joined_processes`.
"""

import jax
import numpy as np
import pytest
from helpers.controllers import search_vectors
from helpers.experiments import paper, posed, searched
from hypothesis import given
from hypothesis import strategies as st

from posegsa.search import devices
from posegsa.search.population import LANES, PIECE, partition, population_costs


def test_small_searches_stay_on_one_device_and_large_ones_use_all():
    assert devices.mesh_for(devices.SIMULATIONS_PER_DEVICE - 1) is None
    assert devices.mesh_for(10**6).devices.size == len(jax.devices()) == 4
    assert devices.mesh_for(2 * devices.SIMULATIONS_PER_DEVICE).devices.size == 2


@pytest.mark.parametrize(
    ("scenarios", "agents"), [(25, 96), (4, 32), (3, 6), (24, 10), (8, 10), (8, 100)]
)
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


@pytest.mark.usefixtures("x64")
def test_costs_on_several_devices_are_of_the_runs_own_precision():
    mesh = devices.mesh_of(jax.devices()[:2])

    def costs(vectors, problem, space):
        return population_costs(vectors, problem, space, axis=devices.AXIS)

    given = search_vectors(37), posed(paper(), scenarios=2), searched()
    found = jax.eval_shape(devices.on_each(mesh)(costs), *given)
    assert (found.shape, found.dtype) == ((37,), np.float64)
