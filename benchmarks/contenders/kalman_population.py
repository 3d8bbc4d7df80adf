"""The limit for populations of Kalman filters: `kalman_filter.c`, with posegsa's own arrays."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from contenders import c
from contenders.c import FLOATS
from posegsa.filters.kalman import KalmanFilter
from posegsa.model.vectors import VectorSamples
from posegsa.search.population import ScenarioBatch

SOURCES = ("kalman_filter.c",)


def build(folder: Path, states: int) -> Path:
    """Compile the library for 12 or 18 states.

    Raises:
        RuntimeError: there is no compiler, or it fails.
    """
    return c.build(folder, sources=SOURCES, defined=[f"STATES={states}"])


def prepare(
    batch: ScenarioBatch, filters: KalmanFilter, library: Path, threads: int = 1
) -> Callable[[], np.ndarray]:
    """A function of no arguments that computes the costs (S, A), float32.

    Args:
        batch: S scenarios.
        filters: A of them, which differ in their noises: leaves (A,).
        library: from `build`, for the same number of states.
        threads: number of threads.

    Raises:
        RuntimeError: the library was built from another source.
    """
    sample = packed(batch)
    noises = np.ascontiguousarray(np.stack([np.asarray(n) for n in filters.noise], -1), np.float32)
    loaded = ctypes.CDLL(str(library))
    made = loaded.kalman_filter_sample_numbers(), loaded.kalman_filter_numbers()
    if made != (sample.shape[-1], noises.shape[-1]):
        raise RuntimeError(f"{library}: its samples and filters have {made} numbers")
    run = loaded.kalman_filter_costs
    run.argtypes = [ctypes.c_int] * 3 + [FLOATS] * 3 + [ctypes.c_float, ctypes.c_int, FLOATS]
    initial = batch.initial
    start = _joined(
        (*initial.attitude, *initial.place, *initial.bias_angular, *initial.bias_linear)
    )
    out = np.empty((len(sample), len(noises)), np.float32)
    given = *sample.shape[:2], len(noises), sample, start, noises

    def costs() -> np.ndarray:
        run(*given, float(batch.weights.position), threads, out)
        return out

    return costs


def packed(batch: ScenarioBatch) -> np.ndarray:
    """The samples as the C code reads them, (S, N, numbers).

    Raises:
        ValueError: the C code does not compute these scenarios.
    """
    sample, truth, weights = batch.samples.sample, batch.samples.truth, batch.weights
    if truth is None or not isinstance(sample.vectors, VectorSamples) or batch.end is not None:
        raise ValueError("the C code needs the truth throughout, and each vector as measured")
    vectors, (landmark,) = sample.vectors.each, sample.landmarks
    factors = [seen.factor for seen in (*vectors, landmark)]
    if len(vectors) != 2 or not all(np.all(np.equal(factor, 1)) for factor in factors):
        raise ValueError("the C code needs two vectors and one landmark in every sample")
    counted = np.asarray(weights.transient) + np.asarray(weights.steady)
    return _joined(
        (
            *sample.angular_velocity,
            *sample.velocity,
            *(component for vector in vectors for component in vector.measured),
            *(component for vector in vectors for component in vector.known),
            *landmark.body,
            *landmark.inertial,
            *truth.attitude,
            *truth.origin,
            np.broadcast_to(counted, sample.time_step.shape),
            sample.time_step,
        )
    )


def _joined(components: tuple[jax.Array | np.ndarray, ...]) -> np.ndarray:
    return np.ascontiguousarray(np.stack([np.asarray(a) for a in components], -1), np.float32)
