"""Low-pass filter for the acceleration, in an almost inertial frame.

Over seconds the specific force is gravity plus a motion that averages out, so its mean is a better
direction of gravity than a single sample. In the body frame gravity turns with the body. In the
frame S that results from integrating the gyroscope it is constant, except for the gyroscope's bias.
So it is low-passed in S and then rotated back into the body frame (D. Laidig, T. Seel, "VQF: Highly
accurate IMU orientation estimation with bias estimation and magnetic disturbance rejection",
Information Fusion 91, 2023). The filter is causal and
needs no estimate of the attitude.
"""

import math

import numpy as np

from posegsa.recordings.rotations import matrices, product


def strapdown(angular_velocity: np.ndarray, time_step: np.ndarray) -> np.ndarray:
    """Rotations (K, 3, 3) from the body at each sample to S, the body frame at the first one.

    Args:
        angular_velocity: (K, 3) from each sample to the next, without its bias, body frame [rad/s].
        time_step: (K,) to the next sample [s].
    """
    turned = angular_velocity * time_step[:, None]
    angle = np.linalg.norm(turned, axis=1)
    # sin(a / 2) / a, with np.sinc(x) = sin(pi x) / (pi x)
    imaginary = 0.5 * np.sinc(angle / (2 * np.pi))[:, None] * turned
    steps = np.concatenate([np.cos(0.5 * angle)[:, None], imaginary], axis=1)
    start = np.array([[1.0, 0.0, 0.0, 0.0]])
    return matrices(running_products(np.concatenate([start, steps[:-1]])))


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


def low_passed(
    values: np.ndarray, time_constant: float, time_step: float, start: np.ndarray
) -> np.ndarray:
    """Values (K, 3) after a second-order Butterworth filter, initially settled at `start` (3,).

    Its cut-off frequency is sqrt(2) / (2 pi time constant), as in VQF: it damps noise like a
    first-order filter with this time constant. A time constant of 0 changes nothing.

    Args:
        values: without NaN.
        time_constant: [s].
        time_step: of all samples [s].
        start: (3,) the value before the first sample.
    """
    from scipy.signal import lfilter  # not at the top: takes a while to load

    if time_constant == 0:
        return values
    # At most 0.45 of the sampling rate, for time constants that are too short for it.
    cut_off = min(math.sqrt(2) / (2 * math.pi * time_constant), 0.45 / time_step)
    # The analog filter 1 / (s^2 + sqrt(2) s + 1), by the bilinear transform.
    c = 1 / math.tan(math.pi * cut_off * time_step)
    gain = 1 / (1 + math.sqrt(2) * c + c * c)
    feedback = 2 * gain * (1 - c * c), gain * (1 - math.sqrt(2) * c + c * c)
    settled = np.outer([1 - gain, gain - feedback[1]], start)
    forward, back = [gain, 2 * gain, gain], [1, *feedback]
    return lfilter(forward, back, values, axis=0, zi=settled)[0]


def held(values: np.ndarray, known: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Values (K, ...) with unknown ones replaced by the last known one, or by `start`."""
    latest = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where((latest >= 0).reshape(-1, *[1] * (values.ndim - 1)), values[latest], start)
