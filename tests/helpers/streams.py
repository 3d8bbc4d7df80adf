"""Samples for a `PoseFilter`, one by one and as arrays, and a filter that reads them."""

from typing import Any

import numpy as np

import posegsa
from helpers.schedules import K, tuned

LEARNT = (
    *("filter.vector_bias=estimated", "filter.substeps=2", "gain.smoothing=0.3"),
    *("gain.unknown=0.5", "filter.bias_wait=3.0", "filter.length_growth=0.1"),
)
N = 40
START = {"rotation": np.diag([1.0, -1.0, -1.0]), "position": np.array([0.5, -1.0, 2.0])}


def learning_filter(dtype: str = "float64") -> posegsa.Result:
    """An observer that estimates the vectors' biases."""
    return tuned(K, *LEARNT, dtype=dtype)


def stream(result: posegsa.Result, seed: int = 0) -> tuple[np.ndarray, dict[str, Any], dict]:
    """Time steps (N,), samples by argument of `update`, and references; a third is missing.

    No velocity is missing, because `Measurements` does not allow this.
    """
    rng, scenario = np.random.default_rng(seed), result.experiment.scenario
    references = {
        "vector_references": np.array([v.direction for v in scenario.vectors]),
        "landmark_references": np.array([p.position for p in scenario.landmarks]),
    }
    vectors, landmarks = (
        known + 0.3 * rng.normal(size=(N, *known.shape)) for known in references.values()
    )
    vectors[rng.uniform(size=vectors.shape[:2]) < 0.3] = np.nan
    vectors[3, 1, 2] = np.nan  # partly missing
    landmarks[rng.uniform(size=landmarks.shape[:2]) < 0.3] = np.nan
    omega, v = rng.normal(size=(2, N, 3))
    samples = {"angular_velocity": omega, "velocity": v, "vectors": vectors, "landmarks": landmarks}
    return rng.uniform(0.005, 0.03, N), samples, references


def fed(pose_filter: posegsa.PoseFilter, steps: np.ndarray, samples: dict, span=None) -> list:
    """The pose after each of these samples."""
    chosen = range(*(span or slice(None)).indices(N))
    return [
        pose_filter.update(time_step=steps[k], **{name: a[k] for name, a in samples.items()})
        for k in chosen
    ]


def at_once(steps, samples, references, dtype) -> posegsa.Measurements:
    return posegsa.Measurements.from_arrays(time_step=steps, **samples, **references, dtype=dtype)
