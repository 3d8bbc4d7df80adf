"""Many scenarios in groups of one shape: memory stays bounded, and few programs are compiled."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

SCENARIOS = 16
"""Scenarios in a group, at most: as many numbers as a CPU's widest vector holds."""
SAMPLES = 2**18
"""Samples in a group, over its scenarios, where that leaves at least one scenario."""
LENGTH = 2**10
"""Scenarios are made and judged at a multiple of this length."""


def padded(samples: int) -> int:
    """The least multiple of LENGTH that holds so many samples: similar runs share programs."""
    return LENGTH * -(-samples // LENGTH)


def in_groups(run: Callable[[np.ndarray], Any], count: int, length: int) -> Any:
    """Call a compiled function on scenarios 0 to count - 1, a group at a time.

    Args:
        run: Maps the numbers (S,) of some scenarios to leaves (S, ...). All groups are of one size,
            so that it is compiled once; the last one is filled up with the first scenarios.
        count: Number of scenarios, at least 1.
        length: Samples that are simulated of each.

    Returns:
        The leaves (count, ...) of all scenarios, as NumPy arrays.
    """
    size = max(1, min(SCENARIOS, SAMPLES // length))
    whole: Any = None
    for first in range(0, count, size):
        part = jax.device_get(run(np.arange(first, first + size) % count))
        if whole is None:  # allocated once: it may take most of the memory
            whole = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), part)
        for to, of in zip(jax.tree.leaves(whole), jax.tree.leaves(part), strict=True):
            to[first : first + size] = of[: count - first]
    return whole
