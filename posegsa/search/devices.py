"""Where a search runs: the devices of one process, or of several that have joined.

Every device runs the same search, all of it; only the simulations are divided (`agent_costs`), and
only their costs travel. So a seed gives the same bits on any number of devices and processes,
unless these are so many that the agents on a scenario must be divided (`population.partition`).
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from posegsa.arguments import check_type, check_whole, refuse
from posegsa.errors import PosegsaError

AXIS = "devices"
"""Name of the mesh's only axis."""
SIMULATIONS_PER_DEVICE = 32
"""Simulations that are worth a CPU device of their own: two full vectors."""
MAX_PROCESSES = 10**6


def join_processes(
    coordinator: str | None = None, processes: int | None = None, process: int | None = None
) -> None:
    """Join several processes, on one machine or many, for searches together.

    To be called in each before anything else uses JAX (but after `enable_fast_path`). Each then
    calls `tune` with the same arguments and gets the same result; the first alone writes files.

    Args:
        coordinator: Address, HOST:PORT, at which the first process waits for the others.
        processes: How many they are.
        process: Which one this is, from 0. On a cluster that JAX knows (Slurm, Open MPI, Kubernetes
            and others: `jax.distributed.initialize`), all three are found if none is given.

    Raises:
        ArgumentError: Some are given and others not, or one is not what is said here.
        PosegsaError: The processes did not find each other, or JAX was in use already.
    """
    if coordinator is not None and processes is not None and process is not None:
        check_type("coordinator", coordinator, str, allowed="text, HOST:PORT")
        if not coordinator.rpartition(":")[2].isdecimal():
            refuse(f"coordinator = {coordinator!r}", "HOST:PORT")
        check_whole("processes", processes, 1, MAX_PROCESSES)
        check_whole("process", process, 0, processes - 1)
    elif (coordinator, processes, process) != (None, None, None):
        refuse(
            f"coordinator = {coordinator}, processes = {processes}, process = {process}",
            "all three, or none on a cluster that JAX knows",
        )
    try:
        jax.distributed.initialize(coordinator, processes, process)
    except (RuntimeError, ValueError) as error:
        raise PosegsaError(f"the processes did not join: {error}") from error


def mesh_for(simulations: int) -> Mesh | None:
    """The devices for so many simulations at once; None where one is enough.

    Processes that have joined use all of theirs, so that each takes part.
    """
    devices = jax.devices()
    if jax.process_count() == 1 and devices[0].platform == "cpu":
        devices = devices[: max(1, simulations // SIMULATIONS_PER_DEVICE)]
    return mesh_of(devices)


def mesh_of(devices: list[Any]) -> Mesh | None:
    """A mesh of these devices; None for one, which needs none."""
    return Mesh(np.array(devices), (AXIS,)) if len(devices) > 1 else None


def _alone(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function on one device."""
    return function


@cache
def on_each(mesh: Mesh | None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """What makes a function run on every device of a mesh, with equal arguments and results."""
    if mesh is None:
        return _alone
    same = PartitionSpec()
    # The check for equal results would not see that what is gathered is equal.
    return partial(jax.shard_map, mesh=mesh, in_specs=same, out_specs=same, check_vma=False)


def spread(tree: Any, mesh: Mesh | None) -> Any:
    """Arrays of this process, the same in all of them, as arrays on every device of the mesh."""
    if mesh is None:
        return tree
    replicated = NamedSharding(mesh, PartitionSpec())
    if jax.process_count() == 1:
        return jax.device_put(tree, replicated)

    def one(leaf: jax.Array) -> jax.Array:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(
                one(jax.random.key_data(leaf)), impl=jax.random.key_impl(leaf)
            )
        here = np.asarray(leaf)
        return jax.make_array_from_callback(here.shape, replicated, lambda index: here[index])

    return jax.tree.map(one, tree)


def collect(tree: Any) -> Any:
    """The same arrays on this process' first device; what is no array stays as it is."""
    return jax.tree.map(
        lambda a: a.addressable_shards[0].data if isinstance(a, jax.Array) else a, tree
    )
