"""NEES and NIS of drawn scenarios: against the matrix form, and against chi-squared."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from helpers import reference_ekf
from helpers.filters import state_of
from helpers.reference import Sample, se3_exp
from scipy.spatial.transform import Rotation

from posegsa import config
from posegsa.config.shipped import find
from posegsa.filters.base import sensors_in
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.model.schedules import ConstantGain
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import scenario_keys
from posegsa.search.population import ScenarioBatch


def drawn(count: int, *settings: str, kind: str = "kalman") -> ScenarioBatch:
    """Scenarios of a second of a Kalman filter, given starts and drawn biases."""
    short = ["scenario.duration=1.0", "cost.steady_window=[50, 99]", "cost.transient_window=[0, 9]"]
    experiment = config.override(config.load(find(kind)), [*short, *settings])
    keys = scenario_keys(jax.random.key(7), count)
    return scenario_batch(experiment, keys)


def true_poses(batch: ScenarioBatch) -> np.ndarray:
    """T (S, N, 4, 4) of the truth, by SciPy's rotations."""
    truth: Any = batch.samples.truth
    w, x, y, z = (np.asarray(a, np.float64) for a in truth.attitude)
    shape = w.shape
    q = np.stack([w, x, y, z], axis=-1).reshape(-1, 4)
    rotation = Rotation.from_quat(q, scalar_first=True)
    T = np.tile(np.eye(4), (*shape, 1, 1))
    T[..., :3, :3] = rotation.as_matrix().reshape(*shape, 3, 3)
    origin = np.stack([np.asarray(a, np.float64) for a in truth.origin], axis=-1)
    T[..., :3, 3] = np.einsum("...ij,...j->...i", T[..., :3, :3], origin)
    return T


@pytest.mark.usefixtures("x64")
def test_nees_is_that_of_the_matrix_form_at_each_time() -> None:
    once = "filter.iterations=1"  # as the reference linearises
    given = "scenario.start=given", "family.attitude_error=[5, 20]"
    batch = drawn(2, "run.dtype=float64", once, *given)
    found = error_tracks(Candidate(), batch)
    assert found.nees is not None
    assert found.nis is not None
    noise_of: Any = batch.filter
    n = jax.tree.map(float, noise_of.noise)
    noise = reference_ekf.Noise(
        velocity=np.repeat([n.angular_velocity, n.velocity], 3),
        bias_walk=np.repeat([n.angular_walk, n.linear_walk], 3),
        vector_walk=n.vector_walk,
        vector=n.vector,
        landmark=n.landmark,
        pose=np.repeat([n.initial_attitude, n.initial_position], 3),
        bias=np.repeat([n.initial_angular_bias, n.initial_linear_bias], 3),
        vector_bias=n.initial_vector_bias,
    )
    T = true_poses(batch)
    for i in range(2):
        start = jax.tree.map(lambda a, i=i: jnp.asarray(a[i]), batch.initial)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = start.rotation, start.position
        s: Any = jax.tree.map(lambda a, i=i: np.asarray(a[i]), batch.samples.sample)
        samples = [
            Sample(
                dt=float(s.time_step[k]),
                omega=np.array([a[k] for a in s.angular_velocity]),
                v=np.array([a[k] for a in s.velocity]),
                y=np.array([[a[k] for a in p.body] for p in s.landmarks]),
                p=np.array([[a[k] for a in p.inertial] for p in s.landmarks]),
                sL=np.array([p.factor[k] for p in s.landmarks]),
                vB=np.array([[a[k] for a in v.measured] for v in s.vectors.each]),
                vI=np.array([[a[k] for a in v.known] for v in s.vectors.each]),
                sR=np.array([v.factor[k] for v in s.vectors.each]),
            )
            for k in range(100)
        ]
        first_state = reference_ekf.start(pose, np.zeros(6), 2, noise)
        states = reference_ekf.run(samples, first_state, noise)
        for k in (0, 25, 60, 99):
            error = scipy.linalg.logm(np.linalg.inv(states[k].T) @ T[i, k]).real
            xi = [error[2, 1], error[0, 2], error[1, 0], *error[:3, 3]]
            wanted = xi @ np.linalg.solve(states[k].Sigma[:6, :6], xi)
            assert found.nees[i, k] == pytest.approx(wanted, rel=1e-5), (i, k)
            H, measured, expected, N = reference_ekf.linearised(states[k], samples[k], noise)
            residual = measured - expected
            S = H @ states[k].Sigma @ H.T + N
            wanted = residual @ np.linalg.solve(S, residual) / len(residual)
            assert found.nis[i, k] == pytest.approx(wanted, rel=1e-5), (i, k)


