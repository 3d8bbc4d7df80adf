"""What the sensors of an exported filter say, and how its C is fed with it."""

from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from posegsa.model.measurements import Measurements

SAMPLES = 10_000
START = np.array([0.5, -0.5, 0.5, 0.5, 1.0, -2.0, 3.0])
"""Quaternion and position [m] of the estimate before the first sample."""


class Known(Protocol):
    """What is known of the sensors."""

    @property
    def vectors(self) -> np.ndarray:
        """(n, 3) in the inertial frame."""
        ...

    @property
    def landmarks(self) -> np.ndarray:
        """(m, 3) in the inertial frame [m]."""
        ...


def sensed(known: Known, step: np.ndarray, missing: float = 0.0) -> Measurements:
    """What a body that turns and moves all the time measures, with noise and biases, at steps (N,).

    A share `missing` of vectors and landmarks has weight 0, and NaN for its value.
    """
    rng, N = np.random.default_rng(1), len(step)
    time = np.cumsum(step)
    angles = np.sin(time[:, None] * [0.7, 0.5, 0.3]) * [2.0, 1.2, 2.5] + 0.2 * time[:, None]
    R = Rotation.from_euler("zyx", np.append(angles, angles[-1:], axis=0))
    P = np.sin(time[:, None] * [0.2, 0.3, 0.1]) * [3.0, 2.0, 1.0]
    P = np.append(P, P[-1:], axis=0)
    omega = (R[:-1].inv() * R[1:]).as_rotvec() / step[:, None]
    v = R[:-1].inv().apply(np.diff(P, axis=0)) / step[:, None]

    def seen(inertial: np.ndarray, bias: float) -> tuple[np.ndarray, np.ndarray]:
        """Body coordinates of (N, i, 3), and weights."""
        body = np.einsum("nji,nkj->nki", R[:-1].as_matrix(), inertial)
        body += 0.1 * rng.normal(size=body.shape) + bias * rng.normal(size=body.shape[1:])
        known = body.shape[:2]
        weights = rng.uniform(0.4, 1.5, (1, known[1])) * (rng.random(known) >= missing)
        return np.where(weights[..., None] > 0, body, np.nan), weights

    def rate(a: np.ndarray) -> np.ndarray:
        return a + [0.1, -0.1, 0.05] + 0.1 * rng.normal(size=a.shape)

    v_I = np.broadcast_to(known.vectors, (N, *known.vectors.shape))
    v_B, v_weights = seen(v_I, 0.1)
    y, y_weights = seen(known.landmarks - P[:-1, None], 0.0)
    p_I = np.broadcast_to(known.landmarks, (N, *known.landmarks.shape))
    return Measurements(step, rate(omega), rate(v), v_B, v_I, v_weights, y, p_I, y_weights)


def recorded(known: Known) -> Measurements:
    """As a log looks: jitter, samples lost, sensors missing for a while or at random, quantised."""
    rng = np.random.default_rng(2)
    step = rng.uniform(0.007, 0.013, SAMPLES)
    step[rng.random(SAMPLES) < 0.02] *= 4
    m = sensed(known, step, missing=0.2)
    away = np.zeros(SAMPLES, bool)
    away[3000:3300] = away[7000:7050] = True  # nothing but the velocities
    v, y = (np.where(away[:, None], 0.0, w) for w in (m.vector_weights, m.landmark_weights))
    return m._replace(
        angular_velocity=np.round(m.angular_velocity * 500) / 500,
        velocity=np.round(m.velocity * 200) / 200,
        vectors=np.round(m.vectors * 256) / 256,
        landmarks=np.round(m.landmarks * 100) / 100,
        vector_weights=v,
        landmark_weights=y,
    )


def rows_of(m: Measurements, dtype: Any = np.float64, *, velocity: bool = True) -> np.ndarray:
    """(N, numbers) a row is dt and the measurement as C has it; NaN where something is missing.

    Without a velocity, as an attitude filter takes them.
    """
    count = len(m.time_step)
    columns = [m.time_step[:, None], m.angular_velocity]
    if velocity:
        columns.append(m.velocity)
    for values, weights in ((m.vectors, m.vector_weights), (m.landmarks, m.landmark_weights)):
        columns += [values.reshape(count, -1), weights] if weights.shape[1] else []
    return np.concatenate(columns, axis=1).astype(dtype)


WRONG = (
    *((0, 0.0), (0, -0.01), (0, 1e-10), (0, 61.0), (2, 1.1e3), (5, -1e26), (8, 1.1e6)),
    *((13, -1.0), (16, 1.1e6), (18, -1e-9), (18, 1.1e6)),
)
"""Columns of `rows_of` with two vectors and a landmark, and values that no sensor gives."""


def with_wrong_rows(good: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Good rows (N, numbers) with others in between that are to be refused, and which these are."""
    every = [(c, value) for c in range(good.shape[1]) for value in (np.nan, np.inf, -np.inf)]
    bad = np.repeat(good[100:101], len(every) + len(WRONG), axis=0)
    for row, (column, value) in zip(bad, [*every, *WRONG], strict=True):
        row[column] = value
    wrong = np.zeros(len(good) + len(bad), bool)
    wrong[100 : 100 + len(bad)] = True
    return np.concatenate([good[:100], bad, good[100:]]), wrong
