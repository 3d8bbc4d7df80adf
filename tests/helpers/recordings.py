"""Short recorded motions as arrays."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

RATE = 100.0
GRAVITY, EAST = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
LANDMARKS = np.array([[3.0, 1.0, 2.0], [-2.0, 4.0, 1.0], [1.0, -3.0, 0.5]])


def motion(samples: int = 400, **changes: Any) -> dict[str, Any]:
    """Arguments of `from_arrays`: a body that rests for 1 s, then rotates; without noise.

    The gyroscope's bias is 0.02 rad/s about x. `None` removes an argument.
    """
    time = np.arange(samples) / RATE
    moving = np.clip(time - 1.0, 0.0, None)
    R = Rotation.from_euler("zx", np.stack([0.4 + 0.8 * moving, 0.2 + 0.5 * moving], axis=1))
    matrix = R.as_matrix()
    omega = np.zeros((samples, 3))
    omega[:-1] = (R[:-1].inv() * R[1:]).as_rotvec() * RATE
    position = np.stack([1.0 + 0.1 * moving, 0 * time, 2 + 0 * time], axis=1)
    velocity = np.einsum("kji,kj->ki", matrix, np.gradient(position, 1 / RATE, axis=0))
    known = np.stack([GRAVITY, EAST])
    given = {
        "time": np.round(time * 1e9).astype(np.int64) + 1_403_715_523_912_143_104,
        "angular_velocity": omega + np.array([0.02, 0, 0]),
        "velocity": velocity,
        "vectors": np.einsum("kji,nj->kni", matrix, known),
        "vector_references": known,
        "landmarks": np.einsum("kji,knj->kni", matrix, LANDMARKS - position[:, None]),
        "landmark_references": LANDMARKS,
        "truth_rotation": matrix,
        "truth_position": position,
        "phases": {"rest": time < 1, "motion": time >= 1},
    }
    return {name: value for name, value in (given | changes).items() if value is not None}


def bench(samples: int = 200, **changes: Any) -> dict[str, Any]:
    """`motion` with the sensors of the default scenario: two vectors and one landmark."""
    seen = motion(samples)["landmarks"][:, :1]
    return motion(samples, **{"landmarks": seen, "landmark_references": LANDMARKS[:1]} | changes)


# An inertial sensor -------------------------------------------------------------------------------

FIELD = np.array([0.0, 20.0, -40.0])
"""Magnetic field: east, north, up [uT]."""
BIAS = np.array([0.01, -0.02, 0.015])
"""Bias of the gyroscope [rad/s]."""
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
    """Arguments of `posegsa.imu`: a body that rests, then rotates about changing axes.

    The angular velocity at a sample is the mean since the previous one, as measured by integrating
    gyroscopes. `shaking` is the amplitude of a translation's acceleration [m/s^2] at 0.7 Hz,
    `noise` a factor on the noise of all sensors.
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