LINEAR = (
    "scenario.start=given",
    *("family.angular_velocity_bias=0.02", "filter.initial_angular_bias=0.02"),
    *("family.velocity_bias=0.02", "filter.initial_linear_bias=0.02"),
    *("family.vector_bias=0.02", "filter.initial_vector_bias=0.02"),
    *(f"filter.{name}_walk=1e-9" for name in ("angular", "linear", "vector")),
    *("filter.initial_attitude=0.01", "filter.initial_position=0.1"),
)
"""A filter whose deviations are those of the start, of the biases and of the noise."""


def started_near(batch: ScenarioBatch) -> ScenarioBatch:
    """The same scenarios, with initial errors that have the filter's covariance."""
    T = true_poses(batch)[:, 0]
    xi = np.random.default_rng(3).normal(size=(len(T), 6)) * np.repeat([0.01, 0.1], 3)
    T = np.stack([one @ se3_exp(-error) for one, error in zip(T, xi, strict=True)])
    learnt = len(batch.initial.vector_biases)
    initial = state_of(T, dtype=np.float32, learnt_vectors=learnt)
    return batch._replace(initial=initial._replace(turning=batch.initial.turning))


def test_where_the_filter_is_linear_nees_and_nis_are_chi_squared() -> None:
    """Errors so small that products of them are negligible, and noise that is all known."""
    count, at = 400, (0, 30, 99)
    batch = started_near(drawn(count, *LINEAR))
    assert sensors_in(batch.samples) == (2, 1)

    def believing(share: float) -> Candidate:
        """The filter that believes this share of the noises; numbers, so that it compiles once."""
        believed = ("angular_velocity", "velocity", "vector", "landmark")
        noise: Any = batch.filter
        return Candidate(
            values=tuple(jnp.asarray(share * getattr(noise.noise, name)) for name in believed),
            keys=tuple(f"filter.{name}" for name in believed),
        )

    tracks = error_tracks(believing(1.0), batch)
    assert tracks.nees is not None
    assert tracks.nis is not None
    low, high = scipy.stats.chi2.ppf([5e-5, 1 - 5e-5], 6 * count) / count
    for k in at:
        # The chance of a larger distance is 1e-4, of the distribution and of its mean.
        for values, degrees in ((tracks.nees[:, k], 6), (9 * tracks.nis[:, k], 9)):
            test: Any = scipy.stats.kstest(values, scipy.stats.chi2(degrees).cdf)
            assert test.pvalue > 1e-4, (k, degrees)
        assert low < np.mean(tracks.nees[:, k]) < high
    right, _ = metrics_of(tracks, batch)
    assert np.mean(right.nees_inside) == pytest.approx(0.95, abs=0.02)
    assert np.mean(right.nis) == pytest.approx(1, abs=0.01)
    # Noises assumed three times too small are detected.
    wrong, _ = metrics_of(error_tracks(believing(1 / 3), batch), batch)
    assert np.mean(wrong.nees) > 2 * high
    assert np.mean(wrong.nees_inside) < 0.6
    assert np.mean(wrong.nis) > 5


def test_a_filter_without_a_covariance_has_neither() -> None:
    batch = drawn(2, kind="quick")
    tracks = error_tracks(Candidate(ConstantGain(jnp.float32(20))), batch)
    assert tracks.nees is None
    assert tracks.nis is None
    found, _ = metrics_of(tracks, batch)
    assert np.isnan([found.nees, found.nees_inside, found.nis]).all()
