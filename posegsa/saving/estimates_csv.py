"""Estimates on a recording as a CSV file, for other programs."""

from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike

from posegsa.judging.replayed import Replay, attitude_sigmas, position_sigmas, roll_pitch_yaw
from posegsa.recordings.rotations import quaternions

AXES = "xyz"


def csv_text(replay: Replay) -> str:
    """A line for each sample: the estimate at its stamp, before what is measured there.

    The columns, with units at the end of their names, are the recording's own time stamp (s, or ns
    where stamps are integers); R, body to inertial, as a quaternion (w, x, y, z) and as Euler
    angles, R = Rz(yaw) Ry(pitch) Rx(roll); the position; the biases of the gyroscope, of the
    velocity and of each vector, in its unit; and the standard deviations of heading, inclination
    and position, where the filter states them.
    """
    recording, estimates = replay.recording, replay.estimates
    has_position = not recording.attitude_only
    bias = np.asarray(estimates.bias)
    q = quaternions(np.asarray(estimates.rotation))
    columns = _named([f"q{axis}" for axis in "wxyz"], q)
    columns |= _named(["roll_deg", "pitch_deg", "yaw_deg"], roll_pitch_yaw(estimates.rotation))
    if has_position:
        columns |= _named([f"{axis}_m" for axis in AXES], estimates.position)
    columns |= _named([f"bias_w{axis}_rad_s" for axis in AXES], bias[:, :3])
    if has_position:
        columns |= _named([f"bias_v{axis}_m_s" for axis in AXES], bias[:, 3:])
    for number in range(np.shape(estimates.vector_bias)[1]):
        names = [f"bias_v{number}_{axis}" for axis in AXES]
        columns |= _named(names, estimates.vector_bias[:, number])
    if (sigmas := attitude_sigmas(estimates)) is not None:
        columns |= _named(["heading_sigma_deg", "inclination_sigma_deg"], sigmas)
    if has_position and (sigmas := position_sigmas(estimates)) is not None:
        columns |= _named([f"{axis}_sigma_m" for axis in AXES], sigmas)
    stamps = recording.stamps
    time, digits = ("time_ns", "%d") if stamps.dtype.kind == "i" else ("time_s", "%.9f")
    line = ",".join([digits, *["%.9g"] * len(columns)])
    table = zip(stamps.tolist(), *(column.tolist() for column in columns.values()), strict=True)
    return "\n".join([",".join([time, *columns]), *(line % row for row in table), ""])


def _named(names: Sequence[str], values: ArrayLike) -> dict[str, np.ndarray]:
    """Columns (K,) of values (K, n), by name."""
    return dict(zip(names, np.asarray(values).T, strict=True))
