"""The exponential and rigid motions, against SciPy, jaxlie and exact series."""

import math
from fractions import Fraction
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from helpers import reference
from helpers.arrays import epsilon
from helpers.measurements import directions
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from jax import Array

from posegsa.model import se3

THRESHOLD = math.sqrt(se3.SERIES_BELOW)
"""Angle [rad] at which the closed form replaces the series."""

# From 0 through the threshold, half and whole turns to many turns.
ANGLES = np.array(
    [0.0, 1e-30, 1e-12, 1e-8, 1e-4, 0.01, 0.1, 0.5]
    + [THRESHOLD * (1 + d) for d in (-1e-3, -2e-7, -1e-16, 0.0, 2e-16, 2e-7, 1e-3)]
    + [1.3, 2.0, 3.14, math.pi, 3.15, 5.0, 2 * math.pi, 10.0, 31.0, 100.0]
)

jitted_exp = jax.jit(se3.exp)


def twists(angles: np.ndarray, dtype: type[np.floating], draws: int = 2) -> np.ndarray:
    """Tangent vectors (draws * len(angles), 6): each angle about random axes, metres of motion."""
    angles = np.tile(angles, draws)
    omega = angles[:, None] * directions(len(angles))
    v = np.random.default_rng(1).normal(size=omega.shape) * 3
    return np.concatenate([omega, v], axis=-1).astype(dtype)


def tolerance(xi: np.ndarray, dtype: type[np.floating]) -> np.ndarray:
    """Absolute error allowed in exp(xi) and its derivatives, one number for each xi.

    16 units of rounding at metres of motion, plus the rounding of the angle, eps * angle, which no
    evaluation in this precision can avoid. SciPy's expm squares repeatedly and needs more at many
    turns in float64.
    """
    angle = np.linalg.norm(xi[:, :3].astype(np.float64), axis=-1)
    return epsilon(dtype) * np.where(angle < 20, 16 * (1 + angle), 64 * (1 + angle))


def assert_each_close(got: Array, want: np.ndarray, allowed: np.ndarray) -> None:
    error = np.abs(np.asarray(got, np.float64) - want).reshape(len(want), -1).max(axis=-1)
    worst = np.argmax(error / allowed)
    assert np.isfinite(error).all()
    assert (error <= allowed).all(), f"item {worst}: {error[worst]:.3g} > {allowed[worst]:.3g}"


# The exponential: values and derivatives ----------------------------------------------------------


def test_exp_equals_scipys_expm_from_no_angle_to_many_turns(dtype) -> None:
    xi = twists(ANGLES, dtype)
    want = np.array([scipy.linalg.expm(reference.wedge(x)) for x in xi.astype(np.float64)])
    got = jitted_exp(xi)
    assert got.dtype == dtype
    assert_each_close(got, want, tolerance(xi, dtype))


@pytest.mark.usefixtures("x64")
def test_derivatives_of_exp_equal_expms_frechet_derivative() -> None:
    dtype = np.float64
    xi = twists(ANGLES, dtype, draws=1)
    frechet = partial(scipy.linalg.expm_frechet, compute_expm=False)
    generators = [reference.wedge(e) for e in np.eye(6)]
    want = np.array(
        [[frechet(reference.wedge(x), E) for E in generators] for x in xi.astype(np.float64)]
    )
    for derivative in (jax.jacfwd, jax.jacrev):
        got = jax.jit(jax.vmap(derivative(se3.exp)))(xi)
        assert_each_close(got, want.transpose(0, 2, 3, 1), tolerance(xi, dtype))


@pytest.mark.usefixtures("x64")
def test_second_derivatives_of_exp_at_no_angle_are_those_of_the_series() -> None:
    # exp(A) = I + A + A^2/2 + ..., so that the second derivative at 0 along a and b is (AB + BA)/2.
    a, b = np.random.default_rng(0).normal(size=(2, 6))

    def along(t: Array, u: Array) -> Array:
        return se3.exp(t * a + u * b)

    got = jax.jit(jax.jacfwd(jax.jacfwd(along, argnums=0), argnums=1))(0.0, 0.0)
    A, B = reference.wedge(a), reference.wedge(b)
    np.testing.assert_allclose(got, (A @ B + B @ A) / 2, atol=8 * epsilon(np.float64))


