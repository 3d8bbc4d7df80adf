"""The sensors that a filter was tuned for: their references and weights."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from pydantic import AfterValidator

from posegsa.config import Experiment
from posegsa.filters.observer import FilterSettings
from posegsa.model.measurements import Measurements
from posegsa.recordings.frames import Frame
from posegsa.recordings.imu import references
from posegsa.recordings.recording import Recording
from posegsa.settings.fields import NonNegative

Vector = tuple[float, float, float]


class KnownSensors(NamedTuple):
    """The vectors and landmarks of a filter, in order."""

    vectors: list[Vector]
    """v_i^I, inertial frame."""
    vector_weights: list[NonNegative]
    """Factors on the filter's weights s_i^R, from the recordings that it was tuned on."""
    landmarks: list[Vector]
    """p_i, inertial frame [m]."""
    landmark_weights: list[NonNegative]
    """Factors on the filter's weights s_i^L."""
    attitude_only: bool
    """True if there is no velocity and no position."""

    def weighted(self, settings: FilterSettings) -> FilterSettings:
        """A filter's settings for these sensors, with the factors multiplied into its weights.

        A measurement then has the factor 1, a missing measurement 0.
        """
        vectors = settings.vectors
        both = min(self.vector_weights[:2], default=1.0)
        return replace(
            settings,
            vectors=replace(
                vectors,
                weights=_products(vectors.weights, self.vector_weights),
                cross_weight=vectors.cross_weight * both,
            ),
            landmark_weights=_products(settings.landmark_weights, self.landmark_weights),
        )


def _one_weight_each(sensors: KnownSensors) -> KnownSensors:
    """Check that each sensor has a weight, and return the sensors."""
    for kind in ("vector", "landmark"):
        there, weights = (len(getattr(sensors, f"{kind}{end}")) for end in ("s", "_weights"))
        if there != weights:
            raise ValueError(f"{kind}_weights are {weights}; allowed: {there}, one for each {kind}")
    return sensors


StoredSensors = Annotated[KnownSensors, AfterValidator(_one_weight_each)]
"""Sensors with a weight for each."""


def of_scenario(experiment: Experiment) -> KnownSensors:
    """The sensors of an experiment's scenario."""
    scenario = experiment.scenario
    return KnownSensors(
        vectors=[one.direction for one in scenario.vectors],
        vector_weights=[1.0] * len(scenario.vectors),
        landmarks=[one.position for one in scenario.landmarks],
        landmark_weights=[1.0] * len(scenario.landmarks),
        attitude_only=False,
    )


def of_frame(frame: Frame) -> KnownSensors:
    """Specific force and magnetic field in an inertial frame."""
    return KnownSensors(
        vectors=[(float(x), float(y), float(z)) for x, y, z in references(frame)],
        vector_weights=[1.0, 1.0],
        landmarks=[],
        landmark_weights=[],
        attitude_only=True,
    )


def of_recordings(recordings: Sequence[Recording]) -> KnownSensors | None:
    """The sensors of recordings; None if their references differ or move.

    The weight of a sensor is the median of its weights at the samples where it is measured. Those
    are the weights given for the recording, times the number of samples between two measurements.
    """
    if not recordings:
        return None
    vectors, landmarks = (_references(recordings, kind) for kind in ("vector", "landmark"))
    if vectors is None or landmarks is None:
        return None
    return KnownSensors(
        vectors=vectors,
        vector_weights=_weights(recordings, "vector"),
        landmarks=landmarks,
        landmark_weights=_weights(recordings, "landmark"),
        attitude_only=all(one.attitude_only for one in recordings),
    )


def _references(recordings: Sequence[Recording], kind: str) -> list[Vector] | None:
    """References (n, 3) if they are the same in all samples of all recordings, else None."""
    each = [_array(one.measurements, f"{kind}_references") for one in recordings]
    first = each[0][0]
    if any(a.shape[1:] != first.shape or (a != first).any() for a in each):
        return None
    return [(float(x), float(y), float(z)) for x, y, z in first]


def _weights(recordings: Sequence[Recording], kind: str) -> list[float]:
    weights = np.concatenate([_array(one.measurements, f"{kind}_weights") for one in recordings])
    return [float(np.median(w[w > 0])) if (w > 0).any() else 1.0 for w in weights.T]


def _array(measurements: Measurements, name: str) -> np.ndarray:
    return np.asarray(getattr(measurements, name))


def _products(weights: tuple[Array, ...] | None, factors: list[float]) -> tuple[Array, ...]:
    one = jnp.ones(())
    given = (one,) * len(factors) if weights is None else weights
    return tuple(w * jnp.asarray(f, w.dtype) for w, f in zip(given, factors, strict=True))
