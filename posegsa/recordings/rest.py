"""Detection of rest at the start of a recording.

The body is at rest while gyroscope and accelerometer, each averaged over WINDOW, stay within a
threshold of their means over the first SHORTEST (thresholds of VQF: D. Laidig, T. Seel, "VQF",
Information Fusion 91, 2023). At rest the gyroscope measures its bias.
"""

import numpy as np

WINDOW = 0.25
"""Time over which signals are averaged [s]."""
SHORTEST = 1.0
"""Shortest rest that is detected [s]."""
MARGIN = 0.5
"""Time cut off at the end of a rest, where the motion may have begun already [s]."""
TURNING = np.deg2rad(2.0)
"""Largest deviation of the angular velocity [rad/s]."""
ACCELERATION = 0.5
"""Largest deviation of the acceleration [m/s^2]."""
LARGEST_BIAS = np.deg2rad(6.0)
"""Maximum bias of a gyroscope [rad/s]; above it the body turns at a constant rate."""


def rest_at_start(gyr: np.ndarray, acc: np.ndarray, time_step: float) -> int:
    """Number of samples at rest at the start of a recording; 0 if it begins in motion.

    Args:
        gyr: (K, 3) angular velocity [rad/s].
        acc: (K, 3) acceleration [m/s^2]; NaN is ignored.
        time_step: of all samples [s].
    """
    window = max(1, round(WINDOW / time_step))
    blocks = len(gyr) // window
    least = max(1, round(SHORTEST / WINDOW))
    if blocks < least:
        return 0
    rests = np.ones(blocks, bool)
    for signal, largest in ((gyr, TURNING), (acc, ACCELERATION)):
        parts = signal[: blocks * window].reshape(blocks, window, 3)
        known = np.all(np.isfinite(parts), axis=2, keepdims=True)
        count = np.maximum(known.sum(axis=1), 1)
        means = np.where(known, parts, 0.0).sum(axis=1) / count
        seen = np.any(known, axis=(1, 2))
        first = means[:least][seen[:least]]
        if not len(first):
            return 0
        deviation = np.linalg.norm(means - first.mean(axis=0), axis=1)
        rests &= ~seen | (deviation <= largest)
    length = blocks if rests.all() else int(np.argmin(rests))
    samples = length * window - (0 if rests.all() else round(MARGIN / time_step))
    if length < least or samples < least * window:
        return 0
    if np.linalg.norm(gyr[:samples].mean(axis=0)) > LARGEST_BIAS:
        return 0
    return samples
