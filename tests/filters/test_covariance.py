"""The covariance by components: what a reset leaves as it is."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.measurements import random_poses
from helpers.reference import se3_exp
from helpers.reference_ekf import adjoint

from posegsa.filters.covariance import Covariance, matrix, transported

pytestmark = [pytest.mark.quick, pytest.mark.usefixtures("x64")]


def by_components(sigma: np.ndarray) -> Covariance:
    """Upper triangle, by rows."""
    return tuple(tuple(jnp.asarray(x) for x in row[i:]) for i, row in enumerate(sigma))


@pytest.mark.parametrize("angle", [1e-3, 1.0, 3.0])
def test_a_reset_in_two_frames_is_none_of_the_right_error(angle) -> None:
    """The right error of pose and biases, seen in the inertial frame, keeps its covariance.

    It does so however large the correction; that of the position is limited, and small here.
    """
    rng = np.random.default_rng(0)
    root = rng.normal(size=(18, 18))
    sigma = root @ root.T
    x = np.concatenate([angle * np.array([0.6, 0.0, -0.8]), 1e-5 * rng.normal(size=3)])
    before = random_poses(rng, 1)[0]
    after = before @ se3_exp(x)
    zero = (jnp.zeros(()),) * 3
    correction = tuple(jnp.asarray(a) for a in [*x, *np.zeros(12)])
    reset = transported(by_components(sigma), correction, zero, zero, jnp.zeros(()), "two frames")
    np.testing.assert_allclose(
        right(after) @ np.asarray(matrix(reset, 18)) @ right(after).T,
        right(before) @ sigma @ right(before).T,
        rtol=1e-9,
        atol=1e-9,
    )


def right(T: np.ndarray) -> np.ndarray:
    """From the left errors of pose and biases to the right ones (18, 18)."""
    both = np.kron(np.eye(6), T[:3, :3])
    both[:6, :6] = adjoint(T)
    return both
