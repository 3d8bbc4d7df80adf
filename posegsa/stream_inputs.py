"""The inputs of a stream: vectors and landmarks of a sample, and first samples in a wrong unit."""

import warnings
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import refuse
from posegsa.errors import MeasurementError, PosegsaWarning
from posegsa.filters.attitude import LEVELLING, LONGEST_PAUSE
from posegsa.model import limits
from posegsa.model.measurements import finite_array
from posegsa.recordings.bridging import MAX_MEDIAN_STEP
from posegsa.recordings.frames import GRAVITY

FIRST_SAMPLES = 50
"""Number of the first samples of a stream that show a wrong unit, if all of them do."""


class FirstSamples:
    """The first samples of a stream, which warn of a wrong unit that all of them show."""

    def __init__(self, gravity: float | None) -> None:
        self._gravity = gravity
        """Its length in the accelerometer's unit; None without one."""
        self._longest = MAX_MEDIAN_STEP if gravity is None else LONGEST_PAUSE
        self._steps: list[float] = []
        self._forces: list[float] = []

    def see(self, time_step: float, vectors: np.ndarray) -> None:
        """Take a sample's time step [s] and vectors (n, 3), 0 for a missing one."""
        if len(self._steps) < FIRST_SAMPLES:
            self._steps.append(time_step)
            if len(self._steps) == FIRST_SAMPLES and min(self._steps) > self._longest:
                pause = "each is a pause, after which the attitude is found anew; "
                _warn(
                    f"time_step: all of the first {FIRST_SAMPLES} are over {self._longest:.2g} s "
                    f"(median {np.median(self._steps):.3g} s); {pause if self._gravity else ''}"
                    "allowed: the time to the next sample in seconds (milliseconds / 1000)"
                )
        if self._gravity and len(self._forces) < FIRST_SAMPLES and vectors[0].any():
            self._forces.append(float(np.linalg.norm(vectors[0])))
            low, high = (share * self._gravity for share in LEVELLING)
            if len(self._forces) == FIRST_SAMPLES and not any(
                low < one < high for one in self._forces
            ):
                _warn(
                    f"acc: all of the first {FIRST_SAMPLES} are below {low:.3g} or above "
                    f"{high:.3g} in length (median {np.median(self._forces):.3g}); allowed: "
                    f"specific force, {self._gravity:.3g} at rest "
                    f"(m/s^2 are multiples of g times {GRAVITY:g})"
                )


def _warn(words: str) -> None:
    warnings.warn(words, PosegsaWarning, stacklevel=4)


class StreamedSensors:
    """The vectors, or the landmarks, of a stream.

    Args:
        name: "vector" or "landmark".
        references: (n, 3) what they are in the inertial frame; landmarks in [m].
        factors: scalar or (n,) on the filter's weights.
        weights: the filter's, one each; None for a filter without weights.

    Raises:
        ArgumentError: The numbers of weights and references differ.
        MeasurementError: A factor is not allowed, or a known vector is zero.
    """

    def __init__(
        self,
        name: str,
        references: np.ndarray,
        factors: ArrayLike,
        weights: tuple[Any, ...] | None,
    ) -> None:
        self.name, self.references = name, references
        self._limit = limits.VECTOR if name == "vector" else limits.LANDMARK
        count = len(references)
        if weights is not None and len(weights) != count:
            setting = "vectors.weights" if name == "vector" else "landmark_weights"
            refuse(
                f"settings.{setting}: {len(weights)} of them",
                f"{count}, one for each of {name}_references, or None",
            )
        self.factors = self._checked_factors(factors)
        self.weights = np.ones(count) if weights is None else np.asarray(weights, np.float64)
        """(n,) the filter's weights, without the factors; a sensor of weight 0 has no effect."""
        if name == "vector" and not references.any(axis=1).all():
            raise MeasurementError("vector_references: must not be zero")

    def seen(self, values: Any, factors: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
        """The measurements (n, 3) and their factors (n,), both 0 for a missing one."""
        factors = self.factors if factors is None else self._checked_factors(factors)
        count = len(self.references)
        if values is None:
            return np.zeros((count, 3)), np.zeros(count)
        if isinstance(values, list | tuple):
            values = [np.full(3, np.nan) if row is None else row for row in values]
            values = values or np.zeros((0, 3))
        rows = finite_array(f"{self.name}s", values, (count, 3), finite=False)
        there = ~np.isnan(rows).any(axis=1) & (factors > 0)
        self._limit.checked(f"{self.name}s", rows[there])
        if self.name == "vector":  # a vector of length 0 has no direction
            there &= rows.any(axis=1)
        rows = np.where(there[:, None], rows, 0.0)
        return rows, np.where(there, factors, 0.0)

    def _checked_factors(self, factors: ArrayLike) -> np.ndarray:
        name, count = f"{self.name}_weights", len(self.references)
        shape = () if np.ndim(factors) == 0 else (count,)
        array = np.broadcast_to(finite_array(name, factors, shape), (count,))
        return limits.WEIGHT.checked(name, array)


def inertial_signal(name: str, value: ArrayLike | None) -> np.ndarray | None:
    """A signal (3,) of an inertial sensor, checked by its own name; it may be missing."""
    if value is None:
        return None
    signal = finite_array(name, value, (3,), finite=False)
    return signal if np.isnan(signal).any() else limits.VECTOR.checked(name, signal)


def references_of(name: str, references: ArrayLike | None) -> np.ndarray:
    """Known vectors or landmarks (n, 3) in the inertial frame, (0, 3) if there are none."""
    if references is None or np.size(references) == 0:
        return np.zeros((0, 3))
    return finite_array(name, references, (None, 3))
