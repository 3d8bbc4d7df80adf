"""Random keys, named by use."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, random

from posegsa.arguments import check_whole

GENERATOR = "threefry2x32"
"""Of random numbers, whatever JAX's default one is."""


class Keys(NamedTuple):
    """The random keys of an experiment; all come from its seed, each by its own number."""

    search: Array
    """The optimiser's."""
    training: Array
    """Of the scenarios that the search sees."""
    held_out: Array
    """Of the scenarios that only judge."""
    validation: Array
    """Of the scenarios that choices between configurations are made on."""
    baselines: Array
    """Of the searches for the baselines."""
    endurance: Array
    """Of the long scenarios that only judge."""


def keys(seed: int) -> Keys:
    """The keys of a seed, each by the number of its use."""
    return _for_uses(random.key(seed, impl=GENERATOR))


@jax.jit
def _for_uses(root: Array) -> Keys:
    return Keys(**{name: random.fold_in(root, use) for name, use in _USES.items()})


_USES = {
    "search": 0,
    "training": 1,
    "held_out": 2,
    "validation": 3,
    "baselines": 5,
    "endurance": 6,
}
"""The number of each use, which never changes; 4 was another's."""


@partial(jax.jit, static_argnums=(1,))
def scenario_keys(key: Array, count: int) -> Array:
    """Keys (count,) of scenarios; the first ones do not depend on how many there are."""
    return jax.vmap(lambda i: random.fold_in(key, i))(jnp.arange(count))


def training_keys(seed: int, count: int) -> Array:
    """Keys (count,) of the training scenarios of a seed."""
    return scenario_keys(keys(seed).training, count)


def held_out_keys(seed: int, count: int, another: int | None = None) -> Array:
    """Keys (count,) of the held-out scenarios of a seed: its own, or another set by number.

    Raises:
        ArgumentError: The number is not one from 0 to 2^31 - 1.
    """
    key = keys(seed).held_out
    if another is not None:
        check_whole("seed", another, 0)
        key = random.fold_in(key, 2**31 + another)  # no scenario has so large a number
    return scenario_keys(key, count)


def endurance_keys(seed: int, count: int) -> Array:
    """Keys (count,) of the long scenarios that show what holds past the tuned window."""
    return scenario_keys(keys(seed).endurance, count)


def repeat_key(seed: int, repeat: int) -> Array:
    """The key of a search that is repeated under one seed."""
    return random.fold_in(keys(seed).search, repeat)
