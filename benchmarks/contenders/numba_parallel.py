"""Numba: one agent after the other in compiled scalar code, agents shared among threads, float64.

Needs numba (`pip install ".[bench]"`).
"""

import math
from collections.abc import Callable

import numba  # pyright: ignore[reportMissingImports] - of an extra, not in the gate
import numpy as np

from contenders.scene import RULES, Scene

_RULES = np.array(RULES)
_inline = numba.njit(fastmath=True, inline="always", error_model="numpy")


def prepare(scene: Scene, threads: int) -> Callable[[], np.ndarray]:
    """A function of no arguments that computes the costs (S, A), compiled when it returns."""
    samples = np.ascontiguousarray(
        np.concatenate(
            [
                scene.profile.reshape(*scene.time_step.shape, 9),
                scene.angular_velocity,
                scene.velocity,
                scene.landmark_body,
                scene.landmark_inertial,
                scene.true_attitude,
                scene.true_origin,
                np.stack(
                    [
                        scene.time_step,
                        scene.vector_power,
                        scene.vector_curvature,
                        scene.attitude_scale,
                        scene.landmark_weight,
                        scene.smoothing_factor,
                        np.broadcast_to(scene.cost_weight, scene.time_step.shape),
                    ],
                    axis=-1,
                ),
            ],
            axis=-1,
        )
    )
    start = np.concatenate([scene.attitude, scene.position, scene.bias], axis=-1)
    numbers = np.array(
        [
            *scene.gamma,
            scene.gain_limit,
            scene.position_weight,
            scene.error_scale,
            scene.rate_scale,
            scene.cost_position,
            scene.initial_gain,
        ]
    )

    def costs() -> np.ndarray:
        numba.set_num_threads(threads)
        return _population(samples, start, scene.inputs, scene.outputs, numbers)

    costs()
    return costs


