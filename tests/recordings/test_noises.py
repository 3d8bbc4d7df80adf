"""Noises by Allan variances against the truth: what was put in is found."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from posegsa.recordings.noises import allan_variance, neighbours, noise_of, velocity_noises
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick
STEP, COUNT = 0.01, 6000


def flown(
    *, lead: float = 0.0, walk: float = 0.0, truth: tuple[float, float] = (0.0, 0.0)
) -> Recording:
    """A minute's flight: noise 0.005 rad/s and 0.05 m/s, biases, a truth with noise [rad], [m]."""
    rng = np.random.default_rng(7)
    time = STEP * np.arange(-300, COUNT + 1)
    angles = np.stack([0.4 * np.sin(1.9 * time), 0.3 * np.sin(2.3 * time), 0.5 * time], axis=1)
    turn = Rotation.from_euler("xyz", angles)
    P = np.stack([3 * np.sin(0.7 * time), 2 * np.cos(0.9 * time), np.sin(1.1 * time)], axis=1)
    R = turn.as_matrix()
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / STEP
    middle = (turn[:-1] * Rotation.from_rotvec(rate * STEP / 2)).as_matrix()
    moved = np.einsum("kji,kj->ki", middle, np.diff(P, axis=0)) / STEP

    def late(a: np.ndarray) -> np.ndarray:
        before = np.concatenate([a[:1], a[:-1]])
        return ((1 - lead) * a + lead * before)[300:]

    drift = walk * np.sqrt(STEP) * np.cumsum(rng.normal(size=(COUNT, 3)), axis=0)
    R, P, turn = R[300:-1], P[300:-1], turn[300:-1]
    seen = turn * Rotation.from_rotvec(truth[0] * rng.normal(size=(COUNT, 3)))
    return Recording.from_arrays(
        time=STEP * np.arange(COUNT),
        angular_velocity=late(rate) + 0.02 + drift + 0.005 * rng.normal(size=(COUNT, 3)),
        velocity=late(moved) - 0.1 + 0.05 * rng.normal(size=(COUNT, 3)),
        vectors=np.einsum("kji,nj->kni", R, np.eye(3)),
        vector_references=np.eye(3),
        landmarks=np.einsum("kji,nkj->kni", R, np.eye(3)[:, None] * 4 - P),
        landmark_references=4 * np.eye(3),
        truth_quaternion=seen.as_quat(scalar_first=True),
        truth_position=P + truth[1] * rng.normal(size=(COUNT, 3)),
    )


@pytest.mark.parametrize("truth", [(0.0, 0.0), (0.0017, 0.001)], ids=["exact", "as a mocap's"])
def test_densities_and_biases_are_found_whatever_the_truth_s_noise(truth) -> None:
    found = velocity_noises(flown(truth=truth))
    assert found["angular_velocity"].density == pytest.approx(0.0005, rel=0.25)
    assert found["velocity"].density == pytest.approx(0.005, rel=0.25)
    np.testing.assert_allclose(found["angular_velocity"].bias, 0.02, atol=5e-4)
    np.testing.assert_allclose(found["velocity"].bias, -0.1, atol=5e-3)
    assert found["angular_velocity"].walk == found["velocity"].walk == 0.0


def test_a_walk_is_found_and_none_where_there_is_none() -> None:
    assert velocity_noises(flown(walk=2e-3))["angular_velocity"].walk == pytest.approx(
        2e-3, rel=0.6
    )


@pytest.mark.parametrize("lead", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("truth", [(0.0, 0.0), (0.0017, 0.001)], ids=["exact", "as a mocap's"])
def test_a_lead_is_found_as_a_multiple_of_half_a_step(lead, truth) -> None:
    found = velocity_noises(flown(lead=lead, truth=truth))
    assert [each.lead for each in found.values()] == pytest.approx([lead, lead], abs=0.1)


def test_the_allan_variance_of_white_noise_falls_with_tau() -> None:
    """A(tau) = q^2 / tau (IEEE Std 952)."""
    rate = 0.3 * np.random.default_rng(0).normal(size=(20000, 3))
    tau, variance = allan_variance(np.cumsum(rate, axis=0) * STEP, STEP)
    np.testing.assert_allclose((variance * tau)[:9], 0.3**2 * STEP, rtol=0.15)
    np.testing.assert_allclose(tau[:3], [STEP, 2 * STEP, 4 * STEP])


def test_correlated_noise_counts_for_more_than_its_deviation() -> None:
    rng = np.random.default_rng(1)
    white = 0.1 * rng.normal(size=(6000, 3))
    assert noise_of(white, STEP) == pytest.approx(0.1, rel=0.15)
    keep = np.exp(-STEP / 0.5)
    lasting = lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0)
    assert np.std(lasting) == pytest.approx(0.1, rel=0.1)
    assert 0.4 < noise_of(lasting, STEP) < 1.2, "at most sqrt(2 tau / dt) = 10 times as much"
    assert neighbours(lasting) < 0.02, "which neighbouring samples do not show"


def test_outliers_hardly_count() -> None:
    errors = 0.1 * np.random.default_rng(2).normal(size=(3000, 3))
    errors[::200] += 5.0
    assert noise_of(errors, 0.1) < 0.25
