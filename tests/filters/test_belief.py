"""Belief in an observer's sensors: by it the weight of each is divided.

What a Kalman filter believes is tested with its noises (`test_noise_schedules`).
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import as_arrays
from helpers.filters import state_of, vector_settings
from helpers.measurements import random_measurements, random_poses
from helpers.measurements import reference_sample as sample_of

from posegsa.errors import ArgumentError
from posegsa.filters.noise_schedules import NoiseSignal
from posegsa.filters.observer import BeliefSettings, FilterSettings, Observer, ObserverGains
from posegsa.filters.rollout import Estimates
from posegsa.model.measurements import Measurements
from posegsa.model.schedules import ConstantGain, GainSchedule, RampGain
from posegsa.recordings.running import run_filter

pytestmark = pytest.mark.usefixtures("x64")

GAIN, GAMMA, SMOOTHING, SCALE, LARGEST = 3.0, 2.0, 0.05, 1e4, 1e3
DEVIATIONS = 0.4, 0.7


def observer(
    vectors: GainSchedule | None = None, landmarks: GainSchedule | None = None
) -> Observer:
    signal = NoiseSignal(*map(jnp.asarray, (SMOOTHING, SCALE, 0.1, LARGEST)))
    settings = FilterSettings(
        gamma_law="fixed",
        gamma_angular=jnp.asarray(GAMMA),
        gamma_linear=jnp.asarray(GAMMA),
        vectors=vector_settings(each_agent=True),
    )
    gains = ObserverGains(ConstantGain(jnp.asarray(GAIN)), vectors, landmarks)
    belief = BeliefSettings(signal, *map(jnp.asarray, DEVIATIONS))
    return Observer(gains, settings, belief=belief)


def ramp(start: float, slope: float) -> RampGain:
    return RampGain(jnp.asarray(start), jnp.asarray(slope))


def factor_of(largest_to_the: float) -> ConstantGain:
    return ConstantGain(jnp.asarray(1 + 100 * largest_to_the))


def sequence(count: int, missing: float = 0.3) -> tuple[Any, np.ndarray]:
    rng = np.random.default_rng(5)
    return random_measurements(rng, count, 2, 2, missing=missing), random_poses(rng, 1)[0]


def ran(filter: Observer, m: Measurements, T: np.ndarray) -> Estimates:
    return run_filter(filter, as_arrays(m, np.float64), state_of(T))


def same(a: Estimates, b: Estimates) -> None:
    for name in ("rotation", "position", "bias"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-9)


class Followed:
    """The low-passed residual of one sensor, and the factor of a straight line, in NumPy."""

    def __init__(self, start: float, slope: float) -> None:
        self.line = start, slope
        self.value, self.seen = 0.0, -1.0

    def factor(self, square: float, time: float) -> float:
        if self.seen < 0:
            self.value = square
        else:
            past = time - self.seen
            self.value += (square - self.value) * past / (past + SMOOTHING)
        self.seen = time
        start, slope = self.line
        e = np.clip(np.log(self.value) / np.log(SCALE), 0, 1)
        return LARGEST ** np.clip(slope * (e - start), 0, 1)


def test_weights_are_divided_as_in_the_reference() -> None:
    m, T = sequence(40)
    found = ran(observer(ramp(0.05, 2.0), ramp(0.1, 0.7)), m, T)
    pose, b, time, factors = T, np.zeros(6), 0.0, []
    vectors, landmarks = ([Followed(*line), Followed(*line)] for line in ((0.05, 2.0), (0.1, 0.7)))
    for k in range(40):
        np.testing.assert_allclose(found.rotation[k], pose[:3, :3], atol=1e-9)
        np.testing.assert_allclose(found.position[k], pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose(found.bias[k], b, atol=1e-9)
        s, (R, P) = sample_of(m, k), (pose[:3, :3], pose[:3, 3])
        sR, sL = s.sR.copy(), s.sL.copy()
        for i in np.flatnonzero(s.sR):
            square = np.sum((s.vB[i] - R.T @ s.vI[i]) ** 2) / (3 * DEVIATIONS[0] ** 2)
            sR[i] = vectors[i].factor(square, time)
        for i in np.flatnonzero(s.sL):
            square = np.sum((s.y[i] - R.T @ (s.p[i] - P)) ** 2) / (3 * DEVIATIONS[1] ** 2)
            sL[i] = landmarks[i].factor(square, time)
        for given, by in ((s.sR, sR), (s.sL, sL)):
            seen = given > 0
            if seen.any():  # the sensor of a kind that disagrees least is fully believed
                factors.append(by[seen].max() / by[seen].min())
                by[seen] = given[seen] / by[seen] * by[seen].min()
        pose, b = reference.filter_step(
            *(pose, b, replace(s, sR=sR, sL=sL), GAIN),
            gamma=(GAMMA, GAMMA),
            substeps=2,
            gain_limit=1.5,
        )
        time += s.dt
    assert min(factors) == 1 < 4 < max(factors)


def test_the_factor_1_changes_nothing() -> None:
    m, T = sequence(30)
    plain = observer()
    same(ran(observer(factor_of(0.0), factor_of(0.0)), m, T), ran(plain, m, T))
    alone = Observer(ConstantGain(jnp.asarray(GAIN)), plain.settings)
    same(ran(plain, m, T), ran(alone, m, T))


@pytest.mark.parametrize("kind", ["vectors", "landmarks"])
def test_sensors_of_a_kind_that_disagree_alike_are_all_believed(kind: str) -> None:
    m, T = sequence(30)
    same(ran(observer(**{kind: factor_of(0.5)}), m, T), ran(observer(), m, T))


def test_a_disturbed_sensor_moves_the_estimate_less() -> None:
    """A body at rest; one of two vectors and one of two landmarks are wrong for a second."""
    rng = np.random.default_rng(2)
    known, places = rng.normal(size=(2, 2, 3))
    count, disturbed = 300, slice(100, 200)
    vectors, landmarks = (np.tile(each, (count, 1, 1)) for each in (known, places))
    vectors = vectors + 0.02 * rng.normal(size=vectors.shape)
    landmarks = landmarks + 0.02 * rng.normal(size=landmarks.shape)
    vectors[disturbed, 0] += 2.0
    landmarks[disturbed, 0] += 2.0
    m = Measurements.from_arrays(
        time_step=0.01,
        angular_velocity=np.zeros((count, 3)),
        velocity=np.zeros((count, 3)),
        vectors=vectors,
        vector_references=known,
        landmarks=landmarks,
        landmark_references=places,
        dtype=np.float64,
    )
    line = ramp(0.05, 2.0)
    errors = [
        float(np.max(np.linalg.norm(run_filter(one, m, state_of(np.eye(4))).position, axis=1)))
        for one in (observer(line, line), observer())
    ]
    assert errors[0] < 0.3 * errors[1]


def test_jit_is_eager_and_vmap_is_a_loop() -> None:
    m, T = sequence(12, missing=0.0)
    state, given = state_of(T), as_arrays(m, np.float64)
    whole = run_filter(observer(ramp(0.05, 2.0), ramp(0.1, 0.7)), given, state)

    def last(start: jax.Array) -> jax.Array:
        filter = observer(RampGain(start, jnp.asarray(2.0)), ramp(0.1, 0.7))
        return run_filter(filter, given, state).position[-1]

    with jax.disable_jit():
        np.testing.assert_allclose(last(jnp.asarray(0.05)), whole.position[-1], atol=1e-12)
    starts = jnp.asarray([0.05, 0.2, 0.4])
    loop = np.stack([last(start) for start in starts])
    assert np.ptp(loop, axis=0).max() > 1e-3
    np.testing.assert_allclose(jax.vmap(last)(starts), loop, atol=1e-12)


def test_belief_needs_to_know_the_sensors_noise() -> None:
    filter = replace(observer(ramp(0.1, 1.0)), belief=None)
    m, T = sequence(3)
    with pytest.raises(ArgumentError, match="belief: None; allowed: BeliefSettings"):
        ran(filter, m, T)
