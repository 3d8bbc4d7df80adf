"""A simulation over time in degrees and metres."""

from dataclasses import fields

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.measurements import directions, random_poses
from scipy.spatial.transform import Rotation

from posegsa.filters.rollout import Estimates
from posegsa.judging.trajectory import Trajectory, trajectory

pytestmark = pytest.mark.quick

N = 40

TRUE_BIASES = np.array([[0.1, -0.2, 0.3], [0.0, 0.5, 0.25]])


def true_and_estimated(dtype: str) -> tuple[np.ndarray, np.ndarray, Trajectory]:
    """Random poses T and T_est (N, 4, 4), and the trajectory of them."""
    rng = np.random.default_rng(0)
    T, T_est = random_poses(rng, N), random_poses(rng, N)
    with jax.enable_x64(dtype == "float64"):
        time, gain, used, error, rate = (jnp.asarray(x, dtype) for x in rng.random((5, N)))
        R, P, R_est, P_est = (
            jnp.asarray(part, dtype)
            for pose in (T, T_est)
            for part in (pose[:, :3, :3], pose[:, :3, 3])
        )
        bias = jnp.asarray(rng.normal(size=(N, 6)), dtype)
        estimates = Estimates(
            time=time,
            rotation=R_est,
            position=P_est,
            bias=bias,
            vector_bias=jnp.asarray(rng.normal(size=(N, 2, 3)), dtype),
            gain=gain,
            gain_used=used,
            error=error,
            rate=rate,
        )
        made = trajectory(R, P, estimates, TRUE_BIASES)
    return T, T_est, made


@pytest.mark.usefixtures("x64")
def test_estimates_of_the_vectors_biases_and_their_errors() -> None:
    _, _, made = true_and_estimated("float64")
    each = made.vector_bias_est.reshape(-1, 2, 3)
    distance = np.linalg.norm(each - TRUE_BIASES, axis=2)
    np.testing.assert_allclose(made.vector_bias_error, distance, rtol=1e-12)
    assert distance.min() > 0


def test_errors_against_the_reference() -> None:
    T, T_est, made = true_and_estimated("float64")
    distance, position = np.transpose(
        [reference.pose_errors(*pair) for pair in zip(T_est, T, strict=True)]
    )
    np.testing.assert_allclose(made.attitude_distance, distance, rtol=1e-12)
    np.testing.assert_allclose(made.position_error, position, rtol=1e-12)
    away = np.linalg.norm(T_est[:, :3, 3] - T[:, :3, 3], axis=1)
    np.testing.assert_allclose(made.distance, away, rtol=1e-12)
    assert (np.abs(away - position) > 0.1).any(), "they are two things"
    R_err = T_est[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    angle = np.degrees(Rotation.from_matrix(R_err).magnitude())
    # Near 180 degrees the distance hardly depends on the angle: rounding of 1e-16 becomes 1e-7.
    np.testing.assert_allclose(made.attitude_error, angle, rtol=0, atol=1e-6)


def test_angles_are_roll_pitch_and_yaw_in_degrees() -> None:
    T, T_est, made = true_and_estimated("float64")
    for ours, poses in ((made.euler, T), (made.euler_est, T_est)):
        yaw_pitch_roll = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX", degrees=True)
        np.testing.assert_allclose(ours, yaw_pitch_roll[:, ::-1], rtol=0, atol=1e-9)
    assert np.abs(made.euler).max() > 90


def test_errors_by_axis_are_those_of_the_body_frame() -> None:
    T, T_est, made = true_and_estimated("float64")
    between = Rotation.from_matrix(T_est[:, :3, :3]).inv() * Rotation.from_matrix(T[:, :3, :3])
    wanted = between.as_rotvec(degrees=True)
    np.testing.assert_allclose(made.attitude_parts, wanted, rtol=0, atol=1e-6)


def test_deviations_are_by_axis_of_the_body_and_of_the_inertial_frame() -> None:
    """By sampling errors of the covariance, and moving the estimate by them."""
    rng = np.random.default_rng(2)
    root = 0.01 * rng.normal(size=(6, 6))
    T, T_est, _ = true_and_estimated("float64")
    with jax.enable_x64(True):
        nothing = dict.fromkeys(("gain", "gain_used", "error", "rate"), jnp.zeros(N))
        estimates = Estimates(
            time=jnp.arange(float(N)),
            rotation=jnp.asarray(T_est[:, :3, :3]),
            position=jnp.asarray(T_est[:, :3, 3]),
            bias=jnp.zeros((N, 6)),
            vector_bias=jnp.zeros((N, 0, 3)),
            covariance=jnp.asarray(np.broadcast_to(root @ root.T, (N, 6, 6))),
            **nothing,
        )
        made = trajectory(T[:, :3, :3], T[:, :3, 3], estimates, np.zeros((0, 3)))
    xi = rng.normal(size=(40000, 6)) @ root.T
    theta = np.degrees(np.std(xi[:, :3], axis=0))
    np.testing.assert_allclose(made.attitude_sigma, np.broadcast_to(theta, (N, 3)), rtol=0.02)
    for k in range(3):
        moved = xi[:, 3:] @ T_est[k, :3, :3].T
        np.testing.assert_allclose(made.position_sigma[k], np.std(moved, axis=0), rtol=0.02)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_everything_else_is_taken_as_it_is(dtype: str) -> None:
    T, T_est, made = true_and_estimated(dtype)
    np.testing.assert_array_equal(made.position.astype(dtype), T[:, :3, 3].astype(dtype))
    np.testing.assert_array_equal(made.position_est.astype(dtype), T_est[:, :3, 3].astype(dtype))
    assert all(getattr(made, field.name).dtype == np.float64 for field in fields(Trajectory))
    shapes = {field.name: getattr(made, field.name).shape[1:] for field in fields(Trajectory)}
    vectors = {"euler": (3,), "euler_est": (3,), "position": (3,), "position_est": (3,)}
    biases = {"bias_est": (6,), "vector_bias_est": (6,), "vector_bias_error": (2,)}
    axes = dict.fromkeys(("attitude_parts", "attitude_sigma", "position_sigma"), (3,))
    assert shapes == dict.fromkeys(shapes, ()) | vectors | biases | axes
    assert np.isnan(made.attitude_sigma).all()
    assert np.isnan(made.position_sigma).all()


def test_distances_of_half_a_turn_are_not_rounded_above_one() -> None:
    turns = Rotation.random(1000, rng=np.random.default_rng(0))
    half_turns = Rotation.from_rotvec(np.pi * directions(1000)) * turns
    R, R_est = (jnp.asarray(r.as_matrix(), jnp.float32) for r in (turns, half_turns))
    nothing = {name: jnp.zeros(1000) for name in ("time", "gain", "gain_used", "error", "rate")}
    position, bias = jnp.zeros((1000, 3)), jnp.zeros((1000, 6))
    none = jnp.zeros((1000, 0, 3))
    estimates = Estimates(rotation=R_est, position=position, bias=bias, vector_bias=none, **nothing)
    made = trajectory(R, position, estimates, np.zeros((0, 3)))
    assert made.attitude_distance.max() == 1
