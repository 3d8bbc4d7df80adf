"""A simulation in a person's units: degrees, metres, a table that reads back."""

from collections.abc import Callable
from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from builders import random_poses
from scipy.spatial.transform import Rotation

from posegsa.judging.trajectory import Trajectory, read_trajectory, trajectory
from posegsa.model.rollout import Estimates
from posegsa.model.scenario import Truth

N = 40


def true_and_estimated(dtype: str) -> tuple[np.ndarray, np.ndarray, Trajectory]:
    """Random poses T and T_est (N, 4, 4), and the trajectory of them."""
    rng = np.random.default_rng(0)
    T, T_est = random_poses(rng, N), random_poses(rng, N)
    with jax.enable_x64(dtype == "float64"):
        time, gain, used, error, rate = (jnp.asarray(x, dtype) for x in rng.random((5, N)))
        R, P, R_est, P_est = (
            jnp.asarray(part, dtype)
            for pose in (T, T_est)
            for part in (pose[:, :3, :3], pose[:, :3, 3])
        )
        still = jnp.zeros_like(P)
        bias = jnp.asarray(rng.normal(size=(N, 6)), dtype)
        estimates = Estimates(time, R_est, P_est, bias, gain, used, error, rate)
        made = trajectory(Truth(time, R, P, still, still), estimates)
    return T, T_est, made


def test_errors_against_the_reference() -> None:
    T, T_est, made = true_and_estimated("float64")
    distance, position = np.transpose(
        [reference.pose_errors(*pair) for pair in zip(T_est, T, strict=True)]
    )
    np.testing.assert_allclose(made.attitude_distance, distance, rtol=1e-12)
    np.testing.assert_allclose(made.position_error, position, rtol=1e-12)
    R_err = T_est[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    angle = np.degrees(Rotation.from_matrix(R_err).magnitude())
    # Near 180 degrees the distance hardly depends on the angle: roundings of 1e-16 show as 1e-7.
    np.testing.assert_allclose(made.attitude_error, angle, rtol=0, atol=1e-6)


def test_angles_are_roll_pitch_and_yaw_in_degrees() -> None:
    T, T_est, made = true_and_estimated("float64")
    for ours, poses in ((made.euler, T), (made.euler_est, T_est)):
        yaw_pitch_roll = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX", degrees=True)
        np.testing.assert_allclose(ours, yaw_pitch_roll[:, ::-1], rtol=0, atol=1e-9)
    assert np.abs(made.euler).max() > 90


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_everything_else_is_taken_as_it_is(dtype: str) -> None:
    T, T_est, made = true_and_estimated(dtype)
    np.testing.assert_array_equal(made.position, T[:, :3, 3].astype(dtype))
    np.testing.assert_array_equal(made.position_est, T_est[:, :3, 3].astype(dtype))
    assert all(getattr(made, field.name).dtype == np.float64 for field in fields(Trajectory))
    shapes = {field.name: getattr(made, field.name).shape[1:] for field in fields(Trajectory)}
    vectors = {"euler": (3,), "euler_est": (3,), "position": (3,), "position_est": (3,)}
    assert shapes == dict.fromkeys(shapes, ()) | vectors | {"bias_est": (6,)}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_table_reads_back_exactly(dtype: str) -> None:
    _, _, made = true_and_estimated(dtype)
    # A filter that diverged is a trajectory too.
    made = replace(
        made,
        gain=np.append(made.gain[1:], np.inf),
        position_error=np.append(np.nan, made.position_error[1:]),
    )
    back = read_trajectory(made.csv())
    for field in fields(Trajectory):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(made, field.name))


def test_the_table_has_a_row_a_sample_under_names_with_units() -> None:
    _, _, made = true_and_estimated("float32")
    header, *rows = made.csv().splitlines()
    columns = header.split(",")
    assert len(rows) == N
    assert len(set(columns)) == len(columns)
    table = dict(zip(columns, rows[7].split(","), strict=True))
    assert float(table["time_s"]) == made.time[7]
    assert float(table["yaw_est_deg"]) == made.euler_est[7, 2]
    assert float(table["z_m"]) == made.position[7, 2]
    assert float(table["bias_est_vy_m_s"]) == made.bias_est[7, 4]
    assert float(table["gain_used_1_s"]) == made.gain_used[7]
    assert float(table["scaled_rate"]) == made.rate[7]


def lines(change: Callable[[list[str]], list[str]]) -> Callable[[str], str]:
    return lambda text: "\n".join(change(text.splitlines())) + "\n"


DAMAGE: dict[str, tuple[Callable[[str], str], str]] = {
    "empty": (lambda _: "", "cannot be read as a trajectory"),
    "a word": (lambda text: text.replace(text.splitlines()[3][:6], "broken", 1), "broken"),
    "a row cut short": (lines(lambda rows: [*rows[:-1], rows[-1][:40]]), "trajectory"),
    "every row cut short": (
        lines(lambda rows: [rows[0], *(row.rpartition(",")[0] for row in rows[1:])]),
        "trajectory",
    ),
    "no rows": (lines(lambda rows: rows[:1]), "trajectory"),
    "other columns": (lines(lambda rows: ["a,b", "1,2"]), "columns are not those.*'a', 'b'"),
    "renamed column": (lambda text: text.replace("yaw_deg", "heading"), "columns are not.*heading"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGE.values(), ids=DAMAGE.keys())
def test_a_damaged_table_is_refused(damage: Callable[[str], str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_trajectory(damage(true_and_estimated("float32")[2].csv()))
