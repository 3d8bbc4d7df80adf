"""The almost inertial frame, and the low-pass filter in it, against plain loops and SciPy."""

import itertools
import math

import numpy as np
import pytest
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

from posegsa.recordings.inertial_frame import held, low_passed, running_products, strapdown

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


@pytest.mark.parametrize("time_constant", [0.05, 0.5, 3.0])
def test_the_low_pass_is_the_butterworth_filter_of_scipy(time_constant: float) -> None:
    step = 0.01
    values = np.random.default_rng(2).normal(size=(300, 3), loc=[1.0, 2.0, 3.0])
    start = np.array([0.5, -1.0, 4.0])
    b, a = butter(2, math.sqrt(2) / (2 * math.pi * time_constant), fs=1 / step)
    expected, _ = lfilter(b, a, values, axis=0, zi=lfilter_zi(b, a)[:, None] * start)
    found = low_passed(values, time_constant, step, start)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_constant_passes_from_the_first_sample_on() -> None:
    values = np.tile([0.1, -2.0, 9.81], (50, 1))
    np.testing.assert_allclose(low_passed(values, 2.5, 0.005, values[0]), values, rtol=1e-12)


def test_no_time_constant_is_no_filter_and_a_tiny_one_nearly_none() -> None:
    values = np.random.default_rng(3).normal(size=(40, 3))
    np.testing.assert_array_equal(low_passed(values, 0.0, 0.01, values[0]), values)
    assert np.isfinite(low_passed(values, 1e-6, 0.01, values[0])).all()


def test_what_is_not_known_is_held() -> None:
    values = np.array([[1.0], [2.0], [np.nan], [np.nan], [5.0]])
    known = np.isfinite(values[:, 0])
    np.testing.assert_array_equal(held(values, known, np.array([9.0]))[:, 0], [1, 2, 2, 2, 5])
    known[0] = False
    np.testing.assert_array_equal(held(values, known, np.array([9.0]))[:, 0], [9, 2, 2, 2, 5])
