"""What several tests need made: poses, measurements and scenarios with nothing special in them."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from helpers import reference
from posegsa.config import CostConfig, Experiment, FilterConfig, RunConfig, ScenarioConfig
from posegsa.errors import PosegsaWarning
from posegsa.model.measurements import Measurements
from posegsa.model.scenario import Scenario
from posegsa.search.build import scenario

AT_REST: dict[str, Any] = {"angular_velocity": ((), (), ()), "velocity": ((), (), ())}
"""A scenario without motion."""


def epsilon(dtype: type[np.floating]) -> float:
    return float(np.finfo(dtype).eps)


def directions(count: int, seed: int = 0) -> np.ndarray:
    """Unit vectors (count, 3)."""
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def random_poses(rng: np.random.Generator, count: int, spread: float = 3.0) -> np.ndarray:
    """Poses (count, 4, 4): any attitude, positions of `spread` m per axis."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = spread * rng.normal(size=(count, 3))
    return T


def random_measurements(
    rng: np.random.Generator, samples: int, vectors: int, landmarks: int, missing: float = 0.0
) -> Measurements:
    """Measurements that fit no pose, with uneven time steps, lengths and weights, in float64.

    A share `missing` of vectors and landmarks has weight 0, and NaN for its value.
    """

    def sightings(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weights = rng.uniform(0.2, 2.0, (samples, count))
        weights[rng.uniform(size=weights.shape) < missing] = 0
        body, known = rng.normal(size=(2, samples, count, 3))
        return np.where(weights[..., None] > 0, body, np.nan), known, weights

    omega, v = rng.normal(size=(2, samples, 3))
    step = rng.uniform(0.005, 0.03, samples)
    return Measurements(step, omega, v, *sightings(vectors), *sightings(landmarks))


def as_arrays(tree: Any, dtype: Any) -> Any:
    """Every leaf as a JAX array of this dtype."""
    return jax.tree.map(lambda a: jnp.asarray(a, dtype), tree)


def reference_sample(measurements: Measurements, k: int) -> reference.Sample:
    """Sample k in the form that the reference reads."""
    m = jax.tree.map(lambda a: np.asarray(a, np.float64)[k], measurements)
    return reference.Sample(
        dt=float(m.time_step),
        omega=m.angular_velocity,
        v=m.velocity,
        y=m.landmarks,
        p=m.landmark_references,
        sL=m.landmark_weights,
        vB=m.vectors,
        vI=m.vector_references,
        sR=m.vector_weights,
    )


def experiment(dtype: str = "float64", *, cross_vector: bool = True, **scenario: Any) -> Experiment:
    """The paper's experiment with another scenario, of any length."""
    return Experiment(
        filter=FilterConfig(cross_vector=cross_vector),
        run=RunConfig(dtype=dtype),
        scenario=ScenarioConfig(**scenario),
        cost=CostConfig(transient_window=(0, 1), steady_window=(1, 1)),
    )


def quietly(experiment: Experiment) -> Scenario:
    """The scenario of an experiment, without the warning about the paper's initial estimate."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PosegsaWarning)
        return scenario(experiment)
