"""The frame that results from integrating the angular velocity from the first sample on."""

import math

import numpy as np

from posegsa.recordings.rotations import matrices, product


def strapdown(angular_velocity: np.ndarray, time_step: np.ndarray) -> np.ndarray:
    """Rotations (K, 3, 3) from the body at each sample to S, the body frame at the first one.

    Args:
        angular_velocity: (K, 3) from each sample to the next, without its bias, body frame [rad/s].
        time_step: (K,) to the next sample [s].
    """
    return matrices(turned(angular_velocity * time_step[:, None]))


def turned(angles: np.ndarray) -> np.ndarray:
    """Products (K, 4) of the rotations by all angles (K, 3) [rad] before each sample."""
    angle = np.linalg.norm(angles, axis=1, keepdims=True)
    # sin(a / 2) / a, with np.sinc(x) = sin(pi x) / (pi x)
    imaginary = 0.5 * np.sinc(angle / (2 * np.pi)) * angles
    steps = np.concatenate([np.cos(0.5 * angle), imaginary], axis=1)
    start = np.array([[1.0, 0.0, 0.0, 0.0]])
    return running_products(np.concatenate([start, steps[:-1]]))


def running_products(steps: np.ndarray) -> np.ndarray:
    """Products q_0 q_1 ... q_k (K, 4) of unit quaternions (K, 4), of length one.

    Blocks of about sqrt(K) samples are multiplied in parallel, then joined: 2 sqrt(K) products of
    arrays instead of K products of single quaternions.
    """
    count = len(steps)
    length = math.ceil(math.sqrt(count))
    blocks = np.zeros((math.ceil(count / length) * length, 4))
    blocks[:, 0] = 1.0
    blocks[:count] = steps
    blocks = blocks.reshape(-1, length, 4)
    for k in range(1, length):
        blocks[:, k] = product(blocks[:, k - 1], blocks[:, k])
    before = np.zeros((len(blocks), 4))
    before[0, 0] = 1.0
    for k in range(1, len(blocks)):
        joined = product(before[k - 1], blocks[k - 1, -1])
        before[k] = joined / np.linalg.norm(joined)
    q = product(before[:, None], blocks).reshape(-1, 4)[:count]
    return q / np.linalg.norm(q, axis=1, keepdims=True)
