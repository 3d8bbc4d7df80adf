"""The paper's experiment as the tests vary it, and the reference's view of it.

The reference (`reference`) knows nothing of the package; what translates between them is here.
"""

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import reference
import scipy.linalg
from builders import as_arrays, reference_sample
from filters import state_of
from jax import Array
from numpy.typing import ArrayLike

from posegsa import config
from posegsa.model.cost import CostParts, CostWeights, sample_error
from posegsa.model.filter import FilterSettings, FilterState, initial_state
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import Estimates, Samples, samples_of
from posegsa.model.scenario import Scenario, Truth, integrate, measure
from posegsa.model.signal import pose_errors
from posegsa.model.vectors import VectorSettings
from posegsa.search.build import (
    filter_settings,
    parameter_space,
    scenario,
    scenario_batch,
    search_space,
)
from posegsa.search.candidates import SearchSpace
from posegsa.search.keys import scenario_keys
from posegsa.search.parameters import ParameterSpace
from posegsa.search.population import ScenarioBatch

PAPER = config.load(Path(__file__).parent.parent / "configs" / "paper.toml")
RULES = tuple(tuple(row) for row in reference.PAPER_RULES.tolist())

LEARNT = (
    *("filter.vector_bias=estimated", "filter.vector_bias_law=linear"),
    *("filter.gamma_law=quadratic", "filter.substeps=2", "gain.smoothing=1.5"),
    *("filter.length=2.0", "filter.bias_bound=[0.5, 1.5]"),
)
"""The laws of the recommended filter, and all numbers that a filter may have."""


def paper(*settings: str, dtype: str = "float64") -> config.Experiment:
    """The paper's experiment with single values changed, as `--set` does."""
    return config.override(PAPER, [f"run.dtype={dtype}", *settings])


def lasting(seconds: float) -> tuple[str, ...]:
    """Settings for a shorter run, with windows at the same fractions of it as the paper's."""
    N = round(seconds / PAPER.scenario.sampling_time)
    return (
        f"scenario.duration={seconds}",
        f"cost.transient_window=[0, {N // 15}]",
        f"cost.steady_window=[{4 * N // 15}, {14 * N // 15}]",
    )


# Parameter vectors and controllers ----------------------------------------------------------------


def search_vectors(count: int, seed: int = 0) -> np.ndarray:
    """Vectors k (count, 22) drawn uniformly from the paper's boxes, not repaired."""
    rng = np.random.default_rng(seed)
    return rng.uniform(reference.PAPER_LOWER, reference.PAPER_UPPER, (count, 22))


def corner_vectors(count: int, seed: int = 0) -> np.ndarray:
    """The same with entries on an end of their box: half of them, or in every second vector all.

    The first two vectors are the upper and the lower bounds themselves.
    """
    rng = np.random.default_rng(seed)
    ends = np.where(rng.random((count, 22)) < 0.5, reference.PAPER_LOWER, reference.PAPER_UPPER)
    share = np.where(np.arange(count) % 2, 1.0, 0.5)[:, None]
    vectors = np.where(rng.random((count, 22)) < share, ends, search_vectors(count, seed + 1))
    vectors[:2] = reference.PAPER_UPPER, reference.PAPER_LOWER
    return vectors


