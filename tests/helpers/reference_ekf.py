"""Independent NumPy float64 reference of the invariant Kalman filter; readable, not fast.

Matrix form: one update with all measurements, one inverse, Joseph's form. It shares no
code with the package and must stay that way. Conventions as in `reference`; the error is
left-invariant, T = T_est exp(xi^), and the states are [xi; b; c_1; ...], rotation first.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import logm

from helpers.reference import Array, Sample, adjoint, se3_exp, skew


@dataclass(frozen=True)
class Noise:
    """Standard deviations (6,) or scalar; of velocities and walks per sqrt(s)."""

    velocity: Array  # (6,) rad/sqrt(s), m/sqrt(s)
    bias_walk: Array  # (6,) rad/s/sqrt(s), m/s/sqrt(s)
    vector_walk: float
    vector: float
    landmark: float  # m
    pose: Array  # (6,) at the start, rad, m
    bias: Array  # (6,) at the start, rad/s, m/s
    vector_bias: float  # at the start


@dataclass(frozen=True)
class State:
    """Estimate before or after a sample, and the covariance (d, d) of its error."""

    T: Array  # (4, 4)
    b: Array  # (6,)
    c: Array  # (n, 3), n = 0 without such states
    Sigma: Array  # (12 + 3 n, 12 + 3 n)


def start(T: Array, b: Array, learnt: int, noise: Noise) -> State:
    deviations = np.concatenate([noise.pose, noise.bias, np.full(3 * learnt, noise.vector_bias)])
    return State(T, b, np.zeros((learnt, 3)), np.diag(deviations**2))


def linearised(state: State, s: Sample, noise: Noise) -> tuple[Array, Array, Array, Array]:
    """All measurements: H, measured and expected values, covariance of the noise.

    Measurements of weight 0 are left out.
    """
    R, P, d = state.T[:3, :3], state.T[:3, 3], len(state.Sigma)
    H, measured, expected, variances = [np.zeros((0, d))], [], [], []
    for i in np.flatnonzero(s.sR):
        rows, known = np.zeros((3, d)), R.T @ s.vI[i]
        rows[:, :3] = skew(known)
        if len(state.c):
            rows[:, 12 + 3 * i : 15 + 3 * i] = np.eye(3)
        H.append(rows)
        measured.extend(s.vB[i])
        expected.extend(known + state.c[i] if len(state.c) else known)
        variances.extend([noise.vector**2 / s.sR[i]] * 3)
    for i in np.flatnonzero(s.sL):
        rows, seen = np.zeros((3, d)), R.T @ (s.p[i] - P)
        rows[:, :6] = np.hstack([skew(seen), -np.eye(3)])
        H.append(rows)
        measured.extend(s.y[i])
        expected.extend(seen)
        variances.extend([noise.landmark**2 / s.sL[i]] * 3)
    return np.concatenate(H), np.array(measured), np.array(expected), np.diag(variances)


def update(state: State, s: Sample, noise: Noise, iterations: int = 1) -> tuple[State, Array]:
    """The state after all measurements of a sample, linearised repeatedly, and the correction.

    The last linearisation is the first one whose correction of the attitude is at most 0.03 rad.
    Sigma is that of the sample in each of them: it is not moved to the coordinates of the estimate.
    """
    found, x = state, np.zeros(len(state.Sigma))
    for _ in range(iterations):
        # The errors of `found` if the state before were the truth: the mean of the prior.
        back = np.concatenate(
            [
                se3_log(np.linalg.inv(found.T) @ state.T),
                state.b - found.b,
                (state.c - found.c).ravel(),
            ]
        )
        H, measured, expected, N = linearised(found, s, noise)
        if not len(H):
            return state, x
        Sigma = state.Sigma
        K = Sigma @ H.T @ np.linalg.inv(H @ Sigma @ H.T + N)
        x = back + K @ (measured - expected - H @ back)
        rest = np.eye(len(Sigma)) - K @ H
        found = State(
            T=found.T @ se3_exp(x[:6]),
            b=found.b + x[6:12],
            c=found.c + x[12:].reshape(-1, 3),
            Sigma=rest @ Sigma @ rest.T + K @ N @ K.T,
        )
        if np.linalg.norm(x[:3]) <= 0.03:
            break
    return found, x


def se3_log(T: Array) -> Array:
    """The twist of a pose, by the logarithm of its matrix."""
    xi = np.real(logm(T))
    return np.array([xi[2, 1], xi[0, 2], xi[1, 0], *xi[:3, 3]])


def propagate(state: State, x: Array, s: Sample, noise: Noise, reset: str = "off") -> State:
    """The state at the next sample; Sigma has yet to be reset by the correction x."""
    u = (np.concatenate([s.omega, s.v]) - state.b) * s.dt
    A = adjoint(se3_exp(-u))
    turned = np.eye(len(state.Sigma))
    if reset == "two frames":
        T = se3_exp(np.concatenate([x[:3], x[3:6] / np.sqrt(1 + x[3:6] @ x[3:6] / 100.0**2)]))
        A = A @ np.linalg.inv(adjoint(T))
        biases = (len(turned) - 6) // 3
        turned[6:, 6:] = np.kron(np.eye(biases), T[:3, :3].T)
    F = np.eye(len(state.Sigma))
    F[:6, :6], F[:6, 6:12] = A, -(np.eye(6) + A) / 2 * s.dt
    F = F @ turned
    densities = np.concatenate(
        [noise.velocity, noise.bias_walk, np.full(state.c.size, noise.vector_walk)]
    )
    Sigma = F @ state.Sigma @ F.T + np.diag(densities**2 * s.dt)
    return State(state.T @ se3_exp(u), state.b, state.c, Sigma)


def run(
    samples: list[Sample], state: State, noise: Noise, iterations: int = 1, reset: str = "off"
) -> list[State]:
    """The states before each sample and after the last."""
    states = [state]
    for sample in samples:
        updated, x = update(states[-1], sample, noise, iterations)
        states.append(propagate(updated, x, sample, noise, reset))
    return states
