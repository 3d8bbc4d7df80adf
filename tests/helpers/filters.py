"""Settings, states and measurements, consistent or not, for the tests of the filter."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from helpers.arrays import as_arrays
from helpers.experiments import PAPER
from helpers.measurements import random_measurements, random_poses, reference_start
from posegsa.filters.base import sensors_of
from posegsa.filters.observer import (
    FilterSettings,
    GainLaw,
    Innovation,
    LandmarkUnit,
    Law,
    Observer,
    VectorBias,
    innovation,
    observe,
    see,
)
from posegsa.filters.rollout import step
from posegsa.model import se3
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, prepare
from posegsa.model.schedules import ConstantGain, Gains
from posegsa.model.vectors import VectorSettings

GAMMA = (3.0, 7.0)


def vector_settings(
    dtype: Any = np.float64,
    *,
    weights: Sequence[float] | None = None,
    cross_weight: float | None = None,
    normalise: bool = False,
    each_agent: bool = False,
) -> VectorSettings:
    """The vectors' settings; by default measured vectors are used as they are, no cross product."""
    return VectorSettings(
        weights=None if weights is None else tuple(jnp.asarray(s, dtype) for s in weights),
        cross_weight=jnp.asarray(cross_weight or 0.0, dtype),
        normalise=normalise,
        cross=cross_weight is not None,
        each_agent=each_agent,
    )


def vector_bias(
    dtype: Any = np.float64,
    *,
    gain: float = 0.5,
    leak: float = 0.0,
    bound: float = 0.5,
    excitation: float = 0.2,
    excitation_time: float = 1.0,
    follows: GainLaw = "fixed",
) -> VectorBias:
    """The law of the vectors' biases."""
    return VectorBias(
        gain=jnp.asarray(gain, dtype),
        leak=jnp.asarray(leak, dtype),
        per_bound=jnp.asarray(bound**-2, dtype),
        per_turning=jnp.asarray(excitation**-4, dtype),
        excitation_time=jnp.asarray(excitation_time, dtype),
        law=follows,
    )


def settings(
    dtype: Any = np.float64,
    *,
    law: Law = "gradient",
    gamma_law: GainLaw = "fixed",
    substeps: int = 1,
    gain_limit: float | None = 1.5,
    gamma: tuple[float, float] = GAMMA,
    vectors: VectorSettings | None = None,
    landmark_weights: Sequence[float] | None = None,
    learnt: VectorBias | None = None,
    length: float | None = None,
    length_growth: float | None = None,
    landmark_unit: LandmarkUnit = "metre",
    bias_wait: float | None = None,
    bias_bounds: tuple[float, float] | None = None,
) -> FilterSettings:
    """The filter's settings; by default measurements and weights are used as they are."""
    return FilterSettings(
        law=law,
        gamma_law=gamma_law,
        substeps=substeps,
        gamma_angular=jnp.asarray(gamma[0], dtype),
        gamma_linear=jnp.asarray(gamma[1], dtype),
        gain_limit=jnp.asarray(np.inf if gain_limit is None else gain_limit, dtype),
        vectors=vector_settings(dtype, each_agent=learnt is not None)
        if vectors is None
        else vectors,
        landmark_weights=landmark_weights
        and tuple(jnp.asarray(s, dtype) for s in landmark_weights),
        vector_bias=learnt,
        length=None if length is None else jnp.asarray(length, dtype),
        length_growth=None if length_growth is None else jnp.asarray(length_growth, dtype),
        landmark_unit=landmark_unit,
        per_bias_wait=None if bias_wait is None else jnp.asarray(bias_wait**-2, dtype),
        per_angular_bias_bound=bias_bounds and jnp.asarray(bias_bounds[0] ** -2, dtype),
        per_linear_bias_bound=bias_bounds and jnp.asarray(bias_bounds[1] ** -2, dtype),
    )


def prepared(m: Measurements) -> Sample:
    """The filter's input for measurements that are used as they are."""
    return prepare(m, vector_settings(m.time_step.dtype))


def innovated(state: FilterState, sample: Sample) -> Innovation:
    """U and L for measurements that are used as they are."""
    return innovation(state, sample, see(state, sample, settings(sample.time_step.dtype)))


def observed(
    state: FilterState, sample: Sample, gain: Array, chosen: FilterSettings
) -> tuple[FilterState, Array]:
    """One step of the filter, with full gains of the bias laws."""
    return observe(state, sample, see(state, sample, chosen), Gains(gain), chosen)


