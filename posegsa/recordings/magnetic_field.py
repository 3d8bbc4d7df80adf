"""How far the measured magnetic field can be trusted.

The earth's field has one length and one angle to the horizontal (dip) wherever the body turns; iron
and currents change both. So the field is compared with a reference by its horizontal and vertical
parts h and v, with the low-passed acceleration as the vertical:

    d = |(h, v) - (h_ref, v_ref)| / |(h_ref, v_ref)|,   weight = 1 / (1 + (d / tolerance)^2)

Both parts are smoothed over SMOOTHING first, so that noise of single samples is no disturbance.
With a recovery time, d falls no faster than by that time constant: after a disturbance the weight
comes back slowly. It is never 0, so that a field that has changed for good is believed in the end.
"""

import numpy as np

from posegsa.recordings.inertial_frame import held

SMOOTHING = 0.1
"""Time constant of the low-pass filter that both parts pass [s]."""


def field_parts(field: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Horizontal and vertical part (K, 2) of a field (K, 3), upwards positive.

    Args:
        field: any unit and frame.
        up: (K, 3) in the same frame, of any length; NaN or 0 makes the parts NaN.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        vertical = np.sum(field * up, axis=1) / np.linalg.norm(up, axis=1)
        square = np.sum(field * field, axis=1) - vertical**2
    return np.stack([np.sqrt(np.maximum(square, 0.0)), vertical], axis=1)


def mean_so_far(parts: np.ndarray, first: int) -> np.ndarray:
    """Means (K, 2) of parts (K, 2) up to each sample, at least of `first`; NaN is passed over."""
    known = np.isfinite(parts).all(axis=1, keepdims=True)
    count = np.maximum(np.cumsum(known, axis=0), 1)
    means = np.cumsum(np.where(known, parts, 0.0), axis=0) / count
    means[: first - 1] = means[first - 1]
    return means


def field_weights(
    parts: np.ndarray,
    reference: np.ndarray,
    time_step: float,
    *,
    tolerance: float,
    recovery: float,
) -> np.ndarray:
    """Weights (K,) in (0, 1] of samples of the field.

    Args:
        parts: (K, 2) horizontal and vertical part; NaN where missing, which changes nothing.
        reference: (2,) or (K, 2) of both.
        time_step: of all samples [s].
        tolerance: d at which the weight is 1/2.
        recovery: time constant with which d is forgotten [s]; 0 at once.
    """
    from scipy.signal import lfilter  # not at the top: takes a while to load

    known = np.all(np.isfinite(parts), axis=1)
    size = np.linalg.norm(np.broadcast_to(reference, parts.shape), axis=1, keepdims=True)
    off = held((parts - reference) / size, known, np.zeros(2))
    new = time_step / (SMOOTHING + time_step)
    distance = np.linalg.norm(lfilter([new], [1, new - 1], off, axis=0), axis=1)
    if recovery > 0:
        # The largest of all d_j exp(-(t - t_j) / recovery), by logarithms: these do not overflow.
        age = np.arange(len(distance)) * (time_step / recovery)
        logarithm = np.log(np.maximum(distance, np.finfo(float).tiny))
        distance = np.exp(np.maximum.accumulate(logarithm + age) - age)
    return 1 / (1 + (distance / tolerance) ** 2)
