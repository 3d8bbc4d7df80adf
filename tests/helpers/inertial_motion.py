"""A motion as an inertial sensor measures it."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

RATE = 100.0
FIELD = np.array([0.0, 20.0, -40.0])
"""East, north, up [uT]."""
BIAS = np.array([0.01, -0.02, 0.015])
"""Of the gyroscope [rad/s]."""
ENU_TO = {
    "ENU": np.eye(3),
    "NED": np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]]),
    "NWU": np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]),
}


def inertial_motion(
    rest: float = 3.0,
    moving: float = 6.0,
    *,
    rate: float = RATE,
    noise: float = 0.0,
    shaking: float = 0.0,
    frame: str = "ENU",
    seed: int = 0,
) -> dict[str, Any]:
    """Arguments of `posegsa.imu`: a body that rests, then turns about changing axes.

    The angular velocity at a sample is the mean since the one before, as gyroscopes that integrate
    give it. `shaking` is the amplitude of a translation's acceleration [m/s^2] at 0.7 Hz, `noise` a
    factor on the noise of all sensors.
    """
    samples = round((rest + moving) * rate)
    time = np.arange(samples) / rate
    t = np.clip(time - rest, 0.0, None)
    ease = np.minimum(t, 1.0)
    angles = np.stack([0.4 + ease * np.sin(1.3 * t), ease * np.sin(0.9 * t), -0.3 * ease * t], 1)
    R = Rotation.from_euler("xyz", angles)
    omega = np.zeros((samples, 3))
    omega[1:] = (R[:-1].inv() * R[1:]).as_rotvec() * rate
    wave = shaking * ease * np.sin(2 * np.pi * 0.7 * t)
    force = np.stack([wave, 0.5 * wave, 9.81 + wave], axis=1)
    draw = np.random.default_rng(seed).normal
    matrix = R.as_matrix()
    return {
        "gyr": omega + BIAS + noise * 0.01 * draw(size=(samples, 3)),
        "acc": np.einsum("kji,kj->ki", matrix, force) + noise * 0.1 * draw(size=(samples, 3)),
        "mag": np.einsum("kji,j->ki", matrix, FIELD) + noise * 0.3 * draw(size=(samples, 3)),
        "rate": rate,
        "truth_rotation": ENU_TO[frame] @ matrix,
        "judged": time >= rest,
    }
