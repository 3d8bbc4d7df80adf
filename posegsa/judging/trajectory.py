"""One simulation over time as a person looks at it: degrees, metres, and a table."""

import csv
import io
from dataclasses import dataclass, fields

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.config import Experiment
from posegsa.model.family import Family
from posegsa.model.filter import FilterSettings
from posegsa.model.rollout import Estimates, simulate
from posegsa.model.scenario import Scenario, Truth
from posegsa.model.schedules import GainSchedule
from posegsa.model.se3 import attitude_distance, euler_angles, quaternion, rotation_angle, unstack
from posegsa.model.signal import SignalSettings
from posegsa.search.build import family, filter_settings, prepare_scenario, signal_settings

_COLUMNS = {
    "time": ("time_s",),
    "euler": ("roll_deg", "pitch_deg", "yaw_deg"),
    "euler_est": ("roll_est_deg", "pitch_est_deg", "yaw_est_deg"),
    "position": ("x_m", "y_m", "z_m"),
    "position_est": ("x_est_m", "y_est_m", "z_est_m"),
    "bias_est": (
        *("bias_est_wx_rad_s", "bias_est_wy_rad_s", "bias_est_wz_rad_s"),
        *("bias_est_vx_m_s", "bias_est_vy_m_s", "bias_est_vz_m_s"),
    ),
    "attitude_error": ("attitude_error_deg",),
    "attitude_distance": ("attitude_distance",),
    "position_error": ("position_error_m",),
    "gain": ("gain_1_s",),
    "gain_used": ("gain_used_1_s",),
    "error": ("scaled_error",),
    "rate": ("scaled_rate",),
}


@dataclass(frozen=True)
class Trajectory:
    """Truth, estimates, errors and gain over N samples, as NumPy arrays."""

    time: np.ndarray
    """(N,) [s]."""
    euler: np.ndarray
    """(N, 3) true roll, pitch, yaw [deg]."""
    euler_est: np.ndarray
    """(N, 3) estimated roll, pitch, yaw [deg]."""
    position: np.ndarray
    """(N, 3) true position, inertial frame [m]."""
    position_est: np.ndarray
    """(N, 3) estimated position, inertial frame [m]."""
    bias_est: np.ndarray
    """(N, 6) estimated velocity bias, body frame [rad/s, m/s]."""
    attitude_error: np.ndarray
    """(N,) angle of R_est R^T [deg]."""
    attitude_distance: np.ndarray
    """(N,) ||R_est R^T||_I, in [0, 1]."""
    position_error: np.ndarray
    """(N,) ||P_est - R_err P|| [m]."""
    gain: np.ndarray
    """(N,) K that the schedule asked for [1/s]."""
    gain_used: np.ndarray
    """(N,) K after the gain limit, mean over the sub-steps [1/s]."""
    error: np.ndarray
    """(N,) the scaled error that the schedule saw, in [0, 1]."""
    rate: np.ndarray
    """(N,) the scaled rate that it saw, in [0, 1]."""

    def csv(self) -> str:
        """It as CSV, a row a sample; reading it back gives the same numbers."""
        parts = [np.reshape(getattr(self, name), (len(self.time), -1)) for name in _COLUMNS]
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow([column for group in _COLUMNS.values() for column in group])
        writer.writerows(np.concatenate(parts, axis=1).tolist())
        return text.getvalue()


def read_trajectory(text: str) -> Trajectory:
    """Read what `Trajectory.csv` gave.

    Raises:
        ValueError: Its columns are not a trajectory's.
    """
    try:
        header, *rows = csv.reader(io.StringIO(text, newline=""))
        table = np.array(rows, dtype=np.float64).reshape(len(rows), -1)
    except (csv.Error, ValueError) as error:
        raise ValueError(f"trajectory.csv: cannot be read as a trajectory: {error}") from None
    columns = [column for group in _COLUMNS.values() for column in group]
    if header != columns or len(rows) == 0 or table.shape[1] != len(columns):
        raise ValueError(f"trajectory.csv: its columns are not those of a trajectory: {header}")
    values, start = {}, 0
    for field in fields(Trajectory):
        width = len(_COLUMNS[field.name])
        part = table[:, start : start + width]
        values[field.name] = part[:, 0] if width == 1 else part
        start += width
    return Trajectory(**values)


def trajectory(truth: Truth, estimates: Estimates) -> Trajectory:
    """Errors and angles of estimates against the truth."""
    values = _values(truth, estimates)
    return Trajectory(**{name: np.asarray(value, np.float64) for name, value in values.items()})


@jax.jit
def _values(truth: Truth, estimates: Estimates) -> dict[str, Array]:
    w_est, x_est, y_est, z_est = unstack(quaternion(estimates.rotation))
    w, x, y, z = unstack(quaternion(truth.rotation))
    distance = attitude_distance((w_est, x_est, y_est, z_est), (w, x, y, z))
    R_err = jnp.einsum("nij,nkj->nik", estimates.rotation, truth.rotation, precision="highest")
    P_err = estimates.position - jnp.einsum(
        "nij,nj->ni", R_err, truth.position, precision="highest"
    )
    return {
        "time": truth.time,
        "euler": jnp.degrees(euler_angles(truth.rotation)),
        "euler_est": jnp.degrees(euler_angles(estimates.rotation)),
        "position": truth.position,
        "position_est": estimates.position,
        "bias_est": estimates.bias,
        "attitude_error": jnp.degrees(rotation_angle(distance)),
        "attitude_distance": distance,
        "position_error": jnp.linalg.norm(P_err, axis=-1),
        "gain": estimates.gain,
        "gain_used": estimates.gain_used,
        "error": estimates.error,
        "rate": estimates.rate,
    }


def simulate_scenario(
    schedule: GainSchedule, one: Scenario, experiment: Experiment, key: Array
) -> Trajectory:
    """Truth, estimates, errors and gain over time of one simulation.

    Args:
        schedule: The gain schedule.
        one: The scenario.
        experiment: Where the family and the filter's and signal's settings come from.
        key: Scenario key.
    """
    dtype = experiment.run.dtype
    settings = filter_settings(experiment)
    signal = signal_settings(experiment.gain, dtype)
    chosen = family(experiment, dtype)
    return trajectory(*_simulate_scenario(schedule, one, chosen, key, settings, signal))


@jax.jit
def _simulate_scenario(
    schedule: GainSchedule,
    one: Scenario,
    chosen: Family,
    key: Array,
    settings: FilterSettings,
    signal: SignalSettings,
) -> tuple[Truth, Estimates]:
    truth, prepared = prepare_scenario(one, chosen, settings, key)
    samples, initial = prepared["samples"], prepared["initial"]
    return truth, simulate(schedule, samples, initial, settings, signal)
