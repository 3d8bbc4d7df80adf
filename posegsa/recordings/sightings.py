"""Vectors and landmarks at the samples of a recording."""

import math
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.measurements import unmasked
from posegsa.recordings.bridging import Bridged


def spread_sightings(
    kind: str,
    found: Bridged,
    samples: int,
    body: ArrayLike | None,
    references: ArrayLike | None,
    weights: ArrayLike | None,
) -> dict[str, Any]:
    """Arguments of vectors or landmarks at the bridged samples, NaN at those filled in."""

    def at_samples(name: str, value: ArrayLike | None, missing: float, constant: int) -> Any:
        array = None if value is None else np.asarray(unmasked(value))
        if array is None or array.ndim <= constant:
            return value  # constant over samples
        if len(array) != samples:
            raise RecordingError(f"{name}: must have {samples} rows, got {len(array)}")
        return found.spread(array, missing)

    return {
        name: at_samples(name, value, missing, constant)
        for name, value, missing, constant in (
            (f"{kind}s", body, math.nan, 0),
            (f"{kind}_references", references, 1.0, 2),
            (f"{kind}_weights", weights, 0.0, 1),
        )
    }


def usual_intervals(seen: np.ndarray) -> np.ndarray:
    """Median number of samples (n,) between measurements, from where each was seen (K, n)."""
    found = [np.diff(np.flatnonzero(column)) for column in seen.T]
    return np.array([float(np.median(steps)) if steps.size else 1.0 for steps in found])
