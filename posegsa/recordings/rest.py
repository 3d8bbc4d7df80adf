"""Whether a recording begins at rest, and for how long.

The body rests while neither gyroscope nor accelerometer, each averaged over WINDOW, leaves its mean
of the first LEAST by more than a threshold (those of VQF: D. Laidig, T. Seel,
"VQF", Information Fusion 91, 2023). What a resting gyroscope measures is its bias.
"""

import numpy as np

WINDOW = 0.25
"""Time over which signals are averaged [s]."""
LEAST = 1.0
"""Shortest rest [s]."""
MARGIN = 0.5
"""What is left out at the end, where the motion may have begun [s]."""
TURNING = np.deg2rad(2.0)
"""Largest deviation of the angular velocity [rad/s]."""
ACCELERATION = 0.5
"""Largest deviation of the acceleration [m/s^2]."""
LARGEST_BIAS = np.deg2rad(6.0)
"""No gyroscope at rest measures more than this [rad/s]; a body that turns evenly does."""


def rest_at_start(gyr: np.ndarray, acc: np.ndarray, time_step: float) -> int:
    """Number of samples at rest that a recording begins with; 0 if it begins in motion.

    Args:
        gyr: (K, 3) angular velocity [rad/s].
        acc: (K, 3) acceleration [m/s^2]; NaN is passed over.
        time_step: of all samples [s].
    """
    window = max(1, round(WINDOW / time_step))
    blocks = len(gyr) // window
    least = max(1, round(LEAST / WINDOW))
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
