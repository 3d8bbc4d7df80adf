"""`tune_imu`: tuning of [vectors] and [observer] on recordings of inertial sensors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_told
from helpers.recordings import motion
from helpers.recordings import short_parts as short_parts

import posegsa
from posegsa import config
from posegsa.cli.command import main
from posegsa.errors import ArgumentError, ConfigError, RecordingError, RunFolderError
from posegsa.recordings.recording import Recording

pytestmark = [
    pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning"),
    pytest.mark.usefixtures("short_parts"),
]

ALSO = '[{key = "vectors.low_pass", lower = 0.05, upper = 5.0, scale = "logarithmic"}]'
TINY = [
    f"parameters.also={ALSO}",
    "vectors.low_pass=5.0",
    "search.agents=6",
    "search.iterations=3",
]


def shaken(seed: int, **changes: Any) -> Recording:
    """A body that accelerates and whose gyroscope has a bias."""
    given = motion(**changes)
    rng = np.random.default_rng(seed)
    R, time = given["truth_rotation"], np.arange(400) / 100
    moving = given["phases"]["motion"][:, None]
    shake = moving * np.sin(12 * time + seed)[:, None] * [4.0, 2.0, 3.0]
    acc = np.einsum("kji,kj->ki", R, shake + np.array([0.0, 0.0, 9.81]))
    mag = np.einsum("kji,j->ki", R, [0.0, 0.4, -0.3]) + 1e-3 * rng.normal(size=(400, 3))
    return Recording.from_arrays(
        name=f"shaken {seed}",
        time=given["time"],
        angular_velocity=given["angular_velocity"] + moving * [0.0, 0.05, -0.03],
        truth_rotation=R,
        judged=given["phases"]["motion"],
        sensors={"accelerometer": acc, "magnetometer": mag},
    )


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [shaken(seed) for seed in range(3)]


def test_the_numbers_that_are_named_are_found(
    recordings: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poor = config.override_imu(config.ImuConfig(), TINY)
    told = []
    out = tmp_path / "out"
    result = posegsa.tune_imu(
        poor, recordings=recordings[:2], held_out=recordings[2], out=out, progress=told.append
    )
    assert [step.done for step in told if step.name == "searching"] == [0, 1, 2, 3]
    assert set(result.tuned) == {"vectors.low_pass"}
    assert 0.05 <= result.config.vectors.low_pass < 5.0
    assert result.config.observer == poor.observer
    # The stated errors are right, on training and on held-out recordings.
    for one, scored in zip(recordings, (*result.training, *result.held_out), strict=True):
        made = posegsa.as_imu(one, settings=result.config.vectors)
        found = posegsa.recording_errors(posegsa.run_imu(made, result.config), made).rmse()
        assert scored.errors["judged"] == found["judged"]
    costs = [one.errors["judged"].total for one in result.training]
    assert result.cost == pytest.approx(np.mean(costs))
    assert result.cost < 0.9 * result.cost_before
    (new,), (old,) = result.held_out, result.held_out_before
    assert new.errors["judged"].total < old.errors["judged"].total
    assert_told(result.summary(), "held out", "before")
    assert "warning" not in result.summary()
    swapped = {"held_out": result.held_out_before, "held_out_before": result.held_out}
    assert "worse" in replace(result, **swapped).summary()
    assert "vectors.low_pass" in result.summary()
    # The file holds the same filter.
    assert config.load_imu(out / "imu.toml") == result.config
    assert result.summary() in (out / "imu.txt").read_text()
    with pytest.raises(RunFolderError, match="already"):
        posegsa.tune_imu(poor, recordings=recordings[:1], out=out)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.json").write_text("{}")
    with pytest.raises(RunFolderError, match="holds a run"):
        posegsa.tune_imu(poor, recordings=recordings[:1], out=tmp_path / "run", overwrite=True)
    recordings[2].save(tmp_path / "held.npz")
    assert main(["replay", str(out / "imu.toml"), str(tmp_path / "held.npz")]) == 0
    assert f"{new.errors['judged'].total:.2f}" in capsys.readouterr().out


def test_the_command_tunes_it_and_numbers_stay_where_none_is_better(
    recordings: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "a.npz", tmp_path / "out"
    recordings[0].save(path)
    mine = tmp_path / "mine.toml"
    mine.write_text(config.ImuConfig().to_toml())
    also = 'parameters.also=[{key = "vectors.low_pass", lower = 5.0, upper = 6.0}]'
    few = ["--set", also, "--set", "vectors.low_pass=0.5", "--set", "search.agents=6"]
    command = ["tune", str(mine), *few, "--iterations", "3", "--quiet", "--out", str(out)]
    assert main(command) == 2
    assert_told(capsys.readouterr().err, "--recording")
    assert main([*command, "--recording", str(path), "--filter", "a:B"]) == 2
    assert_told(capsys.readouterr().err, "--filter")
    assert main([*command, "--recording", str(path)]) == 0
    said = capsys.readouterr().out
    assert_told(said, "none was better", "No recording was held out")
    assert config.load_imu(out / "imu.toml").vectors.low_pass == 0.5
    assert main(["tune", "quick", "--rest", "2"]) == 2
    assert_told(capsys.readouterr().err, "--rest", "inertial sensors")


def test_what_was_found_is_not_lost_where_it_cannot_be_written(
    recordings: list[Recording],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def full(*_: object) -> None:
        raise RunFolderError("out: cannot be written: No space left on device")

    monkeypatch.setattr("posegsa.imu_tuning.write_imu", full)
    recordings[0].save(tmp_path / "a.npz")
    few = ["--set", f"parameters.also={ALSO}", "--set", "search.agents=6", "--iterations", "3"]
    command = ["tune", "imu", "--recording", str(tmp_path / "a.npz"), *few, "--quiet"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "low_pass = " in said.out
    assert "No space left" in said.err


def test_what_cannot_be_tuned_is_refused(recordings: list[Recording]) -> None:
    with pytest.raises(ArgumentError, match="recordings: none"):
        posegsa.tune_imu(recordings=[])
    with pytest.raises(ArgumentError, match=r"held_out: shaken 0"):
        posegsa.tune_imu(recordings=recordings, held_out=recordings[0])
    with pytest.raises(RecordingError, match="has no accelerometer"):
        posegsa.tune_imu(recordings=Recording.from_arrays(**motion()))
    nothing = config.override_imu(config.ImuConfig(), ["parameters.also=[]"])
    with pytest.raises(ArgumentError, match="nothing that is tuned"):
        posegsa.tune_imu(nothing, recordings=recordings)
    for setting, words in {
        'parameters.also=[{key = "vectors.lowpass", lower = 1.0, upper = 2.0}]': "cannot be tuned",
        'parameters.also=[{key = "observer.gain", lower = 0.0, upper = 2.0}]': "observer.gain",
        "vectors.low_pass=-1.0": "vectors.low_pass",
        "vectors.low_pas=1.0": "vectors.low_pas",
    }.items():
        with pytest.raises(ConfigError, match=words):
            config.override_imu(config.ImuConfig(), [setting])
