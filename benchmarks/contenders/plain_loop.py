"""One agent at a time, one sample at a time, 3x3 matrices: the straightforward loop.

The caller chooses the library of the fuzzy controller. NumPy only, so that the library may be in an
environment of its own. Slow: it is run on a slice and extrapolated.
"""

import time
from collections.abc import Callable

import numpy as np

from contenders.scene import Scene

SLICE = {"start": 400, "samples": 30}
"""The slice that is run: in the steady window, where costs depend on the controller."""

Controller = Callable[[float, float, float], float]
"""Gain [1/s] of error, rate and last gain."""


def matrix(q: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a unit quaternion (4,), w first."""
    w, x, y, z = q
    v = np.array([x, y, z])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew(v)


def skew(a: np.ndarray) -> np.ndarray:
    """[a]x."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def exponential(omega: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and displacement (3,) of exp([omega; v]^)."""
    W, angle = skew(omega), np.linalg.norm(omega)
    if angle < 1e-4:
        return np.eye(3) + W + W @ W / 2, v + W @ v / 2 + W @ W @ v / 6
    first, second = np.sin(angle) / angle, 2 * (np.sin(angle / 2) / angle) ** 2
    third = (1 - first) / angle**2
    return np.eye(3) + first * W + second * W @ W, v + second * W @ v + third * W @ W @ v


def simulate(scene: Scene, controller: Controller) -> float:
    """Cost of one agent on the first scenario."""
    R, P = matrix(scene.attitude[0]), scene.position[0]
    b1, b2 = scene.bias[0, :3], scene.bias[0, 3:]
    gain, cost, previous = scene.initial_gain, 0.0, None
    for k in range(scene.samples):
        dt, B, weight = scene.time_step[0, k], scene.profile[0, k], scene.landmark_weight[0, k]
        p = scene.landmark_inertial[0, k]
        attitude = 0.25 * np.trace(np.eye(3) - R @ matrix(scene.true_attitude[0, k]).T)
        position = np.linalg.norm(P - R @ scene.true_origin[0, k])
        cost += scene.cost_weight[k] * (attitude + scene.cost_position * position)

        x = R @ scene.landmark_body[0, k] + P
        power = scene.vector_power[0, k] - 2 * np.trace(R @ B)
        now = scene.attitude_scale[0, k] * max(power, 0.0)
        now += scene.position_weight * (weight > 0) * np.linalg.norm(p - x)
        previous = now if previous is None else previous
        signal = now + scene.smoothing_factor[0, k] * (previous - now)
        error = min(signal / scene.error_scale, 1.0)
        gain = controller(error, min(abs(signal - previous) * scene.rate_scale, 1.0), gain)
        previous = signal

        RB = R @ B
        u1 = np.array([RB[1, 2] - RB[2, 1], RB[2, 0] - RB[0, 2], RB[0, 1] - RB[1, 0]])
        u1 = 0.5 * (u1 + weight * np.cross(x, p))
        u2 = 0.5 * weight * (p - x)
        used = gain
        if scene.gain_limit > 0:
            x2, p2 = x @ x, p @ p
            product = np.sqrt(x2 * p2) + np.sqrt((1 + x2) * (1 + p2))
            curvature = scene.vector_curvature[0, k] + 0.25 * weight * (1 + product)
            used = min(gain, scene.gain_limit / (dt * curvature))
        omega = dt * (used * R.T @ u1 + scene.angular_velocity[0, k] - b1)
        v = dt * (used * R.T @ (u2 - np.cross(P, u1)) + scene.velocity[0, k] - b2)
        b1 = b1 - dt * scene.gamma[0] * R.T @ (u1 - np.cross(P, u2))
        b2 = b2 - dt * scene.gamma[1] * R.T @ u2
        turn, displacement = exponential(omega, v)
        R, P = R @ turn, P + R @ displacement
    return float(cost)


def measure(
    scene: Scene, make: Callable[[np.ndarray, np.ndarray, int], Controller], seconds: float
) -> dict[str, float | list[float]]:
    """Costs of a slice on a fine grid, to be checked, and the time of a step with 101 points.

    Args:
        scene: the whole scene.
        make: a controller of input terms, output terms (5, 3) and a number of sample points.
        seconds: about how long to measure.

    Returns:
        Costs of the first agents on the slice, with 2001 points, and the mean time per agent and
        step [s] over all agents that were timed.
    """
    slice_ = scene.part(**SLICE)
    checked = [simulate(slice_, make(scene.inputs[a], scene.outputs[a], 2001)) for a in range(2)]
    # Controllers are made outside: a search makes one for each agent, not for each step.
    spent, steps = 0.0, 0
    for a in range(scene.agents):
        controller = make(scene.inputs[a], scene.outputs[a], 101)
        started = time.perf_counter()
        simulate(slice_, controller)
        spent, steps = spent + time.perf_counter() - started, steps + slice_.samples
        if spent > seconds:
            break
    return {"costs": checked, "seconds_per_step": spent / steps, "steps": steps}
