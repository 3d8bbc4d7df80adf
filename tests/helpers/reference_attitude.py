"""The attitude filter in NumPy, with matrices, rotation vectors and vectors: nothing is shared."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

UP = np.array([0.0, 0.0, 1.0])
NORTH = np.array([0.0, 1.0, 0.0])
PAUSE = 0.2501


def smallest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes the direction of a to that of b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, a @ b)
    return Rotation.from_rotvec(angle * axis / sine if sine > 0 else np.zeros(3)).as_matrix()


def attitudes(
    numbers: dict[str, float],
    gyr: np.ndarray,
    acc: np.ndarray,
    mag: np.ndarray,
    steps: np.ndarray,
    *,
    before: bool,
    gravity: float = 9.81,
) -> dict[str, np.ndarray]:
    """Attitudes (K + 1, 3, 3), biases (K + 1, 3) and more before each sample and after the last.

    In axes east, north, up; NaN in acc or mag marks a missing sample. The loop begins with the
    identity and the bias 0.
    """
    n = numbers
    P = np.diag([0.35**2] * 2 + [1.0] + [n["initial_bias"] ** 2] * 3 + [1.0] * 2)
    R = shown = np.eye(3)
    b, v = np.zeros(3), np.zeros(2)
    f: Any = None
    c = np.zeros(3)
    parts = off = np.zeros(2)
    parts_time = age = still = last = gap = refused = doubted = astray = 0.0
    upwards = 1.0
    belief = 0.0
    slow: Any = None
    found: dict[str, list[Any]] = {"R": [shown], "b": [b], "belief": [0.0], "rest": [False]}
    for w_m, a, m, dt in zip(gyr, acc, mag, steps, strict=True):
        R = R @ Rotation.from_rotvec(last * (w_m - b)).as_matrix() if before else shown
        lasting = min(dt, PAUSE)
        felt = bool(np.isfinite(a).all() and np.linalg.norm(a) < n["outlier"] * gravity)
        length = np.linalg.norm(a)
        if slow is None and not 0.5 * gravity < length < 2 * gravity:
            felt = False
        if felt and slow is None:
            R = smallest(R @ a, UP) @ R
            slow = w_m, a
        elif slow is not None:
            k = lasting / (0.5 + lasting)
            slow = slow[0] + k * (w_m - slow[0]), slow[1] + k * (a - slow[1]) if felt else slow[1]
        w = w_m - b
        is_still = (
            slow is not None
            and np.linalg.norm(w_m - slow[0]) < np.deg2rad(2)
            and (not felt or np.linalg.norm(a - slow[1]) < 0.5)
            and np.linalg.norm(slow[0]) < np.deg2rad(6)
        )
        still = still + lasting if is_still else 0.0
        seen = slow is not None and bool(np.isfinite(m).all())
        anew, wrong = f is None, False
        if seen and f is not None:
            fits = bool(np.linalg.norm(m) < n["outlier"] * np.linalg.norm(parts))
            believed = age - doubted
            wrong = not fits and refused >= max(age, 1.0)
            wrong |= doubted >= max(believed, 1.0) and believed < 10
            anew = wrong
            seen = fits or anew
        since = lasting + min(gap, PAUSE)
        gap = 0.0 if seen else gap + dt
        refused = 0.0 if seen else refused + (lasting if np.isfinite(m).all() else 0.0)
        if seen:
            first = anew
            if first:
                parts_time = age = 0.0
                level = R @ m - (R @ m)[2] * UP
                to_north = smallest(level, NORTH)
                R = to_north @ R
                v = to_north[:2, :2] @ v
                both = np.eye(8)
                both[:3, :3], both[6:, 6:] = to_north, to_north[:2, :2]
                P = both @ P @ both.T
                P[2, :] = P[:, 2] = 0.0
                P[2, 2] = 1.0
                f, off = np.zeros(3), np.zeros(2)
                if wrong:
                    c = np.zeros(3)
            delay = n["magnetometer_delay"]
            late = 0.0 if first else delay / max(1.0, delay * float(np.linalg.norm(w)))
            earthly = R @ (m - c - late * np.cross(w, R.T @ f))
            now = np.array([np.hypot(earthly[0], earthly[1]), earthly[2]])
            if first:
                parts = now
            off = off + since / (0.1 + since) * ((now - parts) / np.linalg.norm(parts) - off)
            belief = 1 / (1 + (off @ off) / n["field_tolerance"] ** 2)
            follow = n["disbelieved"] + (1 - n["disbelieved"]) * belief
            gate = min(np.linalg.norm(w) / 0.5, 1.0) * follow
            residual = earthly - f
            f = f + max(since / (n["field_time"] + since), since / (age + since + 1e-9)) * residual
            if not first:
                c = c + min(since * gate / n["iron_time"], 1.0) * R.T @ residual
            parts_time = min(parts_time + since * gate, n["field_memory"])
            parts = parts + min(since * gate / (parts_time + 1e-6), 1.0) * (now - parts)
            age = age + since
            doubted = 0.0 if first or off @ off < 0.25 else doubted + since
        resting = still >= 1.4999
        if astray >= 3.0:
            P[2, :] = P[:, 2] = 0.0
            P[2, 2] = 1.0
        rows, residuals, variances = [], [], []
        if felt:
            spread = 0.05 if resting else n["velocity"]
            rows += [np.eye(8)[6], np.eye(8)[7]]
            residuals += [-v[0], -v[1]]
            variances += [spread**2 / lasting] * 2
        if seen:
            length = np.hypot(f[0], f[1])
            sine = f[0] / length if f[1] > 0 else (1.0 if f[0] >= 0 else -1.0)
            tilt = (
                0.5 * n["inclination_in_heading"] * (parts[1] / parts[0]) ** 2 * (P[0, 0] + P[1, 1])
            )
            rows.append(np.eye(8)[2])
            residuals.append(sine)
            variances.append(n["heading"] ** 2 / (since * belief) + tilt)
        if resting:
            rows += list(np.eye(8)[3:6])
            residuals += list(w)
            variances += [n["rest_bias"] ** 2 / lasting] * 3
        x = np.zeros(8)
        if rows:
            H = np.array(rows)
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(variances))
            x = gain @ np.array(residuals)
            P = (np.eye(8) - gain @ H) @ P
        turn = Rotation.from_quat([*(0.5 * x[:3]), 1.0]).as_matrix()  # normalised by SciPy
        R, b, v = turn @ R, np.clip(b + x[3:6], -np.deg2rad(6), np.deg2rad(6)), v + x[6:]
        if f is not None:
            f = turn @ f
        pull = lasting if felt else 0.0
        if felt:
            v = v + lasting * (R @ a)[:2]
            upwards += lasting / 1.5 * (np.clip((R @ a)[2] / gravity, -1, 1) - upwards)
        speed = np.linalg.norm(w)
        shown = R @ Rotation.from_rotvec(dt * (w_m - b)).as_matrix()
        F = np.eye(8)
        F[:3, 3:6] = -dt * R
        F[6, 1], F[7, 0] = pull * gravity, -pull * gravity
        noise = n["angular_velocity"] ** 2 + (n["turning"] * speed) ** 2
        more = (n["turning_heading"] * speed) ** 2
        densities = [noise, noise, noise + more, *[n["angular_walk"] ** 2] * 3, *[0.03**2] * 2]
        P = F @ P @ F.T + dt * np.diag(densities)
        last = dt
        if seen:
            straight = f[1] >= np.cos(np.deg2rad(45)) * np.hypot(f[0], f[1])
            astray = 0.0 if straight else astray + (since if belief > 0.5 else 0.0)
        lost = upwards < -0.05
        if dt > PAUSE or lost:
            f, slow, still, v, upwards = None, None, 0.0, np.zeros(2), 1.0
            kept = n["initial_bias"] ** 2 * np.eye(3) if lost else P[3:6, 3:6]
            b, c = (np.zeros(3), np.zeros(3)) if lost else (b, c)
            P = np.diag([0.35**2] * 2 + [1.0] + [0.0] * 3 + [1.0] * 2)
            P[3:6, 3:6] = kept
        for name, value in (("R", shown), ("b", b), ("belief", belief), ("rest", resting)):
            found[name].append(value)
    return {name: np.array(values) for name, values in found.items()} | {"P": P}
