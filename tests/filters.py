"""What the tests of the filter share: settings, states, measurements that fit or that do not."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from builders import as_arrays, random_measurements, random_poses
from jax import Array

from posegsa.config import FilterConfig
from posegsa.model import se3
from posegsa.model.filter import FilterSettings, FilterState, initial_state, innovation, observe
from posegsa.model.measurements import Measurements, prepare
from posegsa.search.build import filter_settings

GAMMA = (3.0, 7.0)

jitted_observe, jitted_innovation = jax.jit(observe), jax.jit(innovation)
jitted_transform = jax.jit(se3.transform)
jitted_prepare, jitted_state = jax.jit(prepare), jax.jit(initial_state)


def settings(
    dtype: Any = np.float64,
    *,
    law: str = "gradient",
    substeps: int = 1,
    gain_limit: float | None = 1.5,
    gamma: tuple[float, float] = GAMMA,
) -> FilterSettings:
    limit = "off" if gain_limit is None else gain_limit
    chosen = FilterConfig(law=law, substeps=substeps, gain_limit=limit, gamma=gamma)
    return filter_settings(chosen, dtype)


def random_estimates(
    rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray, FilterState]:
    """Poses (count, 4, 4) and biases (count, 6), and the same as the filter's state."""
    T, b = random_poses(rng, count), rng.normal(size=(count, 6))
    return T, b, jitted_state(T[:, :3, :3], T[:, :3, 3], b)


def matrices(state: FilterState) -> np.ndarray:
    """T_est (..., 4, 4)."""
    return np.asarray(jitted_transform(state.rotation, state.position))


def leaves_close(got: Any, want: Any, **tolerance: float) -> None:
    pairs = zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True)
    for a, b in pairs:
        np.testing.assert_allclose(a, b, **({"rtol": 0} | tolerance))


def random_samples(count: int, seed: int = 0) -> tuple[Measurements, Array, FilterState]:
    """Inconsistent measurements of 3 vectors and 2 landmarks, and poses that fit none of them."""
    rng = np.random.default_rng(seed)
    m = as_arrays(random_measurements(rng, count, 3, 2), np.float64)
    T, _, state = random_estimates(rng, count)
    return m, jnp.asarray(T), state


def fitting(T: np.ndarray, vectors: np.ndarray, landmarks: np.ndarray) -> Measurements:
    """One sample without error, seen from T: unit weights, no velocity, 0.01 s (in NumPy)."""
    R, P, zero = T[:3, :3], T[:3, 3], np.zeros(3)
    return Measurements(
        *(np.array(0.01), zero, zero),
        *(vectors @ R, vectors, np.ones(len(vectors))),
        *((landmarks - P) @ R, landmarks, np.ones(len(landmarks))),
    )
