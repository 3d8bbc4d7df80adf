"""Random keys, named by use."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, random

from posegsa.arguments import check_whole

GENERATOR = "threefry2x32"
"""The random number generator, whatever JAX's default is."""


class Keys(NamedTuple):
    """The random keys of an experiment, derived from its seed, one for each use."""

    search: Array
    """For the optimiser."""
    training: Array
    """For the training scenarios."""
    held_out: Array
    """For the held-out scenarios, which only evaluate."""
    validation: Array
    """For the scenarios that serve to choose between configurations."""
    baselines: Array
    """For the searches for the baselines."""
    endurance: Array
    """For the long scenarios, which only evaluate."""


def keys(seed: int) -> Keys:
    """The keys of a seed."""
    return _for_uses(random.key(seed, impl=GENERATOR))


@jax.jit
def _for_uses(root: Array) -> Keys:
    return Keys(*(random.fold_in(root, use) for use in _USES))


_USES = 0, 1, 2, 3, 5, 6
"""The number of each use, in the order of `Keys`. These never change; an earlier use had 4."""


@partial(jax.jit, static_argnums=(1,))
def scenario_keys(key: Array, count: int) -> Array:
    """Keys (count,) of scenarios; each depends on its index only, not on `count`."""
    return jax.vmap(lambda i: random.fold_in(key, i))(jnp.arange(count))


def training_keys(seed: int, count: int) -> Array:
    """Keys (count,) of the training scenarios of a seed."""
    return scenario_keys(keys(seed).training, count)


def held_out_keys(seed: int, count: int, another: int | None = None) -> Array:
    """Keys (count,) of the held-out scenarios of a seed, or of another set of them by number.

    Raises:
        ArgumentError: The number is not one from 0 to 2^31 - 1.
    """
    key = keys(seed).held_out
    if another is not None:
        check_whole("seed", another, 0)
        key = random.fold_in(key, 2**31 + another)  # larger than any scenario index
    return scenario_keys(key, count)


def endurance_keys(seed: int, count: int) -> Array:
    """Keys (count,) of the scenarios that run for longer than the tuned duration."""
    return scenario_keys(keys(seed).endurance, count)


def repeat_key(seed: int, repeat: int) -> Array:
    """The key of one of several searches with the same seed."""
    return random.fold_in(keys(seed).search, repeat)