@_inline
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_inline
def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@_inline
def _plus(a, s, b):
    """A + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@_inline
def _rows(w, x, y, z):
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@_inline
def _rotate(R, a):
    return _dot(R[0], a), _dot(R[1], a), _dot(R[2], a)


@_inline
def _unrotate(R, a):
    return (
        R[0][0] * a[0] + R[1][0] * a[1] + R[2][0] * a[2],
        R[0][1] * a[0] + R[1][1] * a[1] + R[2][1] * a[2],
        R[0][2] * a[0] + R[1][2] * a[1] + R[2][2] * a[2],
    )


@numba.njit(fastmath=True, error_model="numpy")
def _fuzzify(x, terms, out):
    for i in range(5):
        a, b, c = terms[i, 0], terms[i, 1], terms[i, 2]
        if x < b:
            out[i] = max(0.0, (x - a) / (b - a))
        elif x > b:
            out[i] = max(0.0, (c - x) / (c - b))
        else:
            out[i] = 1.0


@_inline
def _integrals(h, first, second):
    """Area and moment under two output terms clipped at h (see `posegsa.model.fuzzy.Overlap`)."""
    a, c = second[0], first[2]
    width, u, v = c - a, second[1] - a, c - first[1]
    slope = u + v
    area, moment = 0.0, 0.0
    if width > 0:
        h = min(h, width / slope) if slope > 0 else h
        area = h * (width - 0.5 * h * slope)
        moment = 0.5 * h * (width * (c + a) - h * (c * v + a * u - h * slope * (v - u) / 3))
    return area, moment


@numba.njit(fastmath=True, error_model="numpy")
def _gain(error, rate, last, inputs, outputs, e, r, h):
    _fuzzify(error, inputs, e)
    _fuzzify(rate, inputs, r)
    h[:] = 0.0
    for i in range(5):
        for j in range(5):
            h[_RULES[i, j]] = max(h[_RULES[i, j]], min(r[i], e[j]))
    area, moment = 0.0, 0.0
    for i in range(5):
        if h[i] > 0:
            f, m = _integrals(h[i], outputs[i], outputs[i])
            area, moment = area + f, moment + m
            between = 0.0
            for j in range(i + 1, 5):
                both = min(h[i], h[j])
                if both > between:
                    f, m = _integrals(both, outputs[i], outputs[j])
                    area, moment = area - f, moment - m
                    f, m = _integrals(between, outputs[i], outputs[j])
                    area, moment = area + f, moment + m
                between = max(between, h[j])
    return 1 + moment / area if area > 0 else last


@numba.njit(fastmath=True, error_model="numpy")
def _agent(samples, start, inputs, outputs, numbers):
    """Cost of one agent on one scenario."""
    gamma1, gamma2, limit, position_weight, error_scale, rate_scale, cost_position, gain = numbers
    q = (start[0], start[1], start[2], start[3])
    P = (start[4], start[5], start[6])
    b1, b2 = (start[7], start[8], start[9]), (start[10], start[11], start[12])
    e, r, h = np.empty(5), np.empty(5), np.empty(5)
    cost, previous = 0.0, -1.0
    for k in range(samples.shape[0]):
        s = samples[k]
        B = ((s[0], s[1], s[2]), (s[3], s[4], s[5]), (s[6], s[7], s[8]))
        y, p = (s[15], s[16], s[17]), (s[18], s[19], s[20])
        dt, power, vectors, scale, weight, smoothing, cost_weight = (
            s[28],
            s[29],
            s[30],
            s[31],
            s[32],
            s[33],
            s[34],
        )
        R = _rows(q[0], q[1], q[2], q[3])
        # Running cost.
        d = q[0] * s[21] + q[1] * s[22] + q[2] * s[23] + q[3] * s[24]
        away = _plus(P, -1.0, _rotate(R, (s[25], s[26], s[27])))
        cost += cost_weight * (1 - d * d + cost_position * math.sqrt(_dot(away, away)))
        # Error signal and gain.
        c = ((B[0][0], B[1][0], B[2][0]), (B[0][1], B[1][1], B[2][1]), (B[0][2], B[1][2], B[2][2]))
        trace = _dot(R[0], c[0]) + _dot(R[1], c[1]) + _dot(R[2], c[2])
        x = _plus(P, 1.0, _rotate(R, y))
        residual = _plus(p, -1.0, x)
        now = scale * max(power - 2 * trace, 0.0)
        if weight > 0:
            now += position_weight * math.sqrt(_dot(residual, residual))
        previous = now if previous < 0 else previous
        signal = now + smoothing * (previous - now)
        rate = min(abs(signal - previous) * rate_scale, 1.0)
        gain = _gain(min(signal / error_scale, 1.0), rate, gain, inputs, outputs, e, r, h)
        previous = signal
        # Innovation, gain limit, corrections of velocity and bias.
        u1 = (
            _dot(R[1], c[2]) - _dot(R[2], c[1]),
            _dot(R[2], c[0]) - _dot(R[0], c[2]),
            _dot(R[0], c[1]) - _dot(R[1], c[0]),
        )
        u1 = _plus(u1, weight, _cross(x, p))
        u1 = (0.5 * u1[0], 0.5 * u1[1], 0.5 * u1[2])
        u2 = (0.5 * weight * residual[0], 0.5 * weight * residual[1], 0.5 * weight * residual[2])
        used = gain
        if limit > 0:
            x2, p2 = _dot(x, x), _dot(p, p)
            product = math.sqrt(x2 * p2) + math.sqrt((1 + x2) * (1 + p2))
            used = min(gain, limit / (dt * (vectors + 0.25 * weight * (1 + product))))
        omega = _plus((s[9], s[10], s[11]), -1.0, b1)
        v = _plus((s[12], s[13], s[14]), -1.0, b2)
        omega = _plus(omega, used, _unrotate(R, u1))
        v = _plus(v, used, _unrotate(R, _plus(u2, -1.0, _cross(P, u1))))
        omega, v = (dt * omega[0], dt * omega[1], dt * omega[2]), (dt * v[0], dt * v[1], dt * v[2])
        b1 = _plus(b1, -dt * gamma1, _unrotate(R, _plus(u1, -1.0, _cross(P, u2))))
        b2 = _plus(b2, -dt * gamma2, _unrotate(R, u2))
        # T exp([omega; v]^).
        angle2 = _dot(omega, omega)
        angle = math.sqrt(max(angle2, 1e-12))
        half = math.sin(angle / 2) / angle
        first = math.sin(angle) / angle
        third = (1 - angle2 / 20) / 6 if angle2 < 1e-4 else (1 - first) / angle2
        turned = _cross(omega, v)
        displacement = _plus(_plus(v, 2 * half * half, turned), third, _cross(omega, turned))
        P = _plus(P, 1.0, _rotate(R, displacement))
        tw, tx, ty, tz = math.cos(angle / 2), half * omega[0], half * omega[1], half * omega[2]
        w = q[0] * tw - q[1] * tx - q[2] * ty - q[3] * tz
        x_ = q[0] * tx + q[1] * tw + q[2] * tz - q[3] * ty
        y_ = q[0] * ty - q[1] * tz + q[2] * tw + q[3] * tx
        z_ = q[0] * tz + q[1] * ty - q[2] * tx + q[3] * tw
        unit = 1 / math.sqrt(w * w + x_ * x_ + y_ * y_ + z_ * z_)
        q = (unit * w, unit * x_, unit * y_, unit * z_)
    return cost


@numba.njit(parallel=True, fastmath=True)
def _population(samples, start, inputs, outputs, numbers):
    S, A = samples.shape[0], inputs.shape[0]
    costs = np.empty((S, A))
    for i in numba.prange(S * A):
        s, a = i // A, i % A
        costs[s, a] = _agent(samples[s], start[s], inputs[a], outputs[a], numbers)
    return costs
