"""The devices that a search runs on: those of one process, or of several that have joined.

Every device runs the whole search; only the simulations are divided (`agent_costs`), and only their
costs are exchanged. So a seed gives the same bits on any number of devices and processes, unless
there are more devices than scenarios, whose agents are then divided (`population.partition`).
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
"""Simulations that justify one more CPU device: two full vector registers."""
MAX_PROCESSES = 10**6


def join_processes(
    coordinator: str | None = None, processes: int | None = None, process: int | None = None
) -> None:
    """Join several processes, on one machine or many, to run searches together.

    Call this in each process before anything else uses JAX (but after `enable_fast_path`). Each
    process then calls `tune` with the same arguments and gets the same result; only the first
    process writes files.

    Args:
        coordinator: Address, HOST:PORT, at which the first process waits for the others.
        processes: Number of processes.
        process: Index of this process, from 0. On a cluster that JAX knows (Slurm, Open MPI,
            Kubernetes and others: `jax.distributed.initialize`), all three may be left out.

    Raises:
        ArgumentError: Only some of them are given, or one has a wrong type or value.
        PosegsaError: The processes did not find each other, or JAX was already in use.
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
    """A mesh of devices for a number of simulations; None if one device is enough.

    Joined processes use all their devices, so that each process takes part.
    """
    devices = jax.devices()
    if jax.process_count() == 1 and devices[0].platform == "cpu":
        devices = devices[: max(1, simulations // SIMULATIONS_PER_DEVICE)]
    return mesh_of(devices)


def mesh_of(devices: list[Any]) -> Mesh | None:
    """A mesh of the given devices; None for a single device."""
    return Mesh(np.array(devices), (AXIS,)) if len(devices) > 1 else None


def _alone(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function unchanged, for one device."""
    return function


@cache
def on_each(mesh: Mesh | None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that runs a function on every device, with equal arguments and results."""
    if mesh is None:
        return _alone
    same = PartitionSpec()
    # JAX's check for equal results does not recognise that gathered values are equal.
    return partial(jax.shard_map, mesh=mesh, in_specs=same, out_specs=same, check_vma=False)


def spread(tree: Any, mesh: Mesh | None) -> Any:
    """Copy arrays to every device of a mesh; all processes must pass the same arrays."""
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
    """Copies of arrays on the first device of this process; other leaves stay unchanged."""
    return jax.tree.map(
        lambda a: a.addressable_shards[0].data if isinstance(a, jax.Array) else a, tree
    )
