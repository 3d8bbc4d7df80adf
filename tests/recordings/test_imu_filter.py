"""The attitude filter for inertial sensors, with simulated sensors."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.compiled_c import Build, Layout, needs_cc, run_c
from helpers.compiled_c import build as build
from helpers.messages import assert_told
from helpers.recordings import BIAS, inertial_motion
from helpers.recordings import short_parts as short_parts
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.cli.command import main
from posegsa.errors import ArgumentError, RecordingError, RunFolderError
from posegsa.judging.replayed import Replay
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.usefixtures("short_parts")


def replayed(recording: Recording, changed: config.ImuConfig | None = None) -> Replay:
    (found,) = posegsa.replay("imu" if changed is None else changed, recording)
    return found


def total(found: Replay, phase: str = "judged") -> float:
    assert found.errors is not None
    return found.errors.rmse()[phase].total


def test_it_follows_a_motion_it_was_not_tuned_on() -> None:
    recording = posegsa.imu(**inertial_motion(3.0, 30.0, noise=1.0, shaking=3.0))
    found = replayed(recording)
    assert total(found) < 1.0
    assert np.isnan(found.estimates.position).all()
    np.testing.assert_array_equal(found.estimates.rotation, posegsa.run_imu(recording).rotation)
    # It is worse without the low-pass filter.
    plain = config.ImuVectorsConfig(low_pass=0.0)
    shaken = posegsa.as_imu(recording, settings=plain)
    assert total(replayed(shaken)) > 3 * total(found)


def test_it_learns_the_gyroscope_s_bias_without_a_rest() -> None:
    given = inertial_motion(0.0, 120.0, noise=1.0)
    late = np.arange(len(given["gyr"])) > 9000
    recording = posegsa.imu(**given, phases={"late": late})
    found = replayed(recording)
    wrong = np.linalg.norm(found.estimates.bias[-1, :3] - BIAS)
    assert wrong < 0.45 * np.linalg.norm(BIAS)
    # Settings for larger biases estimate it faster.
    eager = config.ImuConfig(
        vectors=config.ImuVectorsConfig(low_pass=1.0),
        observer=config.ImuObserverConfig(gamma=3.0),
    )
    sooner = posegsa.as_imu(recording, settings=eager.vectors)
    np.testing.assert_allclose(replayed(sooner, eager).estimates.bias[-1, :3], BIAS, atol=3e-3)
    never = config.ImuConfig(observer=config.ImuObserverConfig(gamma=0.0))
    assert total(replayed(recording, never), "late") > 2 * total(found, "late")


def test_a_magnet_turns_the_heading_little_and_does_not_tilt() -> None:
    given = inertial_motion(3.0, 30.0, noise=1.0)
    clean = replayed(posegsa.imu(**given))
    given["mag"][1000:2000] += [15.0, 5.0, 10.0]
    found = replayed(posegsa.imu(**given))
    assert found.errors is not None
    assert clean.errors is not None
    errors, expected = found.errors.rmse()["judged"], clean.errors.rmse()["judged"]
    assert errors.heading < 3.0
    assert errors.inclination < expected.inclination + 0.1
    blind = config.ImuConfig(vectors=config.ImuVectorsConfig(field_tolerance="off"))
    trusting = posegsa.as_imu(posegsa.imu(**given), settings=blind.vectors)
    assert total(replayed(trusting, blind)) > 3 * errors.total


def test_without_a_magnetometer_the_inclination_is_as_good() -> None:
    given = inertial_motion(3.0, 30.0, noise=1.0)
    both = replayed(posegsa.imu(**given))
    del given["mag"]
    alone = replayed(posegsa.imu(**given))
    assert both.errors is not None
    assert alone.errors is not None
    inclination = alone.errors.rmse()["judged"].inclination
    assert inclination < both.errors.rmse()["judged"].inclination + 0.1


def test_recordings_of_other_sensors_are_refused() -> None:
    recording = Recording.from_arrays(
        time_step=0.01,
        angular_velocity=np.zeros((10, 3)),
        vectors=np.ones((10, 1, 3)),
        vector_references=np.ones((1, 3)),
    )
    with pytest.raises(ArgumentError, match=r"recording:.* Recording.*posegsa\.as_imu"):
        posegsa.run_imu(recording)  # pyright: ignore[reportArgumentType]  # wrong on purpose
    with pytest.raises(RecordingError, match="has no accelerometer"):
        posegsa.replay("imu", recording)
    with pytest.raises(ArgumentError, match=r'result:.* str.*"imu"'):
        posegsa.replay("recommended", recording)  # pyright: ignore[reportArgumentType]  # wrong on purpose


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_the_command_needs_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = inertial_motion(3.0, 9.0, noise=1.0)
    time = np.arange(len(given["gyr"])) / given["rate"]
    q = Rotation.from_matrix(given["truth_rotation"]).as_quat(scalar_first=True)
    table = np.column_stack([time, given["gyr"], given["acc"], given["mag"], q])
    names = "time,wx,wy,wz,ax,ay,az,mx,my,mz,qw,qx,qy,qz"
    path = tmp_path / "my.csv"
    np.savetxt(path, table, delimiter=",", header=names, comments="")
    out = tmp_path / "out"
    assert main(["replay", "imu", str(path), "--rest", "2", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert_told(said, "at rest", "2.0 s", "attitude only")
    assert len((out / "my" / "estimated.tum").read_text().splitlines()) >= len(time)
    mine = tmp_path / "mine.toml"
    mine.write_text("[vectors]\nlow_pass = 0.0\n", encoding="utf-8")
    # A window that begins in motion, in another frame, with the user's settings.
    assert main(["replay", str(mine), str(path), "--window", "5:", "--frame", "NED"]) == 0
    said = capsys.readouterr().out
    assert "begins in motion" in said
    assert "as measured" in said
    with pytest.raises(SystemExit):
        main(["replay", "imu", str(path), "--rest", "long"])


@needs_cc
def test_the_observer_goes_out_as_the_page_says(build: Build) -> None:
    """With the recording's vectors, the C code of docs/imu.md computes the same as `run_imu`."""
    page = Path(__file__).parents[2] / "docs" / "imu.md"
    (code,) = re.findall(r"## Export\n.*?```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)  # code from our own page
    recording = posegsa.imu(**inertial_motion(3.0, 4.0, noise=1.0))
    start, m = recording.initial(), recording.measurements
    columns = [
        np.asarray(m.time_step)[:, None],
        np.asarray(m.angular_velocity) - start.bias[:3],  # the C filter starts with bias 0
        np.asarray(m.vectors).reshape(recording.samples, -1),
        m.vector_weights,
    ]
    x, y, z, w = Rotation.from_matrix(start.rotation).as_quat()
    program = build(names["text"], "-DATTITUDE_ONLY")
    found = run_c(
        program, Layout(2, 0, learns=False), np.array([w, x, y, z]), np.concatenate(columns, axis=1)
    )
    expected = posegsa.run_imu(recording)
    assert (found.code == 0).all()
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-9)
    learnt = np.asarray(expected.bias)[:, :3] - start.bias[:3]
    np.testing.assert_allclose(found.bias, learnt, atol=1e-12)
    assert np.abs(learnt).max() > 1e-5


@pytest.mark.filterwarnings("ignore:enable_fast_path")
def test_what_asks_for_a_run_is_told_that_it_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "imu.toml").write_text(config.ImuConfig().to_toml(), "utf-8")
    for given, words in (
        (mine, (f"posegsa replay {mine / 'imu.toml'} RECORDING", "no export")),
        (mine / "imu.toml", (f"{mine / 'imu.toml'}: is an attitude filter", "posegsa replay imu")),
    ):
        assert main(["export", str(given), "--format", "c"]) == 2
        said = capsys.readouterr().err
        assert all(each in said for each in words), said
        with pytest.raises(RunFolderError, match="filter for inertial sensors"):
            posegsa.load(given)
    other = tmp_path / "other.toml"
    other.write_text("[run]\n", "utf-8")
    with pytest.raises(RunFolderError, match=r"other\.toml.*folder"):
        posegsa.load(other)