def test_exp_without_rotation_is_a_translation_exactly(dtype) -> None:
    got = jitted_exp(jnp.array([0, 0, 0, 1, -2, 3], dtype))
    want = np.eye(4)
    want[:3, 3] = 1, -2, 3
    assert (np.asarray(got) == want).all()


def test_exp_keeps_any_batch_shape() -> None:
    xi = twists(np.array([0.0, 0.3, 2.0]), np.float32, draws=2)
    exp = jitted_exp
    assert exp(xi[0]).shape == (4, 4)
    assert exp(xi.reshape(3, 2, 6)).shape == (3, 2, 4, 4)
    np.testing.assert_allclose(exp(xi.reshape(3, 2, 6)).reshape(6, 4, 4), exp(xi), atol=2e-6)
    np.testing.assert_allclose(exp(xi)[0], exp(xi[0]), atol=2e-6)


# Its coefficients ---------------------------------------------------------------------------------


@lru_cache
def exact_coefficients(t2: float) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and their derivatives by t^2, by exact rational sums of their series."""
    square, terms = Fraction(t2), 20 + 3 * math.ceil(math.sqrt(t2))

    def sums(first: int, ratio: Fraction, factor: Fraction) -> tuple[float, float]:
        """factor * sum_n (-ratio t^2)^n / (2n + first)! and its derivative."""
        x, power, value, slope = -ratio * square, Fraction(1), Fraction(0), Fraction(0)
        for n in range(terms):
            value += power / math.factorial(2 * n + first)
            slope += -ratio * (n + 1) * power / math.factorial(2 * (n + 1) + first)
            power *= x
        return float(factor * value), float(factor * slope)

    quarter, half, one = Fraction(1, 4), Fraction(1, 2), Fraction(1)
    # cos(t/2), sin(t/2)/t, (1 - cos t)/t^2, (t - sin t)/t^3.
    rows = (sums(0, quarter, one), sums(1, quarter, half), sums(2, one, one), sums(3, one, one))
    values, slopes = zip(*rows, strict=True)
    return np.array(values), np.array(slopes)


def squares(dtype: type[np.floating]) -> np.ndarray:
    """Squared angles [rad^2], with the floating numbers on both sides of the threshold."""
    at = dtype(se3.SERIES_BELOW)
    near = [np.nextafter(at, dtype(0)), at, np.nextafter(at, dtype(2))]
    below = at * np.array([0.0, 1e-30, 1e-16, 1e-8, 1e-4, 0.01, 0.1, 0.3, 0.6, 0.9, 0.99])
    return np.concatenate([below, near, [1.01, 1.2, 1.6, 2.1, 3.0, 4.0]]).astype(dtype)


def test_coefficients_below_two_radians_are_right_to_a_few_roundings(dtype) -> None:
    # Relative error: about one rounding of the series, and a few of the closed form, whose last
    # coefficient loses a factor of 6 at 1 rad.
    t2 = squares(dtype)
    want = np.array([exact_coefficients(float(x))[0] for x in t2])
    got = np.stack(jax.jit(se3.exp_coefficients)(t2), axis=-1)
    assert got.dtype == dtype
    error = np.abs(got.astype(np.float64) - want) / want
    below = t2 < se3.SERIES_BELOW
    assert error[below].max() < epsilon(dtype)
    assert error[~below].max() < 5 * epsilon(dtype)


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_derivatives_of_coefficients_are_right_on_both_sides_of_the_threshold(dtype, mode) -> None:
    # By t^2. The chain rule through the closed forms subtracts numbers of size 1/t^2 to leave
    # 1/120 for the last coefficient, hence absolute errors of some units of rounding.
    t2 = squares(dtype)
    want = np.array([exact_coefficients(float(x))[1] for x in t2])
    derivative = jax.jacfwd if mode == "forward" else jax.jacrev

    def coefficients(x: Array) -> Array:
        return jnp.stack(se3.exp_coefficients(x))

    got = jax.jit(jax.vmap(derivative(coefficients)))(t2)
    np.testing.assert_allclose(got, want, rtol=0, atol=2 * epsilon(dtype))


def test_coefficients_at_many_turns_are_as_good_as_their_angle(dtype) -> None:
    # The angle's rounding, eps * t, turns sine and cosine by as much; so it is an absolute error of
    # that size in cos(t/2), and over t, t^2 and t^3 in the others.
    t = np.array([2.5, math.pi, 4.0, 2 * math.pi, 9.0, 40.0, 100.0])
    t = np.resize(t, len(squares(dtype)))
    t2 = (t * t).astype(dtype)
    want = np.array([exact_coefficients(float(x))[0] for x in t2])
    got = np.stack(jax.jit(se3.exp_coefficients)(t2), axis=-1).astype(np.float64)
    allowed = 2 * epsilon(dtype) * t[:, None] * np.stack([t**0, 1 / t, 2 / t**2, 1 / t**2], axis=-1)
    assert (np.abs(got - want) <= allowed).all()


# Group axioms -------------------------------------------------------------------------------------

tangent_vectors = hnp.arrays(np.float64, 6, elements=st.floats(-10, 10))


def moved(*xis: np.ndarray) -> np.ndarray:
    """exp(xi_1) exp(xi_2) ... by `move`, as a matrix; one program for up to three."""
    nothing = (np.zeros(6),) * (3 - len(xis))
    return np.asarray(all_moved(*xis, *nothing))


@jax.jit
def all_moved(*xis: Array) -> Array:
    one, zero = jnp.ones(()), jnp.zeros(())
    q, P = (one, zero, zero, zero), (zero, zero, zero)
    for xi in xis:
        omega, v = se3.unstack(xi[:3]), se3.unstack(xi[3:])
        q, P = se3.move(q, P, omega, v)
    return se3.transform(se3.rotation_matrix(se3.stack(q)), se3.stack(P))


# Twists of 10 rad/m, three in a row, reach some tens of metres: 1e-12 is some tens of roundings.
group = partial(np.testing.assert_allclose, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("x64")
@given(tangent_vectors)
def test_exp_of_minus_xi_is_the_inverse(xi) -> None:
    T = moved(xi)
    group(T @ moved(-xi), np.eye(4))
    group(moved(xi, -xi), np.eye(4))
    group(moved(-xi), np.linalg.inv(T))


@pytest.mark.usefixtures("x64")
@given(tangent_vectors, tangent_vectors, tangent_vectors)
def test_moves_compose_as_matrices_do_and_associate(a, b, c) -> None:
    group(moved(a, b), moved(a) @ moved(b))
    group(moved(a, b, c), moved(a) @ (moved(b) @ moved(c)))


@pytest.mark.usefixtures("x64")
@given(tangent_vectors, st.floats(0, 1))
def test_motions_along_one_twist_add_up(xi, share) -> None:
    group(moved(share * xi, (1 - share) * xi), moved(xi))


@pytest.mark.usefixtures("x64")
@given(tangent_vectors)
def test_exp_is_a_rigid_motion(xi) -> None:
    T = moved(xi)
    group(T[:3, :3] @ T[:3, :3].T, np.eye(3))
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert T[3].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_velocity_to_a_displacement_is_scipys(dtype) -> None:
    with jax.enable_x64(dtype is np.float64):
        angles = ANGLES[ANGLES <= 3.15]
        xi = twists(np.concatenate([angles, [0.0999, 0.1001]]), dtype)
        omega, displacement = (
            se3.unstack(jnp.asarray(xi[:, :3])),
            se3.unstack(jnp.asarray(xi[:, 3:])),
        )
        v = se3.stack(jax.jit(se3.velocity_to)(omega, displacement))
        matrices = np.zeros((len(xi), 4, 4))
        x, y, z = xi[:, :3].T.astype(np.float64)
        matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
        matrices[:, :3, :3] -= np.swapaxes(matrices[:, :3, :3], -1, -2)
        matrices[:, :3, 3] = v
        moved = scipy.linalg.expm(matrices)[:, :3, 3]
        # The closed form cancels most just above its threshold, at t^2 = 0.01.
        allowed = 200 * epsilon(dtype) * np.ones(len(xi))
        assert_each_close(moved, xi[:, 3:].astype(np.float64), allowed)
