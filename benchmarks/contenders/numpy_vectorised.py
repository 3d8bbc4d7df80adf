"""NumPy, vectorised over agents: what most people would write, in float64."""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from contenders.scene import RULES, Scene

_TERMS = 5
_ORDER = np.argsort(np.ravel(RULES), kind="stable")
_STARTS = np.searchsorted(np.ravel(RULES)[_ORDER], np.arange(_TERMS))
"""The rules sorted by output term, so that one `reduceat` takes the maximum for each."""
_FIRST, _SECOND = (np.array(i) for i in zip(*combinations(range(_TERMS), 2), strict=True))
_BETWEEN = np.array([[i < t < j for t in range(_TERMS)] for i, j in combinations(range(_TERMS), 2)])


def prepare(scene: Scene) -> Callable[[], np.ndarray]:
    """A function of no arguments that computes the costs (S, A)."""

    def costs() -> np.ndarray:
        schedule = Schedule(scene)
        return np.stack([_simulate(scene, s, schedule) for s in range(scene.scenarios)])

    return costs


class Schedule:
    """The fuzzy gain of all agents at once; exact centroid (see `posegsa.model.fuzzy`)."""

    def __init__(self, scene: Scene) -> None:
        self.a, self.b, self.c = np.moveaxis(scene.inputs, -1, 0)
        self.rise = 1 / np.maximum(self.b - self.a, 1e-12)
        self.fall = 1 / np.maximum(self.c - self.b, 1e-12)
        self.single = self._overlaps(scene.outputs, np.arange(_TERMS), np.arange(_TERMS))
        self.pairs = self._overlaps(scene.outputs, _FIRST, _SECOND)

    @staticmethod
    def _overlaps(terms: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, ...]:
        """Cap and coefficients of area and moment under terms i and j, (A, pairs) each."""
        a, b, c = np.moveaxis(terms, -1, 0)
        u, v, width = b[:, j] - a[:, j], c[:, i] - b[:, i], c[:, i] - a[:, j]
        slope = u + v
        cap = np.clip(width / np.maximum(slope, 1e-12), 0, 1)
        ends = c[:, i] + a[:, j]
        return (
            cap,
            width,
            slope / 2,
            width * ends / 2,
            (c[:, i] * v + a[:, j] * u) / 2,
            slope * (v - u) / 6,
        )

    def _memberships(self, x: np.ndarray) -> np.ndarray:
        """(A, 5) of inputs (A,)."""
        x = x[:, None]
        edge = np.where(x < self.b, (self.b - x) * self.rise, (x - self.b) * self.fall)
        return np.maximum(0, 1 - edge)

    def gain(self, error: np.ndarray, rate: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Gain (A,) [1/s] of the scaled error and rate (A,)."""
        e, r = self._memberships(error), self._memberships(rate)
        fired = np.minimum(r[:, :, None], e[:, None, :]).reshape(len(e), -1)
        h = np.maximum.reduceat(fired[:, _ORDER], _STARTS, axis=1)
        both = np.minimum(h[:, _FIRST], h[:, _SECOND])
        covered = np.minimum(both, np.max(h[:, None, :] * _BETWEEN, axis=-1))
        parts = (
            _integrals(self.single, h),
            _integrals(self.pairs, both),
            _integrals(self.pairs, covered),
        )
        area, moment = (x - y + z for x, y, z in zip(*parts, strict=True))
        return np.where(area > 0, 1 + moment / np.where(area > 0, area, 1), last)


def _integrals(overlap: tuple[np.ndarray, ...], height: np.ndarray) -> tuple[np.ndarray, ...]:
    """Areas and moments (A,), summed over pairs of terms."""
    cap, f1, f2, m1, m2, m3 = overlap
    h = np.minimum(height, cap)
    return np.sum(h * (f1 - h * f2), axis=1), np.sum(h * (m1 - h * (m2 - h * m3)), axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A x b of vectors (..., 3); `np.cross` is several times slower on small arrays."""
    (a0, a1, a2), (b0, b1, b2) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def matrix(q: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a unit quaternion (4,), w first."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _norm(a: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("ai,ai->a", a, a))


def _exponential(omega: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (A, 3, 3) and displacements (A, 3) of exp([omega; v]^)."""
    angle2 = np.einsum("ai,ai->a", omega, omega)[:, None]
    angle = np.sqrt(np.maximum(angle2, 1e-12))
    first = np.sin(angle) / angle
    second = 0.5 * (np.sin(angle / 2) / (angle / 2)) ** 2
    third = np.where(angle2 < 1e-4, (1 - angle2 / 20) / 6, (1 - first) / angle**2)
    W = np.zeros((len(omega), 3, 3))
    W[:, 2, 1], W[:, 0, 2], W[:, 1, 0] = omega.T
    W -= np.swapaxes(W, 1, 2)
    turned = _cross(omega, v)
    rotation = np.eye(3) + first[..., None] * W + second[..., None] * (W @ W)
    return rotation, v + second * turned + third * _cross(omega, turned)


def _simulate(scene: Scene, s: int, schedule: Schedule) -> np.ndarray:
    """Costs (A,) on scenario s; the filter as `posegsa.filters.observer` has it."""
    A, smoothing = scene.agents, scene.smoothing_factor[s]
    R = np.broadcast_to(matrix(scene.attitude[s]), (A, 3, 3))
    P = np.broadcast_to(scene.position[s], (A, 3))
    b = np.broadcast_to(scene.bias[s], (A, 6))
    gain, cost, previous = np.full(A, scene.initial_gain), np.zeros(A), None
    for k in range(scene.samples):
        dt, B, weight = scene.time_step[s, k], scene.profile[s, k], scene.landmark_weight[s, k]
        y, p = scene.landmark_body[s, k], scene.landmark_inertial[s, k]
        # Running cost.
        true = matrix(scene.true_attitude[s, k])
        attitude = 0.25 * (3 - np.einsum("aij,ij->a", R, true))
        position = _norm(P - R @ scene.true_origin[s, k])
        cost += scene.cost_weight[k] * (attitude + scene.cost_position * position)
        # Error signal and gain.
        RB, x = R @ B, R @ y + P
        residual = p - x
        trace = np.einsum("aii->a", RB)
        now = scene.attitude_scale[s, k] * np.maximum(scene.vector_power[s, k] - 2 * trace, 0)
        now += scene.position_weight * (weight > 0) * _norm(residual)
        previous = now if previous is None else previous
        signal = now + smoothing[k] * (previous - now)
        error = np.minimum(signal / scene.error_scale, 1)
        rate = np.minimum(np.abs(signal - previous) * scene.rate_scale, 1)
        gain, previous = schedule.gain(error, rate, gain), signal
        # Innovation, gain limit, corrections of velocity and bias.
        u1 = np.stack(
            [RB[:, 1, 2] - RB[:, 2, 1], RB[:, 2, 0] - RB[:, 0, 2], RB[:, 0, 1] - RB[:, 1, 0]], -1
        )
        u1 = 0.5 * (u1 + weight * _cross(x, np.broadcast_to(p, x.shape)))
        u2 = 0.5 * weight * residual
        used = gain
        if scene.gain_limit > 0:
            x2, p2 = np.einsum("ai,ai->a", x, x), p @ p
            product = np.sqrt(x2 * p2) + np.sqrt((1 + x2) * (1 + p2))
            curvature = scene.vector_curvature[s, k] + 0.25 * weight * (1 + product)
            used = np.minimum(gain, scene.gain_limit / (dt * curvature))
        to_body = np.swapaxes(R, 1, 2)

        def body(a: np.ndarray, to_body: np.ndarray = to_body) -> np.ndarray:
            return (to_body @ a[..., None])[..., 0]

        step = (used * dt)[:, None]
        omega = step * body(u1) + dt * (scene.angular_velocity[s, k] - b[:, :3])
        v = step * body(u2 - _cross(P, u1)) + dt * (scene.velocity[s, k] - b[:, 3:])
        b = b - dt * np.concatenate(
            [scene.gamma[0] * body(u1 - _cross(P, u2)), scene.gamma[1] * body(u2)], axis=-1
        )
        turn, displacement = _exponential(omega, v)
        P = P + (R @ displacement[..., None])[..., 0]
        R = R @ turn
    return cost
