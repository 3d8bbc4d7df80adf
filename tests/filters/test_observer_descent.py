"""Theory of the observer: its steps decrease its cost, up to a maximum step length."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import as_arrays
from helpers.filters import (
    fitting,
    innovated,
    jitted_innovation,
    jitted_prepare,
    observed,
    prepared,
    random_samples,
    settings,
    state_of,
)
from helpers.measurements import random_poses
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from jax import Array

from posegsa.filters.observer import correction
from posegsa.model import se3
from posegsa.model.estimate import initial_state
from posegsa.model.measurements import Measurements


def cost(T: Array, m: Measurements) -> Array:
    """f of the docstring of `innovation`, for T (4, 4) and one sample."""
    x = m.landmarks @ T[:3, :3].T + T[:3, 3][None]
    landmarks = jnp.sum(m.landmark_weights * jnp.sum((x - m.landmark_references) ** 2, axis=-1))
    turned = m.vectors @ T[:3, :3].T
    vectors = jnp.sum(m.vector_weights * jnp.sum((turned - m.vector_references) ** 2, axis=-1))
    return 0.25 * (landmarks + vectors)


GENERATORS = np.stack([reference.wedge(e) for e in np.eye(6)])
"""(6, 4, 4): [xi]^ is their sum weighted by xi."""


@jax.jit
@jax.vmap
def derivatives(T: Array, m: Measurements) -> tuple[Array, Array]:
    """Gradient and Hessian of f by the spatial displacement xi, f(exp(xi) T), at xi = 0.

    Both need the series of the exponential only up to second order.
    """

    def around(xi: Array) -> Array:
        A = jnp.tensordot(xi, jnp.asarray(GENERATORS), 1)
        return cost((jnp.eye(4) + A + A @ A / 2) @ T, m)

    return jax.grad(around)(jnp.zeros(6)), jax.hessian(around)(jnp.zeros(6))


def joined(U: Any) -> np.ndarray:
    """[angular; linear] (..., 6)."""
    return np.stack(U.angular + U.linear, axis=-1)


@pytest.mark.usefixtures("x64")
def test_the_innovation_is_minus_the_gradient_of_its_cost() -> None:
    m, T, state = random_samples(200)
    gradient, _ = derivatives(T, m)
    U = jitted_innovation(state, jitted_prepare(m))
    np.testing.assert_allclose(joined(U), -gradient, atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_the_curvature_bounds_every_second_derivative_of_the_cost() -> None:
    m, T, state = random_samples(200)
    largest = np.linalg.eigvalsh(derivatives(T, m)[1])[:, -1]
    bound = np.asarray(jitted_innovation(state, jitted_prepare(m)).curvature)
    assert (largest <= bound * (1 + 1e-12)).all()
    assert (largest > 0.2 * bound).any()  # a bound, not just a large number


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", ["vector", "landmark"])
def test_the_curvature_is_exact_for_one_vector_or_one_landmark_that_fits(kind) -> None:
    # So no smaller bound exists. Only one of the 3 vectors and 2 landmarks has a weight.
    m, T, state = random_samples(200)
    poses, known = np.asarray(T), jax.tree.map(np.asarray, m)
    fits = [
        fitting(poses[k], known.vector_references[k], known.landmark_references[k])
        for k in range(200)
    ]
    only = np.tile([1.0, 0.0, 0.0], (200, 1))
    m = jax.tree.map(lambda *a: np.stack(a), *fits)._replace(
        vector_weights=only * (kind == "vector"),
        landmark_weights=only[:, :2] * (kind == "landmark"),
    )
    largest = np.linalg.eigvalsh(derivatives(T, as_arrays(m, float))[1])[:, -1]
    bound = jitted_innovation(state, jitted_prepare(m)).curvature
    np.testing.assert_allclose(largest, bound, rtol=1e-12)


triples = partial(hnp.arrays, np.float64, elements=st.floats(-5, 5))


@jax.jit
def stepped(T: Array, m: Measurements, step_length: Array) -> tuple[Array, Array, Array]:
    """f before and after a step by the innovation alone with K h L = step_length; and K h L."""
    still = m._replace(angular_velocity=jnp.zeros(3), velocity=jnp.zeros(3))
    state = initial_state(T[:3, :3], T[:3, 3])
    chosen = replace(settings(), gain_limit=step_length)
    L = innovated(state, prepared(still)).curvature
    after, used = observed(state, prepared(still), jnp.asarray(1e6), chosen)
    T_after = se3.transform(after.rotation, after.position)
    return cost(T, m), cost(T_after, m), used * m.time_step * L


@pytest.mark.usefixtures("x64")
@given(
    body=triples((4, 3)),
    known=triples((4, 3)),
    weights=hnp.arrays(np.float64, 4, elements=st.sampled_from([0.0, 0.1, 1.0, 10.0])),
    omega=triples(3),
    place=triples(3),
    fits=st.booleans(),
    step_length=st.sampled_from([0.1, 0.5, 1.0, 1.5, 1.99]),
)
def test_no_step_within_the_limit_makes_the_cost_larger(
    body, known, weights, omega, place, fits, step_length
) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = reference.se3_exp(np.append(omega, np.zeros(3)))[:3, :3], place
    if fits:  # measurements of a pose, here the identity; otherwise they fit no pose
        body = known
    zero = np.zeros(3)
    raw = Measurements(
        *(np.array(0.01), zero, zero),
        *(body[:2], known[:2], weights[:2]),
        *(body[2:], known[2:], weights[2:]),
    )
    before, after, length = stepped(jnp.asarray(T), as_arrays(raw, float), step_length)
    # K = 1e6 stands for any gain above the limit; it is above unless all measurements are tiny.
    assert length <= step_length * (1 + 1e-12)
    # Rounding of a cost of coordinates up to 10 m.
    assert after <= before + 1e-12 * (1 + float(before))


@pytest.mark.usefixtures("x64")
def test_a_step_beyond_the_limit_makes_the_cost_larger() -> None:
    # Near the pose that one vector fits, the cost is its curvature times angle^2 / 2.
    T = np.eye(4)
    T[:3, :3] = reference.se3_exp(np.array([1e-3, 0, 0, 0, 0, 0]))[:3, :3]
    vectors, landmarks = np.array([[0.0, 0.0, 1.0], [0, 1, 0]]), np.zeros((2, 3))
    m = fitting(np.eye(4), vectors, landmarks)
    m = m._replace(vector_weights=np.array([1.0, 0.0]), landmark_weights=np.zeros(2))
    m = as_arrays(m, float)
    before, after, _ = stepped(jnp.asarray(T), m, jnp.asarray(1.9))
    assert after < before
    before, after, _ = stepped(jnp.asarray(T), m, jnp.asarray(2.1))
    assert after > before


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("law", "holds"), [("gradient", True), ("printed", False)])
def test_the_lyapunov_function_falls_by_the_innovation_alone_under_the_gradient_law(
    law, holds
) -> None:
    # V = f + |b_1 - b_1_est|^2 / (2 gamma_1) + |b_2 - b_2_est|^2 / (2 gamma_2). With measurements
    # that fit the truth, T_est T^-1 has the spatial velocity Ad(T_est) (b - b_est + K W), so that
    # dV/dt = -U . Ad(T_est) (b - b_est + K W) - (b - b_est) . db_est/dt / gamma, to be -K |U|^2.
    rng, K = np.random.default_rng(0), 2.5
    truth, T = random_poses(rng, 2)
    vectors, landmarks = rng.normal(size=(2, 2, 3))
    m = as_arrays(fitting(truth, vectors, landmarks), float)
    state = state_of(T)
    U = jitted_innovation(state, jitted_prepare(m))
    W = jax.jit(correction, static_argnames="law")(state, U, law=law)
    bias_error, Ad, u = rng.normal(size=6), reference.adjoint(T), joined(U)
    # The bias law is -gamma times this, so gamma cancels in dV/dt.
    bias_rate = -np.stack(W.bias_angular + W.bias_linear, axis=-1)
    rate = -u @ Ad @ (bias_error + K * joined(W)) - bias_error @ bias_rate
    assert (rate == pytest.approx(-K * u @ u)) == holds
