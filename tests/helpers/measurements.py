"""Poses, measurements and truth: random, or of the paper's motion.

`reference` is independent of the package; the functions that translate between them are here.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jax import Array
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from helpers import reference
from helpers.arrays import as_arrays
from helpers.experiments import PAPER
from posegsa import config
from posegsa.filters.base import Filter, Samples, samples_of
from posegsa.filters.observer import Observer
from posegsa.filters.rollout import Estimates
from posegsa.model.cost import CostParts, CostWeights, sample_error
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.scenario import Scenario, Truth, integrate, measure
from posegsa.model.signal import pose_errors
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario


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

    A share `missing` of the vectors and landmarks has weight 0 and is NaN.
    """

    def sightings(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weights = rng.uniform(0.2, 2.0, (samples, count))
        weights[rng.uniform(size=weights.shape) < missing] = 0
        body, known = rng.normal(size=(2, samples, count, 3))
        return np.where(weights[..., None] > 0, body, np.nan), known, weights

    omega, v = rng.normal(size=(2, samples, 3))
    step = rng.uniform(0.005, 0.03, samples)
    return Measurements(step, omega, v, *sightings(vectors), *sightings(landmarks))


# The paper's scenario -----------------------------------------------------------------------------


class World(NamedTuple):
    """One scenario for one noise key, in all forms that tests use."""

    truth: Truth
    measurements: Measurements
    samples: Samples
    initial: FilterState


@jax.jit
def _world(one: Scenario, filter: Observer, key: Array) -> World:
    truth = integrate(one)
    m = measure(one, truth, key).measurements
    initial = initial_state(
        one.rotation_estimate,
        one.position_estimate,
        one.bias_estimate,
    )
    return World(truth, m, samples_of(filter, m, truth.rotation, truth.position), initial)


def world(experiment: config.Experiment, seed: int = 0) -> World:
    """Truth and measurements of an experiment's scenario, at its dtype."""
    return _world(scenario(experiment), filter_of(experiment), jax.random.key(seed))


# The reference's view -----------------------------------------------------------------------------


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


def reference_samples(measurements: Measurements) -> list[reference.Sample]:
    """The measurements, one record per sample."""
    m = jax.tree.map(np.asarray, measurements)
    return [reference_sample(m, k) for k in range(len(m.time_step))]


def pose_matrix(rotation: ArrayLike, position: ArrayLike) -> np.ndarray:
    """T (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def reference_start(c: config.ScenarioConfig) -> np.ndarray:
    """T_est(0); unlike the package, it projects the printed rotation by a polar decomposition."""
    rotation, _ = scipy.linalg.polar(np.array(c.initial_rotation_estimate))
    return pose_matrix(rotation, c.initial_position_estimate)


def motion(c: config.ScenarioConfig, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """True angular and linear velocity (N, 3), from the configured sines, at times (N,)."""

    def profile(axes: config.Sines) -> np.ndarray:
        return np.stack(
            [
                sum((s.amplitude * np.sin(s.frequency * time + s.phase) for s in axis), 0 * time)
                for axis in axes
            ],
            axis=1,
        )

    return profile(c.angular_velocity), profile(c.velocity)


def reference_truth(c: config.ScenarioConfig, step: np.ndarray | None = None) -> np.ndarray:
    """The true poses (N, 4, 4), at even or given time steps (N,)."""
    step = np.full(c.samples, c.sampling_time) if step is None else step
    start = pose_matrix(c.initial_rotation, c.initial_position)
    return reference.integrate_truth(*motion(c, np.cumsum(step) - step), step, start)


def sensed(
    step: np.ndarray,
    vectors: ArrayLike,
    landmarks: ArrayLike,
    *,
    missing: float = 0.0,
    vector_bias: float = 0.0,
) -> tuple[np.ndarray, Measurements]:
    """True poses (N, 4, 4) of the paper's motion and measurements of other sensors, in NumPy.

    Args:
        step: (N,) time steps [s].
        vectors: (n, 3) of any length.
        landmarks: (m, 3) [m].
        missing: share of the vectors and landmarks that have weight 0 and are NaN.
        vector_bias: standard deviation of each component of the vectors' constant biases.
    """
    rng, N = np.random.default_rng(0), len(step)
    truth = reference_truth(PAPER.scenario, step)
    R, P = truth[:, :3, :3], truth[:, :3, 3]
    omega, v = motion(PAPER.scenario, np.cumsum(step) - step)
    bias = np.array([PAPER.scenario.angular_velocity_bias, PAPER.scenario.velocity_bias])
    v_I, p_I = (np.broadcast_to(a, (N, *np.shape(a))) for a in (vectors, landmarks))

    def seen(away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Noisy body coordinates of inertial vectors (N, i, 3), and weights."""
        body = np.einsum("nji,nkj->nki", R, away) + 0.1 * rng.normal(size=away.shape)
        weights = rng.uniform(0.4, 1.5, (1, away.shape[1])) * (
            rng.random(body.shape[:2]) >= missing
        )
        return np.where(weights[..., None] > 0, body, np.nan), weights

    v_B, v_weights = seen(v_I)
    v_B = v_B + vector_bias * np.random.default_rng(1).normal(size=np.shape(vectors))
    y, y_weights = seen(p_I - P[:, None])
    noisy = (u + b + 0.1 * rng.normal(size=u.shape) for u, b in zip((omega, v), bias, strict=True))
    return truth, Measurements(step, *noisy, v_B, v_I, v_weights, y, p_I, y_weights)


def tracked(measurements: Measurements, truth: np.ndarray, filter: Filter, dtype: str) -> Samples:
    """The input of a simulation, from measurements and true poses (N, 4, 4)."""
    rotation, position = (jnp.asarray(T, dtype) for T in (truth[:, :3, :3], truth[:, :3, 3]))
    return jax.jit(samples_of)(filter, as_arrays(measurements, dtype), rotation, position)


@jax.jit
def trajectory_cost(attitude: Array, position: Array, weights: CostWeights) -> CostParts:
    """Cost of errors over time, all samples at once; the simulation sums them one by one.

    Args:
        attitude: (..., N) ||R_err||_I in [0, 1].
        position: (..., N) ||P_err|| [m].
        weights: for N samples.
    """
    error = sample_error(attitude, position, weights)

    def total(weight: Array) -> Array:
        return jnp.einsum("...n,n->...", error, weight, precision="highest")

    return CostParts(total(weights.transient), total(weights.steady))


@jax.jit
def cost_of_estimates(estimates: Estimates, scenario: Samples, weights: CostWeights) -> CostParts:
    """The cost of a trajectory, from its errors."""
    poses = initial_state(estimates.rotation, estimates.position)
    return trajectory_cost(*pose_errors(poses, scenario.truth), weights)
