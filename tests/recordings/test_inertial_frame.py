"""The frame of the integrated gyroscope, against plain loops."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posegsa.recordings.inertial_frame import running_products, strapdown

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("count", [1, 2, 3, 10, 100, 1003])
def test_products_are_those_of_a_loop(count: int) -> None:
    steps = Rotation.random(count, rng=np.random.default_rng(count))
    expected = list(itertools.accumulate(steps, lambda p, q: p * q))
    q = running_products(steps.as_quat(scalar_first=True))
    assert q.shape == (count, 4)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, rtol=1e-14)
    found = Rotation.from_quat(q, scalar_first=True)
    distance = (found * Rotation.concatenate(expected).inv()).magnitude()
    np.testing.assert_allclose(distance, 0, atol=1e-11)


def test_the_integrated_gyroscope_is_the_rotation() -> None:
    rng = np.random.default_rng(1)
    steps = rng.uniform(0.005, 0.02, 500)
    omega = rng.normal(size=(500, 3))
    omega[3] = 0.0
    expected = [np.eye(3)]
    for w, dt in zip(omega[:-1], steps[:-1], strict=True):
        expected.append(expected[-1] @ Rotation.from_rotvec(w * dt).as_matrix())
    np.testing.assert_allclose(strapdown(omega, steps), expected, atol=1e-12)
