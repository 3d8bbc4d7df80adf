"""The inertial frame of an inertial sensor's recordings: stated once, it is used everywhere."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import inertial_motion

import posegsa
from posegsa.cli.command import main
from posegsa.errors import ArgumentError, RecordingError
from posegsa.judging.evaluation import IMU_AS_IT_COMES, advice
from posegsa.recordings.frames import UP, Frame
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import quaternions

pytestmark = pytest.mark.filterwarnings("always::posegsa.errors.PosegsaWarning")


@pytest.fixture(autouse=True)
def started(monkeypatch: pytest.MonkeyPatch) -> None:
    """JAX has started, which the command line would warn of."""
    monkeypatch.setattr("posegsa.runtime.enable_fast_path", lambda: True)


def csv(path: Path, frame: Frame, stated: str = "") -> str:
    """The path of a CSV file, with `stated` in the TOML file beside it."""
    given = inertial_motion(frame=frame)
    time = np.arange(len(given["gyr"]))[:, None] / given["rate"]
    sensors = [given[name] for name in ("gyr", "acc", "mag")]
    table = np.hstack([time, *sensors, quaternions(given["truth_rotation"])])
    names = ["time", "wx", "wy", "wz", "ax", "ay", "az", "mx", "my", "mz", "qw", "qx", "qy", "qz"]
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    if stated:
        path.with_name(f"{path.name}.toml").write_text(f'frame = "{stated}"\n')
    return str(path)


def unstated(frame: Frame) -> Recording:
    """A recording whose truth is in a frame that it does not state."""
    given: dict[str, Any] = inertial_motion(frame=frame)
    sensors = {"accelerometer": given.pop("acc"), "magnetometer": given.pop("mag")}
    step, gyr = 1 / given.pop("rate"), given.pop("gyr")
    return Recording.from_arrays(time_step=step, angular_velocity=gyr, sensors=sensors, **given)


def test_all_filters_err_the_same_in_each_frame() -> None:
    rows = {}
    for frame in UP:
        made = posegsa.imu(**inertial_motion(noise=0.1, frame=frame), frame=frame)
        judged = posegsa.evaluate(posegsa.configured("imu"), recordings=made)
        assert judged.on_recordings is not None
        rows[frame] = judged.on_recordings.rows()
        assert float(rows[frame][1][4]) < 2.0
        assert judged.frame == frame, "its exports and streams are in the frame too"
        said = judged.on_recordings.verdict()
        assert (f"--frame {frame}" in said) == (frame != "ENU" and "Take this filter" in said)
    assert rows["ENU"] == rows["NED"] == rows["NWU"]


def test_a_filter_of_a_frame_reads_recordings_in_it() -> None:
    made = posegsa.imu(**inertial_motion(frame="NED"), frame="NED")
    of_recordings = posegsa.configured("imu", recordings=[made])
    for result in (of_recordings, posegsa.configured("imu").in_frame("NED")):
        assert result.frame == "NED"
        assert result.with_sensors_of(unstated("NED")).frame == "NED"
        (found,) = posegsa.replay(result, unstated("NED"))
        assert found.errors is not None
        assert found.errors.rmse()["judged"].total < 1.0
        np.testing.assert_array_equal(
            found.estimates.rotation, result.estimate(unstated("NED")).rotation
        )
        (found,) = posegsa.replay(result, posegsa.as_imu(unstated("ENU"), frame="ENU"))
        assert found.errors is not None
        assert found.errors.rmse()["judged"].total < 1.0
    assert posegsa.configured("imu").frame is None


def test_a_file_states_its_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = csv(tmp_path / "ned.csv", "NED", stated="NED")
    assert main(["check", path]) == 0
    assert "attitude only, NED" in capsys.readouterr().out
    assert main(["replay", "imu", path]) == 0
    said = capsys.readouterr()
    assert "lost" not in said.out
    assert said.err == ""
    # The option wins, and says so.
    assert main(["check", path, "--frame", "ENU"]) == 1
    said = capsys.readouterr()
    assert "note: ned: --frame ENU instead of the frame that it states, NED" in said.err
    assert "looks like NED, not ENU: --frame NED" in said.out
    assert Recording.read(path, frame="NWU").frame == "NWU"


def test_an_option_states_the_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = csv(tmp_path / "ned.csv", "NED")
    for command in (["check", path], ["replay", "imu", path]):
        assert main([*command, "--frame", "NED"]) == 0
        said = capsys.readouterr()
        assert "NED, 100.0 % judged" in said.out
        assert said.err == ""
    assert main(["replay", "imu", path]) == 0
    assert "looks like NED, not ENU: --frame NED" in capsys.readouterr().err


def test_a_frame_may_be_in_small_letters(tmp_path: Path) -> None:
    path = csv(tmp_path / "log.csv", "NED", "ned")
    assert Recording.read(path).frame == "NED"
    assert main(["check", path, "--frame", "ned"]) == 0
    given, small = inertial_motion(frame="NWU"), "nwu"
    made = posegsa.imu(**given, frame=small)  # type: ignore[arg-type]  # in capitals by the type
    assert made.frame == "NWU"
    result = posegsa.configured("imu").in_frame(small)  # type: ignore[arg-type]  # likewise
    assert result.frame == "NWU"


def test_what_is_no_frame_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = csv(tmp_path / "ned.csv", "NED", stated="END")
    assert main(["check", path]) == 2
    assert_states(capsys.readouterr().err, "ned.csv: frame = 'END'", "ENU, NED, NWU")
    with pytest.raises(RecordingError, match=r"frame = 'NED'.*with an accelerometer"):
        Recording.from_arrays(time_step=0.01, angular_velocity=np.zeros((9, 3)), frame="NED")
    with pytest.raises(ArgumentError, match=r"frame = 'END'.*ENU, NED, NWU"):
        posegsa.configured("imu").in_frame("END")  # type: ignore[arg-type]  # wrong on purpose


def test_commands_that_are_printed_carry_the_frame() -> None:
    assert "replay imu FILE --frame NED`" in advice("NED")[IMU_AS_IT_COMES]
    assert "--frame" not in advice("ENU")[IMU_AS_IT_COMES]
