"""Run many scenarios in groups of one shape, to limit memory and the number of programs."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

SCENARIOS = 16
"""Maximum number of scenarios in a group: the floats in the widest CPU vector register."""
SAMPLES = 2**18
"""Maximum number of samples in a group, summed over its scenarios, if more than one."""
LENGTH = 2**10
"""Scenarios are padded to a multiple of this number of samples."""


def padded(samples: int) -> int:
    """`samples` rounded up to a multiple of LENGTH, so that similar runs share programs."""
    return LENGTH * -(-samples // LENGTH)


def group_size(length: int) -> int:
    """Number of scenarios in a group, for scenarios of this number of samples."""
    return max(1, min(SCENARIOS, SAMPLES // length))


def in_groups(run: Callable[[np.ndarray], Any], count: int, length: int) -> Any:
    """Call a compiled function on scenarios 0 to count - 1, a group at a time.

    Args:
        run: Maps the numbers (S,) of some scenarios to leaves (S, ...). All groups are of one size,
            so that it is compiled once; the last group is padded with the first scenarios.
        count: Number of scenarios, at least 1.
        length: Number of samples of each scenario.

    Returns:
        The leaves (count, ...) of all scenarios, as NumPy arrays.
    """
    size = group_size(length)
    whole: Any = None
    for first in range(0, count, size):
        part = jax.device_get(run(np.arange(first, first + size) % count))
        if whole is None:  # allocated only once, as it may take most of the memory
            whole = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), part)
        for to, of in zip(jax.tree.leaves(whole), jax.tree.leaves(part), strict=True):
            to[first : first + size] = of[: count - first]
    return whole
