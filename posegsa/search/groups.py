"""Many scenarios in groups of one shape: memory stays bounded, and few programs serve all sizes."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

SCENARIOS = 16
"""Scenarios of a group, of samples up to `MOST_SAMPLES` in all: a full vector of a CPU."""
MOST_SAMPLES = 2**18
SHORTEST = 2**10


def padded(samples: int) -> int:
    """A length that holds so many samples and is one of few: a power of two, at least SHORTEST."""
    return max(SHORTEST, 1 << (samples - 1).bit_length())


def in_groups(run: Callable[[np.ndarray], Any], count: int, length: int) -> Any:
    """What a compiled function makes of scenarios 0 to count - 1, on the host.

    Args:
        run: maps the numbers (S,) of some scenarios to leaves (S, ...). It always gets as many, so
            that it is compiled once; the last group begins again with scenario 0.
        count: of scenarios, at least 1.
        length: samples that are simulated of each.
    """
    size = max(1, min(SCENARIOS, MOST_SAMPLES // length))
    whole: Any = None
    for first in range(0, count, size):
        part = jax.device_get(run(np.arange(first, first + size) % count))
        if whole is None:  # all at once, as it may take most of the memory
            whole = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), part)
        for to, of in zip(jax.tree.leaves(whole), jax.tree.leaves(part), strict=True):
            to[first : first + size] = of[: count - first]
    return whole
