"""Signals that repeat each value until the next is measured."""

from typing import NamedTuple

import numpy as np

MIN_CHANGES = 20
"""Minimum number of changes from which a held signal is recognised."""
MIN_REGULAR_SHARE = 0.9
"""Share of the changes that must come after as many samples, to one, as most do."""
GROUPED_CHANGES = 12
"""Changes that are taken together where a sensor has more than half the rate of the rows: they span
as many samples, to one, only if it is regular."""
MIN_SAMPLES_BETWEEN = 1.05
"""Samples from one measurement to the next, on the mean, from which on a signal is held."""


class Held(NamedTuple):
    """How often a signal has new values."""

    samples: float
    """Samples from one measurement to the next; 1 if it is not held."""
    fresh: np.ndarray
    """(K,) where a measurement is new."""


def held(values: np.ndarray) -> Held:
    """Whether a signal repeats its values, and how often; longer rests of the body do not count.

    A sensor of coarse resolution repeats its values too, but not for as many samples each time.

    Args:
        values: (K, 3), without the samples that are missing.
    """
    new = np.ones(len(values), bool)
    new[1:] = np.any(values[1:] != values[:-1], axis=1)
    runs = np.diff(np.flatnonzero(new))
    none = Held(1.0, np.ones(len(values), bool))
    if len(runs) < MIN_CHANGES:
        return none
    if np.median(runs) < 2:  # over half the rate of the rows: only now and then a value is repeated
        runs = np.convolve(runs, np.ones(GROUPED_CHANGES, int), "valid")
        together = GROUPED_CHANGES
    else:
        together = 1
    usual = np.abs(runs - np.median(runs)) <= 1
    if np.mean(usual) < MIN_REGULAR_SHARE:
        return none
    mean = float(np.mean(runs[usual])) / together
    return Held(mean, new) if mean >= MIN_SAMPLES_BETWEEN else none
