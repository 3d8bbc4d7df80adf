"""Where a search runs: the devices of one process, or of several that have joined.

Every device runs the same search, all of it; only the simulations are divided (`agent_costs`), and
only their costs travel. So a seed gives the same bits on any number of devices and processes.
"""

from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "devices"
"""Name of the mesh's only axis."""
WORTH = 32
"""Simulations that are worth a CPU device of their own: two full vectors."""


def mesh_for(simulations: int) -> Mesh | None:
    """The devices for so many simulations at once; None where one is enough.

    Processes that have joined use all of theirs, so that each takes part.
    """
    devices = jax.devices()
    if jax.process_count() == 1 and devices[0].platform == "cpu":
        devices = devices[: max(1, simulations // WORTH)]
    return mesh_of(devices)


def mesh_of(devices: list[Any]) -> Mesh | None:
    """A mesh of these devices; None for one, which needs none."""
    return Mesh(np.array(devices), (AXIS,)) if len(devices) > 1 else None


def spread(tree: Any, mesh: Mesh | None) -> Any:
    """Arrays of this process, the same in all of them, as arrays on every device of the mesh."""
    if mesh is None:
        return tree
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def collect(tree: Any) -> Any:
    """The same arrays on this process' first device; what is no array stays as it is."""
    return jax.tree.map(
        lambda a: a.addressable_shards[0].data if isinstance(a, jax.Array) else a, tree
    )
