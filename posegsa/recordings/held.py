"""Signals that repeat each value until the next is measured."""

from typing import NamedTuple

import numpy as np

FEWEST = 20
"""Changes from which on a signal can be told to be held."""
REGULAR = 0.9
"""Share of the changes that must come after as many samples, to one, as most do."""


class Held(NamedTuple):
    """How a signal is held."""

    samples: float
    """From one measurement to the next; 1 if it is not held."""
    fresh: np.ndarray
    """(K,) where a measurement is new."""


def held(values: np.ndarray) -> Held:
    """Whether a signal repeats its values, and how often; the longer rests of a body do not count.

    A sensor of coarse resolution repeats its values too, but not for as many samples each time.

    Args:
        values: (K, 3), without the samples that are missing.
    """
    new = np.ones(len(values), bool)
    new[1:] = np.any(values[1:] != values[:-1], axis=1)
    runs = np.diff(np.flatnonzero(new))
    none = Held(1.0, np.ones(len(values), bool))
    if len(runs) < FEWEST or np.median(runs) < 2:
        return none
    usual = np.abs(runs - np.median(runs)) <= 1
    return Held(float(np.mean(runs[usual])), new) if np.mean(usual) >= REGULAR else none
