"""Rotations: quaternions, attitude errors, Euler angles, projection; against SciPy."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import epsilon
from helpers.measurements import directions
from jax import Array, lax
from scipy.spatial.transform import Rotation

from posegsa.model import se3

PRINTED = np.array([[-0.829, 0.293, 0.343], [0.399, 0.157, 0.903], [0.210, 0.943, -0.257]])
"""The paper's initial attitude estimate, which is not a rotation."""

jitted_quaternion, jitted_angle = jax.jit(se3.quaternion), jax.jit(se3.rotation_angle)
jitted_matrix, jitted_euler = jax.jit(se3.rotation_matrix), jax.jit(se3.euler_angles)


@jax.jit
def composed(p: Array, q: Array) -> Array:
    """The product of quaternions (..., 4)."""
    return se3.stack(se3.compose(se3.unstack(p), se3.unstack(q)))


def random_rotations(count: int, seed: int = 0) -> np.ndarray:
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix()


def random_quaternions(count: int, seed: int = 0) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix, from SciPy."""
    return Rotation.from_rotvec(np.asarray(axis) * angle).as_matrix()


# Quaternions --------------------------------------------------------------------------------------


def near_the_branches() -> np.ndarray:
    """Rotations where each of Shepperd's divisors is largest, ties, and half turns."""
    axes = np.concatenate([np.eye(3), directions(4), [[1, 1, 1] / np.sqrt(3), [0, 0.6, 0.8]]])
    angles = [0.0, 1e-9, 1e-3, 1.0, math.pi / 2, 2 * math.pi / 3, 3.0]
    angles += [math.pi + d for d in (-1e-3, -1e-8, 0.0, 1e-8, 1e-3)]
    turns = [turn(axis, sign * angle) for axis in axes for angle in angles for sign in (1, -1)]
    exact_half_turns = [np.diag(d) for d in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    return np.array([*turns, *exact_half_turns, *random_rotations(50)], dtype=np.float64)


def test_matrix_to_quaternion_and_back_near_all_branches_and_half_turns(dtype) -> None:
    R = near_the_branches().astype(dtype)
    q = jitted_quaternion(R)
    assert q.dtype == dtype
    assert (np.asarray(q)[:, 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1, rtol=2 * epsilon(dtype))
    np.testing.assert_allclose(jitted_matrix(q), R, atol=8 * epsilon(dtype))


def test_quaternion_to_matrix_and_back_is_the_same_up_to_sign(dtype) -> None:
    q = np.concatenate([random_quaternions(50), np.eye(4), [[0.5, 0.5, 0.5, 0.5]]]).astype(dtype)
    back = np.asarray(jitted_quaternion(jitted_matrix(q)))
    sign = np.sign(np.sum(q * back, axis=-1, keepdims=True))
    np.testing.assert_allclose(sign * back, q, atol=4 * epsilon(dtype))


@pytest.mark.usefixtures("x64")
def test_quaternion_is_hamiltons_scalar_first() -> None:
    R = random_rotations(20)
    theirs = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
    np.testing.assert_allclose(jitted_quaternion(R), theirs, atol=1e-15)


@pytest.mark.usefixtures("x64")
def test_compose_is_the_matrix_product_in_the_same_order() -> None:
    p, q = random_quaternions(20, seed=1), random_quaternions(20, seed=2)
    want = np.asarray(jitted_matrix(p)) @ np.asarray(jitted_matrix(q))
    np.testing.assert_allclose(jitted_matrix(composed(p, q)), want, atol=1e-15)


def test_compose_keeps_the_norm_at_one_over_1e5_float32_steps() -> None:
    # Without its Newton step the norm drifts here by 1e-3 and more.
    steps = (random_quaternions(1000).T).astype(np.float32)

    def body(q, step):
        q = se3.compose(q, step)
        return q, sum(c * c for c in q)

    @jax.jit
    def run(q, steps):
        return lax.scan(lambda q, _: lax.scan(body, q, steps), q, length=100)

    q, squared = run(tuple(np.float32([1, 0, 0, 0])), tuple(steps))
    assert squared.shape == (100, 1000)
    assert np.linalg.norm(np.float64(q)) == pytest.approx(1, abs=4e-7)
    np.testing.assert_allclose(squared, 1, atol=1e-6)


@pytest.mark.usefixtures("x64")
def test_compose_squares_the_error_of_the_norm() -> None:
    q, p = 1.001 * random_quaternions(20), random_quaternions(20, seed=1)
    norm = np.linalg.norm(composed(q, p), axis=-1)
    assert (np.abs(norm - 1) < 2 * 0.001**2).all()


# Vectors ------------------------------------------------------------------------------------------


def test_unrotate_undoes_rotate_and_both_are_matrix_products(dtype) -> None:
    q, a = random_quaternions(20).astype(dtype), np.float32(3) * directions(20).astype(dtype)
    R = np.asarray(jitted_matrix(q), np.float64)

    @jax.jit
    def turned(q: Array, a: Array) -> tuple[Array, ...]:
        rows, parts = se3.rows(se3.unstack(q)), se3.unstack(a)
        there = se3.rotate(rows, parts)
        return tuple(map(se3.stack, (there, se3.unrotate(rows, parts), se3.unrotate(rows, there))))

    there, back, there_and_back = turned(q, a)
    close = partial(np.testing.assert_allclose, rtol=0, atol=16 * epsilon(dtype))
    close(there, np.einsum("nij,nj->ni", R, a))
    close(back, np.einsum("nji,nj->ni", R, a))
    close(there_and_back, a)


def test_cross_dot_and_norm_equal_numpys() -> None:
    a, b = directions(20).astype(np.float32), directions(20, seed=1).astype(np.float32)

    @jax.jit
    def made(a: Array, b: Array) -> tuple[Array, ...]:
        x, y = se3.unstack(a), se3.unstack(b)
        return se3.stack(se3.cross(x, y)), se3.dot(x, y), se3.norm(x)

    cross, dot, norm = made(a, b)
    np.testing.assert_allclose(cross, np.cross(a, b), atol=2e-7)
    np.testing.assert_allclose(dot, np.sum(a * b, axis=-1), atol=2e-7)
    np.testing.assert_allclose(norm, np.linalg.norm(a, axis=-1), rtol=2e-7)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_norm_has_derivative_zero_at_the_zero_vector(derivative) -> None:
    def length(a: Array) -> Array:
        return se3.norm(se3.unstack(a))

    slope = jax.jit(derivative(length))
    assert slope(np.zeros(3)).tolist() == [0, 0, 0]
    np.testing.assert_allclose(slope(np.array([3.0, 0.0, 4.0])), [0.6, 0, 0.8])


# The attitude error -------------------------------------------------------------------------------


@jax.jit
def distance(p: Array, q: Array) -> Array:
    return se3.attitude_distance(se3.unstack(p), se3.unstack(q))


def test_attitude_distance_is_a_quarter_of_the_trace_whatever_the_signs(dtype) -> None:
    p, q = (random_quaternions(30, seed=i).astype(dtype) for i in (1, 2))
    matrices = [np.asarray(jitted_matrix(a), np.float64) for a in (p, q)]
    want = [reference.attitude_distance(a @ b.T) for a, b in zip(*matrices, strict=True)]
    for sign in (1, -1):
        np.testing.assert_allclose(distance(sign * p, q), want, atol=4 * epsilon(dtype))


def test_attitude_distance_is_one_at_half_a_turn_and_zero_at_none(dtype) -> None:
    half_turns = np.concatenate([np.zeros((5, 1)), directions(5)], axis=-1).astype(dtype)
    identity = np.tile(np.eye(4, dtype=dtype)[0], (5, 1))
    np.testing.assert_allclose(distance(half_turns, identity), 1, atol=4 * epsilon(dtype))
    for sign in (1, -1):
        assert (np.asarray(distance(half_turns, sign * half_turns)) == 0).all()


def test_clipped_distances_are_at_most_one_and_otherwise_the_same(dtype) -> None:
    # q and q turned by half a turn: the formula gives more than 1 for many pairs.
    q = Rotation.random(1000, rng=np.random.default_rng(0))
    p = Rotation.from_rotvec(math.pi * directions(1000)) * q
    found = distance(*(a.as_quat(scalar_first=True).astype(dtype) for a in (p, q)))
    assert found.max() > 1, "nothing to clip"
    np.testing.assert_array_equal(se3.clip_distance(found), np.minimum(found, 1))
    assert np.isnan(se3.clip_distance(dtype(np.nan))), "a filter that diverged"


@pytest.mark.parametrize("angle", [1e-1, 1e-3, 1e-5])
def test_attitude_distance_keeps_its_relative_accuracy_near_zero_in_float32(angle) -> None:
    # sin^2(angle/2). Both quaternions are rounded, which moves their difference, angle/2 long, by
    # up to 2 eps: a relative error of 8 eps / angle. The trace's is eps / distance, 4e4 times that
    # at 1e-5 rad.
    q = random_quaternions(50)
    turns = Rotation.from_rotvec(angle * directions(50, seed=3))
    p = (turns * Rotation.from_quat(q, scalar_first=True)).as_quat(scalar_first=True)
    eps = epsilon(np.float32)
    got = distance(p.astype(np.float32), q.astype(np.float32))
    np.testing.assert_allclose(got, np.sin(angle / 2) ** 2, rtol=8 * eps / angle + 8 * eps)


def test_attitude_distance_from_the_identity_is_exact_to_rounding_in_float32() -> None:
    # The quaternions are not rounded here, so only the formula's own rounding is left.
    half = np.array([[1e-2], [1e-5], [1e-8], [1e-15]])
    q = np.concatenate([np.cos(half), np.sin(half) * directions(4)], axis=-1).astype(np.float32)
    identity = np.tile(np.float32([1, 0, 0, 0]), (4, 1))
    np.testing.assert_allclose(distance(q, identity)[1:], np.sin(half[1:, 0]) ** 2, rtol=1e-6)


def test_rotation_angle_inverts_the_distance(dtype) -> None:
    angle = np.array([0.0, 1e-6, 1e-3, 0.5, 2.0, 3.0]).astype(dtype)
    squared = np.sin(angle.astype(np.float64) / 2) ** 2
    got = jitted_angle(squared.astype(dtype))
    # arcsin at 1 doubles the digits lost: 3 rad is sin = 0.997, a factor of 14.
    np.testing.assert_allclose(got, angle, rtol=16 * epsilon(dtype))


def test_rotation_angle_of_distances_rounded_out_of_range_is_that_of_the_end() -> None:
    got = jitted_angle(np.array([-1e-9, 1.0, 1.0 + 1e-6], np.float32))
    np.testing.assert_allclose(got, [0, math.pi, math.pi], rtol=1e-6)


def test_rotation_angle_is_differentiable_at_zero_distance() -> None:
    assert jnp.isfinite(jax.jit(jax.grad(se3.rotation_angle))(np.float32(0)))


# Euler angles -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_euler_angles_equal_scipys() -> None:
    R = random_rotations(200)
    theirs = Rotation.from_matrix(R).as_euler("ZYX")[:, ::-1]
    np.testing.assert_allclose(jitted_euler(R), theirs, atol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize("away", [0.0, 1e-12, 1e-6, 1e-3])
def test_euler_angles_give_the_rotation_back_at_and_near_gimbal_lock(pitch, away) -> None:
    # Exactly there only yaw -+ roll is defined, which suffices to restore the rotation.
    s, c = math.sin(0.7), math.cos(0.7)
    roll = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    up = np.sign(pitch)
    lock = np.array([[0.0, 0.0, up], [0.0, 1.0, 0.0], [-up, 0.0, 0.0]])  # exact, unlike cos(pi/2)
    R = lock @ turn(np.array([0.0, 1.0, 0.0]), -up * away) @ roll
    got = np.asarray(jitted_euler(R))
    np.testing.assert_allclose(Rotation.from_euler("ZYX", got[::-1]).as_matrix(), R, atol=1e-7)


# Projection and random rotations ------------------------------------------------------------------


def test_project_rotation_takes_the_rotation_out_of_a_stretched_one() -> None:
    # Polar decomposition: the rotation nearest to R S, S symmetric and positive, is R.
    rng = np.random.default_rng(0)
    for R in random_rotations(10):
        stretch = np.eye(3) + 0.1 * (lambda a: a + a.T)(rng.uniform(-1, 1, (3, 3)))
        np.testing.assert_allclose(se3.project_rotation(R @ stretch), R, atol=1e-14)


def test_project_rotation_leaves_rotations_alone() -> None:
    for R in random_rotations(10):
        np.testing.assert_allclose(se3.project_rotation(R), R, atol=1e-15)


def test_no_rotation_is_nearer_to_the_papers_matrix_than_its_projection() -> None:
    assert np.linalg.det(PRINTED) == pytest.approx(0.943, abs=5e-4)
    projected = se3.project_rotation(PRINTED)
    assert np.linalg.det(projected) == pytest.approx(1)
    np.testing.assert_allclose(projected @ projected.T, np.eye(3), atol=1e-15)
    nearest = np.linalg.norm(projected - PRINTED)
    small_turns = [turn(axis, a) for axis in directions(100) for a in (1e-3, 0.1)]
    for other in [*(projected @ small_turns), *random_rotations(100)]:
        assert np.linalg.norm(other - PRINTED) > nearest


@pytest.mark.parametrize(
    "matrix",
    [np.zeros((3, 3)), np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 1.0, -1.0]), -np.eye(3)],
    ids=["zero", "singular", "reflection", "inversion"],
)
def test_project_rotation_refuses_a_matrix_far_from_any_rotation(matrix) -> None:
    with pytest.raises(ValueError, match=r"no rotation.*determinant"):
        se3.project_rotation(matrix)


def drawn(angle: float, dtype: type[np.floating]) -> np.ndarray:
    """Random rotations (3000, 3, 3) by an angle [rad]."""
    return np.asarray(many_drawn(jax.random.split(jax.random.key(1), 3000), dtype(angle)))


many_drawn = jax.jit(jax.vmap(se3.random_rotation, in_axes=(0, None)))


@pytest.mark.parametrize("angle", [0.0, 0.2, 3.0])
def test_random_rotations_have_the_angle_asked_for_in_both_precisions(dtype, angle) -> None:
    R = drawn(angle, dtype)
    assert R.dtype == dtype
    unit = np.tile(np.eye(3), (len(R), 1, 1))
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), unit, atol=1e-6)
    np.testing.assert_allclose(
        Rotation.from_matrix(R).magnitude(), angle, atol=100 * epsilon(dtype)
    )


def test_random_rotations_are_about_uniformly_random_axes() -> None:
    axes = Rotation.from_matrix(drawn(1.0, np.float32).astype(np.float64)).as_rotvec()
    # Standard deviation of the means: sqrt(1/3/3000) = 0.011, and 0.005 for the products.
    np.testing.assert_allclose(axes.mean(axis=0), 0, atol=0.05)
    np.testing.assert_allclose(axes.T @ axes / 3000, np.eye(3) / 3, atol=0.025)


def test_random_rotations_are_the_same_in_both_precisions() -> None:
    single = drawn(1.0, np.float32)
    with jax.enable_x64(True):
        np.testing.assert_allclose(single, drawn(1.0, np.float64), atol=1e-6)
