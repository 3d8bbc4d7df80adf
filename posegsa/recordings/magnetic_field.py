"""Weights of the magnetic field by how well it fits its reference.

The length of the earth's field and its angle to the horizontal (dip) do not depend on the body's
attitude; iron and currents change both. So horizontal and vertical parts h and v of the field, with
the low-passed acceleration as the vertical, are compared with those of a reference:

    d = |(h, v) - (h_ref, v_ref)| / |(h_ref, v_ref)|,   weight = 1 / (1 + (d / tolerance)^2)

Both parts are low-passed first, so noise of single samples does not count as a disturbance. With a
recovery time, d decays no faster than with that time constant, so the weight recovers slowly after
a disturbance. The weight is never 0, so the filter eventually follows a field that has changed
permanently.
"""

import numpy as np

from posegsa.recordings.inertial_frame import held

SMOOTHING = 0.1
"""Time constant of the low-pass filter of both parts [s]."""


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
    """Means (K, 2) of parts (K, 2) up to each sample, at least over `first`; NaN is ignored."""
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
    """Weights (K,) in (0, 1] of the samples of the field.

    Args:
        parts: (K, 2) horizontal and vertical part; NaN where missing, there the last ones are held.
        reference: (2,) or (K, 2) of both parts.
        time_step: of all samples [s].
        tolerance: d at which the weight is 1/2.
        recovery: shortest time constant with which d decays [s]; 0 for no limit.
    """
    from scipy.signal import lfilter  # not at the top: takes a while to load

    known = np.all(np.isfinite(parts), axis=1)
    size = np.linalg.norm(np.broadcast_to(reference, parts.shape), axis=1, keepdims=True)
    off = held((parts - reference) / size, known, np.zeros(2))
    new = time_step / (SMOOTHING + time_step)
    distance = np.linalg.norm(lfilter([new], [1, new - 1], off, axis=0), axis=1)
    if recovery > 0:
        # The maximum of all d_j exp(-(t - t_j) / recovery); logarithms avoid overflow.
        age = np.arange(len(distance)) * (time_step / recovery)
        logarithm = np.log(np.maximum(distance, np.finfo(float).tiny))
        distance = np.exp(np.maximum.accumulate(logarithm + age) - age)
    return 1 / (1 + (distance / tolerance) ** 2)
