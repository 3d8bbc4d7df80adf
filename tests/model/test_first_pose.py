"""The start from the sensors, beside scipy's solution of Wahba's problem."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from posegsa.model.first_pose import LIKE_A_DIRECTION, first_pose, shown
from posegsa.model.measurements import Measurements
from posegsa.model.sample import prepare
from posegsa.model.se3 import stack
from posegsa.model.vectors import AS_MEASURED

Array = NDArray[np.float64]


def measured(
    seed: int, vectors: int, landmarks: int, noise: float, samples: int = 1, bits: int = 64
) -> tuple[Measurements, Array, Array]:
    """Noisy measurements of one pose, with its rotation and position."""
    rng = np.random.default_rng(seed)
    R, P = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    v, p = rng.normal(size=(vectors, 3)), 3 * rng.normal(size=(landmarks, 3))

    def seen(exact: Array) -> Array:
        return exact + noise * rng.normal(size=(samples, *exact.shape))

    still = np.zeros((samples, 3))
    m = Measurements.from_arrays(
        time_step=0.01,
        angular_velocity=still,
        velocity=still,
        vectors=seen(v @ R),
        vector_references=v,
        landmarks=seen((p - P) @ R),
        landmark_references=p,
        dtype=np.dtype(f"float{bits}"),
    )
    return m, R, P


def exact_of(v: Array, p: Array, R: Array, P: Array, bits: int) -> Measurements:
    """What sensors without noise measure at one pose."""
    return Measurements.from_arrays(
        time_step=0.01,
        angular_velocity=np.zeros((1, 3)),
        velocity=np.zeros((1, 3)),
        vectors=(v @ R)[None],
        vector_references=v,
        landmarks=((p - P) @ R)[None],
        landmark_references=p,
        dtype=np.dtype(f"float{bits}"),
    )


def unit(a: Array) -> Array:
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def reference(m: Measurements) -> tuple[Array, Array]:
    """Rotation and position of the first sample by scipy, landmarks in units of 2 m."""
    y, p = np.asarray(m.landmarks)[0], np.asarray(m.landmark_references)[0]
    seen, known = unit(np.asarray(m.vectors)[0]), unit(np.asarray(m.vector_references)[0])
    seen = np.concatenate([seen, (y - y.mean(axis=0)) / LIKE_A_DIRECTION])
    known = np.concatenate([known, (p - p.mean(axis=0)) / LIKE_A_DIRECTION])
    R = Rotation.align_vectors(known, seen)[0].as_matrix()
    return R, p.mean(axis=0) - R @ y.mean(axis=0)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("vectors", "landmarks"), [(2, 1), (3, 1), (0, 3), (1, 2), (2, 4)])
@given(seed=st.integers(0, 10_000))
def test_it_solves_wahbas_problem(vectors: int, landmarks: int, seed: int) -> None:
    m, _, _ = measured(seed, vectors, landmarks, noise=0.1)
    found = first_pose(m)
    R, P = reference(m)
    np.testing.assert_allclose(found.rotation, R, atol=1e-7)  # scipy's own accuracy near ties
    np.testing.assert_allclose(found.position, P, atol=1e-6)


@given(seed=st.integers(0, 10_000))
def test_exact_measurements_show_the_pose_in_single_precision(seed: int) -> None:
    m, R, P = measured(seed, 3, 2, noise=0.0, bits=32)
    found = first_pose(m)
    np.testing.assert_allclose(found.rotation, R, atol=2e-4)
    np.testing.assert_allclose(found.position, P, atol=2e-3)


def test_half_a_turn_is_nothing_special() -> None:
    """Where w of the quaternion is 0."""
    v = np.eye(3)
    for axis in v:
        R = Rotation.from_rotvec(np.pi * axis).as_matrix()
        m = exact_of(v, v[:1], R, np.zeros(3), 32)
        np.testing.assert_allclose(first_pose(m).rotation, R, atol=1e-6)


@pytest.mark.usefixtures("x64")
def test_the_first_sample_that_fixes_a_pose_is_taken() -> None:
    """Neither one vector nor two without a landmark fix one."""
    m, R, P = measured(3, 2, 1, noise=0.0, samples=4)
    one_vector = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    no_landmark = np.array([[1.0], [0.0], [1.0], [1.0]])
    m = m._replace(
        vector_weights=jnp.asarray(one_vector), landmark_weights=jnp.asarray(no_landmark)
    )
    found = first_pose(m)
    assert found.sample == 2
    np.testing.assert_allclose(found.rotation, R, atol=1e-9)
    np.testing.assert_allclose(found.position, P, atol=1e-9)
    nothing = m._replace(landmark_weights=jnp.zeros_like(m.landmark_weights))
    assert first_pose(nothing).sample == 4


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("which", ["both", "known", "seen"])
def test_parallel_vectors_fix_no_attitude(which: str) -> None:
    """Whether they are parallel as known, or a sensor that is stuck measures them so."""
    m, _, _ = measured(5, 2, 1, noise=0.0)
    if which != "seen":
        m = m._replace(vector_references=jnp.repeat(m.vector_references[:, :1], 2, axis=1))
    if which != "known":
        m = m._replace(vectors=jnp.repeat(m.vectors[:, :1], 2, axis=1))
    assert first_pose(m).sample == 1  # none


@pytest.mark.parametrize("bits", [32, 64])
@pytest.mark.parametrize(
    "places",
    [
        np.repeat([[0.1, 0.7, 0.3]], 3, axis=0),
        [0.1, 0.7, 0.3] + np.arange(-1, 2)[:, None] * [1, 2, 3] / 7,
        [[0.6, 1.2, 0.3], [1.6, 1.2, 0.3], [-0.4, 1.2, 0.3], [0.6, 2.2, 0.3], [0.6, 0.2, 0.3]],
    ],
    ids=["at one place", "on a line", "one in the middle"],
)
def test_a_landmark_at_the_centre_shows_no_direction(bits: int, places: Any) -> None:
    """Only rounding is left of it, which two good vectors outweigh."""
    R = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    with jax.enable_x64(bits == 64):
        m = exact_of(np.eye(3)[1:], np.asarray(places), R, np.array([1.0, -2.0, 0.5]), bits)
        found = first_pose(m)
        np.testing.assert_allclose(found.rotation, R, atol=3e-6 if bits == 32 else 1e-12)
        alone = first_pose(m._replace(vector_weights=jnp.zeros_like(m.vector_weights)))
    assert int(alone.sample) == (0 if len(places) > 3 else 1)  # a plane shows an attitude


@pytest.mark.usefixtures("x64")
def test_without_landmarks_two_directions_fix_the_attitude() -> None:
    m, R, _ = measured(7, 2, 0, noise=0.0)
    sample = jax.tree.map(lambda a: a[0], prepare(m, AS_MEASURED))
    found = shown(sample.vectors.each, sample.landmarks)
    assert found.fixed
    w, x, y, z = found.attitude
    attitude = Rotation.from_quat(np.array([x, y, z, w])).as_matrix()
    np.testing.assert_allclose(attitude, R, atol=1e-9)
    np.testing.assert_array_equal(stack(found.place), np.zeros(3))


@pytest.mark.usefixtures("x64")
def test_a_missing_sensor_may_hold_nan() -> None:
    m, R, _ = measured(9, 3, 2, noise=0.0)
    m = m._replace(
        vectors=m.vectors.at[0, 1].set(jnp.nan),
        vector_weights=m.vector_weights.at[0, 1].set(0.0),
    )
    np.testing.assert_allclose(first_pose(m).rotation, R, atol=1e-9)


@pytest.mark.usefixtures("x64")
def test_vmap_equals_a_loop() -> None:
    every = [measured(seed, 2, 2, noise=0.05)[0] for seed in range(5)]
    together = jax.vmap(first_pose)(jax.tree.map(lambda *a: jnp.stack(a), *every))
    for i, m in enumerate(every):
        one = jax.jit(first_pose)(m)
        np.testing.assert_allclose(together.rotation[i], one.rotation, atol=1e-13)
        np.testing.assert_allclose(together.position[i], one.position, atol=1e-12)