def stepped(
    state: FilterState, measurement: Measurements, gain: Any, chosen: FilterSettings
) -> FilterState:
    """The estimate after one sample of the observer with a constant gain, by the public step."""
    observer = Observer(ConstantGain(gain), chosen)
    before = observer.start(state, sensors_of(measurement))
    return step(observer, before, measurement)[0].estimate


jitted_observe, jitted_innovation = jax.jit(observed), jax.jit(innovated)
jitted_transform = jax.jit(se3.transform)
jitted_prepare, prepared_vectors = jax.jit(prepared), jax.jit(prepare)
jitted_state = jax.jit(initial_state, static_argnames="learnt_vectors")


def prepared_for(m: Measurements, chosen: FilterSettings) -> Sample:
    """The input of a filter with these settings."""
    return prepared_vectors(m, chosen.vectors)


def state_of(
    T: np.ndarray, b: np.ndarray | None = None, dtype: Any = np.float64, learnt_vectors: int = 0
) -> FilterState:
    """The filter's state for poses (..., 4, 4) and biases (..., 6), by NumPy and SciPy."""
    b = np.zeros((*T.shape[:-2], 6)) if b is None else b
    rotation = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3))
    q = rotation.as_quat(canonical=True, scalar_first=True).reshape(*T.shape[:-2], 4)
    w, x, y, z, px, py, pz, b0, b1, b2, b3, b4, b5 = (
        np.array(a) for a in np.moveaxis(np.concatenate([q, T[..., :3, 3], b], -1), -1, 0)
    )
    zero = np.zeros_like(px)
    zeros = (zero, zero, zero)
    made = FilterState(
        attitude=(w, x, y, z),
        place=(px, py, pz),
        bias_angular=(b0, b1, b2),
        bias_linear=(b3, b4, b5),
        vector_biases=(zeros,) * learnt_vectors,
        turning=zeros if learnt_vectors else (),
    )
    return jax.tree.map(lambda a: a.astype(dtype), made)


def start(dtype: str, learnt_vectors: int = 0) -> FilterState:
    """The paper's initial estimate."""
    return state_of(reference_start(PAPER.scenario), None, dtype, learnt_vectors)


def random_estimates(
    rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray, FilterState]:
    """Poses (count, 4, 4) and biases (count, 6), and the same as the filter's state."""
    T, b = random_poses(rng, count), rng.normal(size=(count, 6))
    return T, b, state_of(T, b)


def with_vector_biases(state: FilterState, count: int, length: float = 0.3) -> FilterState:
    """The same state, with estimates of `count` vectors' biases and of the angular velocity."""
    rng = np.random.default_rng(9)

    def vec3(size: float) -> se3.Vec3:
        x, y, z = size * rng.normal(size=(3, *state.place[0].shape))
        return x, y, z

    return state._replace(
        vector_biases=tuple(vec3(length / 3) for _ in range(count)), turning=vec3(0.5)
    )


@jax.jit
def stacked(state: FilterState) -> tuple[Array, Array, Array]:
    """T_est (..., 4, 4), b_est (..., 6) and the vectors' biases (..., n, 3)."""
    return se3.transform(state.rotation, state.position), state.bias, state.vector_bias


def matrices(state: FilterState) -> np.ndarray:
    """T_est (..., 4, 4)."""
    return np.asarray(stacked(state)[0])


def biases(state: FilterState) -> np.ndarray:
    """b_est (..., 6)."""
    return np.asarray(stacked(state)[1])


def vector_biases(state: FilterState) -> np.ndarray:
    """c_i (..., n, 3)."""
    return np.asarray(stacked(state)[2])


def leaves_close(got: Any, want: Any, **tolerance: float) -> None:
    pairs = zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True)
    for a, b in pairs:
        np.testing.assert_allclose(a, b, **({"rtol": 0} | tolerance))


def random_samples(count: int, seed: int = 0) -> tuple[Measurements, Array, FilterState]:
    """Inconsistent measurements of 3 vectors and 2 landmarks, and unrelated poses."""
    rng = np.random.default_rng(seed)
    m = as_arrays(random_measurements(rng, count, 3, 2), np.float64)
    T, _, state = random_estimates(rng, count)
    return m, jnp.asarray(T), state


def fitting(T: np.ndarray, vectors: np.ndarray, landmarks: np.ndarray) -> Measurements:
    """One exact sample at pose T: unit weights, no velocity, 0.01 s (in NumPy)."""
    R, P, zero = T[:3, :3], T[:3, 3], np.zeros(3)
    return Measurements(
        *(np.array(0.01), zero, zero),
        *(vectors @ R, vectors, np.ones(len(vectors))),
        *((landmarks - P) @ R, landmarks, np.ones(len(landmarks))),
    )
