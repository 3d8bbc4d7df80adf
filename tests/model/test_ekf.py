"""The Kalman filter against a plain reference, against gtsam, and against statistics."""

import warnings
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference_ekf
import scipy.stats
from builders import as_arrays, experiment, quietly, random_measurements, random_poses
from builders import reference_sample as sample_of
from jax import Array
from reference import se3_exp, skew

from posegsa.errors import ArgumentError
from posegsa.model.cost import CostWeights, trajectory_cost
from posegsa.model.ekf import (
    EkfNoise,
    ekf_cost,
    ekf_errors,
    ekf_nees,
    ekf_samples,
    ekf_start,
    nees,
    run_ekf,
    update,
)
from posegsa.model.filter import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import Samples, samples_of
from posegsa.model.scenario import integrate, measure
from posegsa.model.se3 import quaternion, random_rotation, unstack
from posegsa.model.signal import TruePose
from posegsa.model.vectors import VectorSettings

PLAIN = reference_ekf.Noise(
    velocity=np.array([0.02, 0.02, 0.02, 0.01, 0.01, 0.01]),
    bias_walk=np.array([0.003, 0.003, 0.003, 0.002, 0.002, 0.002]),
    vector_walk=0.001,
    vector=0.1,
    landmark=0.2,
    pose=np.array([0.5, 0.5, 0.5, 2.0, 2.0, 2.0]),
    bias=np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3]),
    vector_bias=0.15,
)


def noise_of(plain: reference_ekf.Noise, dtype: Any = np.float64) -> EkfNoise:
    """The same in the package's form."""
    return as_arrays(
        EkfNoise(
            angular_velocity=plain.velocity[0],
            velocity=plain.velocity[3],
            angular_walk=plain.bias_walk[0],
            linear_walk=plain.bias_walk[3],
            vector_walk=plain.vector_walk,
            vector=plain.vector,
            landmark=plain.landmark,
            initial_attitude=plain.pose[0],
            initial_position=plain.pose[3],
            initial_angular_bias=plain.bias[0],
            initial_linear_bias=plain.bias[3],
            initial_vector_bias=plain.vector_bias,
        ),
        dtype,
    )


jitted_samples = jax.jit(ekf_samples)
jitted_nees = jax.jit(ekf_nees)


def run_reference(
    m: Measurements, T: np.ndarray, b: np.ndarray, learnt: int
) -> list[reference_ekf.State]:
    samples = [sample_of(m, k) for k in range(len(m.time_step))]
    return reference_ekf.run(samples, reference_ekf.start(T, b, learnt, PLAIN), PLAIN)


@pytest.mark.usefixtures("x64", "compile_fast")
@pytest.mark.parametrize("learnt", [0, 2], ids=["12 states", "18 states"])
def test_agrees_with_the_matrix_form(learnt) -> None:
    """Measurements that fit no pose, uneven steps and weights, a third of the sensors missing."""
    rng = np.random.default_rng(0)
    m = random_measurements(rng, 40, 2, 1, missing=0.3)
    T, b = random_poses(rng, 1)[0], 0.3 * rng.normal(size=6)
    initial = initial_state(T[:3, :3], T[:3, 3], b, learnt_vectors=learnt)
    truth = random_poses(rng, 40)
    samples = jitted_samples(as_arrays(m, np.float64), truth[:, :3, :3], truth[:, :3, 3])
    noise = noise_of(PLAIN)
    estimates = run_ekf(samples, initial, noise)
    want = run_reference(m, T, b, learnt)
    close = {"rtol": 0, "atol": 1e-9}
    for k, state in enumerate(want[:-1]):
        np.testing.assert_allclose(estimates.rotation[k], state.T[:3, :3], **close)
        np.testing.assert_allclose(estimates.position[k], state.T[:3, 3], **close)
        np.testing.assert_allclose(estimates.bias[k], state.b, **close)
        np.testing.assert_allclose(estimates.vector_bias[k], state.c, **close)
    _, last = jitted_nees(samples, initial, noise)
    np.testing.assert_allclose(last.covariance_matrix, want[-1].Sigma, **close)
    np.testing.assert_allclose(last.estimate.position, want[-1].T[:3, 3], **close)