def repaired_terms(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Input and output terms (count, 5, 3) by the reference's own repair."""
    low, high = reference.PAPER_LOWER, reference.PAPER_UPPER
    inputs, outputs = zip(*(reference.repair(k, low, high) for k in vectors), strict=True)
    return np.array(inputs), np.array(outputs)


def space(*settings: str, dtype: str = "float64") -> ParameterSpace:
    """The parameter space of the paper's experiment with single values changed."""
    return parameter_space(paper(*settings, dtype=dtype))


def searched(*settings: str, dtype: str = "float64") -> SearchSpace[ParameterSpace]:
    """What a search of the paper's experiment with single values changed looks for."""
    experiment = paper(*settings, dtype=dtype)
    return search_space(experiment, parameter_space(experiment))


def fuzzy(
    inputs: ArrayLike, outputs: ArrayLike, dtype: str = "float64", **options: Any
) -> FuzzyController:
    """A controller, with the paper's rules unless others are given."""
    terms = (jnp.asarray(np.asarray(t, np.float64), dtype) for t in (inputs, outputs))
    return FuzzyController(*terms, **{"rules": RULES, "output_range": (0.0, 100.0)} | options)


INPUTS, OUTPUTS = (terms[0] for terms in repaired_terms(search_vectors(1, seed=5)))
"""Terms with nothing special about them."""
GAPPED = [[0, 0, 0.1], [0.2, 0.2, 0.3], [0.25, 0.4, 0.6], [0.5, 0.6, 0.8], [0.7, 1, 1]]
"""Input terms that leave (0.1, 0.2) to no rule."""


def evaluated(controller: FuzzyController, error: object, rate: object, *last: float) -> np.ndarray:
    """Gains at the controller's dtype of errors and rates given as any numbers."""
    dtype = controller.output_terms.dtype
    return np.asarray(controller(*(jnp.asarray(x, dtype) for x in (error, rate, *last))))


@cache
def compiled_gain() -> Callable[..., Array]:
    """Gains (B,) of terms (B, 5, 3), errors and rates (B,)."""
    return jax.jit(jax.vmap(lambda i, o, e, r: FuzzyController(i, o, RULES, (0.0, 100.0))(e, r)))


def gains_of(*arrays: np.ndarray) -> np.ndarray:
    return np.asarray(compiled_gain()(*(jnp.asarray(a) for a in arrays)))


# Scenarios ----------------------------------------------------------------------------------------


class World(NamedTuple):
    """One scenario for one noise key, in all the forms that a test may want."""

    truth: Truth
    measurements: Measurements
    samples: Samples
    initial: FilterState


@jax.jit
def _world(one: Scenario, settings: FilterSettings, key: Array) -> World:
    truth = integrate(one)
    m = measure(one, truth, key).measurements
    initial = initial_state(
        one.rotation_estimate,
        one.position_estimate,
        one.bias_estimate,
        learnt_vectors=0 if settings.vector_bias is None else one.vectors.shape[0],
    )
    return World(truth, m, samples_of(m, settings.vectors, truth.rotation, truth.position), initial)


def built(experiment: config.Experiment) -> Scenario:
    """The scenario."""
    return scenario(experiment)


def world(experiment: config.Experiment, seed: int = 0) -> World:
    """Truth and measurements of an experiment's scenario, at its dtype."""
    return _world(built(experiment), filter_settings(experiment), jax.random.key(seed))


def posed(experiment: config.Experiment, scenarios: int = 1) -> ScenarioBatch:
    """The problem of an experiment's scenario with some noise keys, at its dtype."""
    return scenario_batch(
        experiment, built(experiment), scenario_keys(jax.random.key(0), scenarios)
    )


def without_limit(limited: ScenarioBatch) -> ScenarioBatch:
    """The same problem with every gain applied as it is."""
    return limited._replace(
        settings=dataclasses.replace(
            limited.settings, gain_limit=jnp.full_like(limited.settings.gain_limit, jnp.inf)
        )
    )


# The reference's view -----------------------------------------------------------------------------


def reference_samples(measurements: Measurements) -> list[reference.Sample]:
    """The measurements, one record a sample."""
    m = jax.tree.map(np.asarray, measurements)
    return [reference_sample(m, k) for k in range(len(m.time_step))]


def pose_matrix(rotation: ArrayLike, position: ArrayLike) -> np.ndarray:
    """T (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def reference_start(c: config.ScenarioConfig) -> np.ndarray:
    """T_est(0), the printed rotation projected in another way than the package does it: polar."""
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
    """The true poses (N, 4, 4), at even time steps or those given (N,)."""
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
    """True poses (N, 4, 4) of the paper's motion and what other sensors say of it, by NumPy alone.

    Args:
        step: (N,) time steps [s].
        vectors: (n, 3) of any length.
        landmarks: (m, 3) [m].
        missing: share of vectors and landmarks that have weight 0, and NaN for their value.
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


def tracked(
    measurements: Measurements, truth: np.ndarray, vectors: VectorSettings, dtype: str
) -> Samples:
    """What a simulation reads, of measurements and true poses (N, 4, 4)."""
    rotation, position = (jnp.asarray(T, dtype) for T in (truth[:, :3, :3], truth[:, :3, 3]))
    return jax.jit(samples_of)(as_arrays(measurements, dtype), vectors, rotation, position)


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


def cost_of_estimates(estimates: Estimates, scenario: Samples, weights: CostWeights) -> CostParts:
    """The cost of a trajectory, from its errors."""
    poses = initial_state(estimates.rotation, estimates.position)
    return trajectory_cost(*pose_errors(poses, scenario.truth), weights)


def start(dtype: str, learnt_vectors: int = 0) -> FilterState:
    """The paper's initial estimate."""
    return state_of(reference_start(PAPER.scenario), None, dtype, learnt_vectors)
