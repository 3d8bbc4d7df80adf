"""Attitude filters of other libraries on IMU recordings, each with the settings of its paper.

`pip install ".[compare]"` installs them. They read the accelerometer [m/s^2] and the magnetometer
of `Recording.sensors`, and start from the first samples of both. Their estimates are turned to the
inertial frame of the recording.

VQF       D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation
          and magnetic disturbance rejection", Information Fusion 91, 2023; package vqf, defaults
Madgwick  S. Madgwick, "An efficient orientation filter for inertial and inertial/magnetic sensor
          arrays", 2010: gain 0.041 rad/s; package ahrs
Mahony    R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special
          orthogonal group", IEEE Transactions on Automatic Control 53(5), 2008: k_P = 1 rad/s,
          k_I = 0.3 rad/s; package ahrs
"""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from posegsa.errors import ArgumentError, RecordingError
from posegsa.filters.rollout import Estimates
from posegsa.recordings.bridging import gaps_in
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import matrices, quaternions, to_east_north_up

Signals: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Gyroscope, accelerometer and magnetometer, each (K, 3)."""

MADGWICK_GAIN = 0.041
"""beta [rad/s] of the filter with magnetometer in Madgwick's report."""
MAHONY_GAINS = 1.0, 0.3
"""k_P, k_I [rad/s] of the experiments in Mahony's paper."""


def other_filter(name: str, recording: Recording) -> Estimates:
    """Estimates of one of `OTHER_FILTERS` on a recording: attitude only, the rest is NaN.

    Raises:
        ArgumentError: The filter's library is not installed.
        RecordingError: The recording lacks a signal that the filter needs.
    """
    signals = _signals(recording)
    # They take one time step for all samples, so that they start anew after a gap.
    parts = np.split(np.arange(recording.samples), gaps_in(recording.time)[0] + 1)
    gyr, acc, mag = signals
    each = ((gyr[part], acc[part], mag[part]) for part in parts)
    run = OTHER_FILTERS[name].run
    R = np.concatenate([run(part, recording.time_step) for part in each])
    R = to_east_north_up(recording.frame or "ENU").T @ R
    count = recording.samples
    nothing = np.full(count, np.nan)
    arrays: dict[str, Any] = {
        "time": recording.time,
        "rotation": R,
        "position": np.full((count, 3), np.nan),
        "bias": np.full((count, 6), np.nan),
        "vector_bias": np.zeros((count, 0, 3)),
        "gain": nothing,
        "gain_used": nothing,
        "error": nothing,
        "rate": nothing,
    }
    return Estimates(**arrays)


def installed(name: str) -> bool:
    """Whether the library of one of `OTHER_FILTERS` is installed."""
    return find_spec(OTHER_FILTERS[name].package) is not None


def readable(recording: Recording) -> bool:
    """Whether these filters can run on a recording."""
    return recording.attitude_only and {"accelerometer", "magnetometer"} <= set(recording.sensors)


def _vqf(signals: Signals, step: float) -> np.ndarray:
    filter_type = _imported("vqf", "VQF")
    contiguous = (np.ascontiguousarray(signal) for signal in signals)
    return matrices(np.asarray(filter_type(step).updateBatch(*contiguous)["quat9D"]))


def _madgwick(signals: Signals, step: float) -> np.ndarray:
    made = _imported("ahrs.filters", "Madgwick")(frequency=1 / step, gain=MADGWICK_GAIN)
    to_east = to_east_north_up("NWU")
    return to_east @ _sample_by_sample(made, signals, to_east.T)


def _mahony(signals: Signals, step: float) -> np.ndarray:
    k_p, k_i = MAHONY_GAINS
    made = _imported("ahrs.filters", "Mahony")(frequency=1 / step, k_P=k_p, k_I=k_i)
    return _sample_by_sample(made, signals, np.eye(3))


def _sample_by_sample(made: Any, signals: Signals, frame: np.ndarray) -> np.ndarray:
    """Run a filter of ahrs; rotations (K, 3, 3), body to its own inertial frame.

    `frame` (3, 3) rotates x east, y north, z up to that frame.
    """
    gyr, acc, mag = signals
    q = np.empty((len(gyr), 4))
    q[0] = quaternions(frame @ _initial_rotation(acc[0], mag[0]))
    for k in range(1, len(gyr)):
        q[k] = made.updateMARG(q[k - 1], gyr=gyr[k], acc=acc[k], mag=mag[k])
    return matrices(q)


def _initial_rotation(acc: np.ndarray, mag: np.ndarray) -> np.ndarray:
    """The rotation, body to east-north-up, from one accelerometer and magnetometer sample."""
    up = acc / np.linalg.norm(acc)
    east = np.cross(mag, up)
    east = east / np.linalg.norm(east)
    return np.stack([east, np.cross(up, east), up])


class OtherFilter(NamedTuple):
    """A filter of another library."""

    package: str
    """The package that it is imported from."""
    run: Callable[[Signals, float], np.ndarray]
    """Of the signals and the time step [s]; rotations (K, 3, 3), body to x east, y north
    (magnetic), z up."""


OTHER_FILTERS = {
    "VQF": OtherFilter("vqf", _vqf),
    "Madgwick": OtherFilter("ahrs", _madgwick),
    "Mahony": OtherFilter("ahrs", _mahony),
}


def _signals(recording: Recording) -> Signals:
    if not readable(recording):
        raise RecordingError(
            f"{recording.name}: other filters need a recording of attitude only, with sensors "
            f"accelerometer and magnetometer; it has: {', '.join(recording.sensors) or 'none'}"
        )
    gyr = np.asarray(recording.measurements.angular_velocity)
    acc, mag = (_filled(recording.sensors[name]) for name in ("accelerometer", "magnetometer"))
    return gyr, acc, mag


def _filled(signal: np.ndarray) -> np.ndarray:
    """A signal (K, 3) whose missing samples hold the last value, or before it the first value."""
    known = np.flatnonzero(np.isfinite(signal).all(axis=1))
    if known.size == 0:
        raise RecordingError("sensors: a signal is missing at all samples")
    last = np.searchsorted(known, np.arange(len(signal)), side="right") - 1
    return signal[known[np.maximum(last, 0)]]


def _imported(module: str, name: str) -> Any:
    try:
        return getattr(__import__(module, fromlist=[name]), name)
    except ImportError as error:
        raise ArgumentError(
            f"{module.partition('.')[0]} is not installed ({error}); allowed: after "
            'pip install ".[compare]"'
        ) from None
