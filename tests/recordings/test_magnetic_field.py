"""Weights of the magnetic field, against a plain loop."""

import math

import numpy as np
import pytest

from posegsa.recordings.magnetic_field import SMOOTHING, field_parts, field_weights, mean_so_far

pytestmark = pytest.mark.quick

STEP = 0.01


def looped(
    parts: np.ndarray, reference: np.ndarray, tolerance: float, recovery: float
) -> np.ndarray:
    """The weights, sample by sample."""
    smooth, worst, found = np.zeros(2), 0.0, []
    last = np.zeros(2)
    for k, now in enumerate(parts):
        expected = reference if reference.ndim == 1 else reference[k]
        if np.isfinite(now).all():
            last = (now - expected) / np.linalg.norm(expected)
        smooth = smooth + STEP / (SMOOTHING + STEP) * (last - smooth)
        worst = worst * math.exp(-STEP / recovery) if recovery else 0.0
        worst = max(worst, float(np.linalg.norm(smooth)))
        found.append(1 / (1 + (worst / tolerance) ** 2))
    return np.array(found)


@pytest.mark.parametrize("recovery", [0.0, 0.5, 30.0])
@pytest.mark.parametrize("constant", [True, False])
def test_weights_are_those_of_a_loop(recovery: float, constant: bool) -> None:
    rng = np.random.default_rng(4)
    parts = np.array([16.0, -41.0]) + rng.normal(size=(400, 2)) * 0.3
    parts[100:150] += [5.0, 8.0]
    parts[200:210] = np.nan
    reference = np.array([16.0, -41.0])
    if not constant:
        reference = reference + rng.normal(size=(400, 2)) * 0.1
    found = field_weights(parts, reference, STEP, tolerance=0.05, recovery=recovery)
    np.testing.assert_allclose(found, looped(parts, reference, 0.05, recovery), rtol=1e-9)


def test_a_disturbance_costs_weight_and_its_end_gives_it_back() -> None:
    parts = np.tile([16.0, -41.0], (1000, 1))
    parts[300:400] *= 1.5
    now = field_weights(parts, parts[0], STEP, tolerance=0.02, recovery=0.0)
    later = field_weights(parts, parts[0], STEP, tolerance=0.02, recovery=2.0)
    np.testing.assert_array_equal(now[:300], 1.0)
    assert now[399] < 0.01
    assert now[999] > 0.99
    assert (later <= now * (1 + 1e-9)).all()
    assert later[500] < 0.1 < 0.9 < now[500]


def test_parts_are_horizontal_and_vertical_whatever_the_length_of_up() -> None:
    up = np.array([[0.0, 0.0, 9.81], [0.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    field = np.array([[3.0, 4.0, -7.0], [3.0, 5.0, -4.0], [1.0, 1.0, 1.0]])
    found = field_parts(field, up)
    np.testing.assert_allclose(found[:2], [[5.0, -7.0], [5.0, 5.0]])
    assert np.isnan(found[2]).all()


def test_the_mean_so_far_passes_over_what_is_missing() -> None:
    rng = np.random.default_rng(5)
    parts = rng.normal(size=(60, 2))
    parts[[0, 7, 20]] = np.nan
    expected = [np.nanmean(parts[: max(k, 10)], axis=0) for k in range(1, 61)]
    np.testing.assert_allclose(mean_so_far(parts, 10), expected, rtol=1e-12)
