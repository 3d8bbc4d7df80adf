"""`posegsa replay`: a tuned filter on recordings, with table, trajectories and figures."""

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.messages import assert_states
from helpers.recordings import bench, inertial_motion, motion
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.cli.command import main
from posegsa.cli.options import warn_of_mistakes
from posegsa.errors import ArgumentError, MeasurementError, RunFolderError
from posegsa.figures import replay_figures
from posegsa.figures.replay_figures import draw_replay
from posegsa.figures.style import png
from posegsa.judging.replayed import Replay, position_sigmas, replay_table, replayed_on
from posegsa.judging.result import Result
from posegsa.recordings.recording import Recording
from posegsa.saving.replay_files import folder_names

pytestmark = [
    pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning"),
]

SEEN = "vector_weights", "landmark_weights"


@pytest.fixture(scope="module")
def result() -> Result:
    return posegsa.tune(tiny())


@pytest.fixture(scope="module")
def recording() -> Recording:
    given = bench(start="rest", landmark_weights=0.1)
    return Recording.from_arrays(name="bench", **given, sources={"velocity": "synthetic: R^T v"})


def test_a_replay_is_the_estimates_and_their_errors(result: Result, recording: Recording) -> None:
    (found,) = posegsa.replay(result, recording)
    np.testing.assert_array_equal(found.estimates.rotation, result.estimate(recording).rotation)
    assert found.errors is not None
    expected = posegsa.recording_errors(found.estimates, recording).rmse()
    assert found.errors.rmse() == expected
    start = recording.initial()
    by_hand = result.estimate(recording, start.rotation, start.position, start.bias)
    np.testing.assert_array_equal(by_hand.rotation, found.estimates.rotation)
    with pytest.raises(ArgumentError, match=r"rotation, position.*both"):
        result.estimate(recording, rotation=start.rotation)
    with pytest.raises(ArgumentError, match=r"rotation, position.*both"):
        result.estimate(recording.measurements)
    table = replay_table([found])
    assert "bench" in table
    assert f"{100 * (expected['judged'].position or 0):.2f}" in table


def test_the_table_has_no_position_where_none_is_judged(
    result: Result, recording: Recording
) -> None:
    blind = Recording.from_arrays(**bench(truth_rotation=None, truth_position=None))
    without = replay_table(posegsa.replay(result, blind))
    assert "no truth" in without
    assert "position" not in without
    both = replay_table(posegsa.replay(result, [blind, recording]))
    assert "position" in both


def test_a_filter_with_a_covariance_says_how_right_it_is(
    result: Result, recording: Recording, tmp_path: Path
) -> None:
    (found,) = posegsa.replay("kalman", recording, out=tmp_path / "out", figures=["uncertainty"])
    assert found.errors is not None
    judged = found.errors.rmse()["judged"]
    nis = np.asarray(found.estimates.nis)[found.errors.masks["judged"]]
    assert judged.nis == pytest.approx(np.nanmean(nis))
    head, _, row, *_ = replay_table([found]).splitlines()
    assert "judged" in row
    assert head.split()[-2:] == ["NEES,", "NIS,"]
    assert row.split()[-2:] == [f"{judged.nees:.3g}", f"{judged.nis:.3g}"]
    assert (tmp_path / "out" / "bench" / "uncertainty.png").exists()
    assert "NEES" not in replay_table(posegsa.replay(result, recording)), "it has no covariance"
    blind = Recording.from_arrays(**bench(truth_rotation=None, truth_position=None))
    without = replay_table(posegsa.replay("kalman", blind))
    assert re.search(r"has no truth.*; NIS \S+, 1 if the noises are right", without)


def test_sensors_that_are_far_noisier_than_the_filter_believes_are_warned_of() -> None:
    clean = bench()
    noise = np.random.default_rng(0).normal(size=clean["vectors"].shape)
    warning = "warning: bench: the sensors are "
    for scale, told in ((0.1, False), (0.3, True)):
        noisy = bench(vectors=clean["vectors"] + scale * noise)
        for truth in ({}, {"truth_rotation": None, "truth_position": None}):
            recording = Recording.from_arrays(name="bench", **noisy | truth)
            assert (warning in replay_table(posegsa.replay("kalman", recording))) == told


def test_errors_are_drawn_by_axis_with_two_sigma(result: Result, recording: Recording) -> None:
    (found,) = posegsa.replay("kalman", recording)
    figure = replay_figures.plot_replay_uncertainty(found)
    assert figure is not None
    assert recording.truth is not None
    off = 100 * (recording.truth.position - found.estimates.position)
    sigmas = 100 * position_sigmas(found.estimates)
    for i, ax in enumerate(figure.axes[3:]):
        (line,) = ax.lines
        np.testing.assert_allclose(line.get_ydata(), off[:, i], atol=1e-3)
        drawn = np.abs(ax.collections[0].get_paths()[0].vertices[:, 1])
        assert drawn.max() == pytest.approx(2 * sigmas[:, i].max(), rel=1e-5)
    observed = posegsa.replay(result, recording)[0]
    assert replay_figures.plot_replay_uncertainty(observed) is None


def test_a_filter_that_is_lost_is_said_to_be(result: Result, recording: Recording) -> None:
    """Whatever it is, its estimates are moved by hand."""
    (found,) = posegsa.replay(result, recording)
    assert recording.truth is not None
    P = recording.truth.position
    assert P is not None
    right = found.estimates._replace(rotation=recording.truth.rotation, position=P)
    rotation, ended = np.copy(right.rotation), np.arange(len(P)) > len(P) // 2
    rotation[ended] = rotation[ended] @ np.diag([1.0, -1.0, -1.0])  # by half a turn
    cases = {
        "": right,
        "attitude is off by 180 deg": right._replace(rotation=rotation),
        "not a number": right._replace(rotation=np.where(ended[:, None, None], np.nan, rotation)),
        "position is off by 5 m": right._replace(position=P + 5.0 * ended[:, None] * [0, 0, 1]),
    }
    for words, estimates in cases.items():
        replay = replayed_on(recording, estimates)
        assert words in replay.lost
        assert bool(words) == ("bench: the filter is lost" in replay_table([replay]))


def test_the_command_writes_what_it_found(
    result: Result, recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    posegsa.save(result, tmp_path / "run", figures=[])
    recording.save(tmp_path / "bench.npz")
    out = tmp_path / "out"
    command = ["replay", str(tmp_path / "run"), str(tmp_path / "bench.npz")]
    assert main([*command, "--window", "0.5:1.5", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "velocity: synthetic: R^T v" in said
    assert "bench[0.5:1.5]" in said
    table = (out / "replay.txt").read_text()
    assert "velocity: synthetic: R^T v" in table
    assert "inclination" in said
    (data,) = json.loads((out / "replay.json").read_text())["recordings"]
    assert data["samples"] == 100
    assert data["sources"] == {"velocity": "synthetic: R^T v"}
    folder = out / "bench_0.5_1.5"
    assert {path.name for path in folder.iterdir()} == {
        "attitude_errors.png",
        "attitude.png",
        "biases.png",
        "position.png",  # no figure of the gain, which is constant
        "estimates.csv",
        "estimated.tum",
        "true.tum",
    }
    # The trajectories agree with the table.
    true, estimated = (np.loadtxt(folder / name)[:, 1:4] for name in ("true.tum", "estimated.tum"))
    rmse = posegsa.rmse(posegsa.position_errors(estimated, true))
    assert rmse == pytest.approx(data["rmse"]["judged"]["position"], rel=1e-6)
    table = np.genfromtxt(folder / "estimates.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["time_ns"], recording.stamps[50:150])
    places = np.stack([table[f"{axis}_m"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(places, estimated, atol=1e-8)
    assert main([*command, "--out", str(out)]) == 2
    assert "already" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 2
    with pytest.raises(SystemExit):
        main([*command, "--window", "3:1"])
    with pytest.raises(RunFolderError, match="already"):
        posegsa.replay(result, recording, out=out)


@pytest.mark.parametrize("origin", [1_700_000_000_123_456_789, 1000.5])
def test_estimates_have_the_stamps_of_the_log(origin: float, tmp_path: Path) -> None:
    given = inertial_motion(1.0, 2.0)
    steps = np.arange(len(given["gyr"]))
    time = origin + (10_000_000 * steps if isinstance(origin, int) else 0.01 * steps)
    log = posegsa.imu(given["gyr"], given["acc"], given["mag"], time=time, name="log")
    log.save(tmp_path / "log.npz")
    again = posegsa.as_imu(Recording.read(tmp_path / "log.npz"))
    late = log.window(1.0)
    for one, stamps in ((log, time), (again, time), (late, time[100:])):
        assert one.stamps.dtype == time.dtype
        np.testing.assert_allclose(one.stamps - origin, stamps - origin, rtol=0, atol=1e-9)
    (replay,) = posegsa.replay("imu", late, out=tmp_path / "out")
    names = {path.name for path in (tmp_path / "out" / "log_1").iterdir()}
    assert names == {"estimates.csv", "attitude.png", "biases.png"}
    head, *lines = (tmp_path / "out" / "log_1" / "estimates.csv").read_text().splitlines()
    unit = "ns" if isinstance(origin, int) else "s"
    assert head == (
        f"time_{unit},qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,bias_wx_rad_s,bias_wy_rad_s,"
        "bias_wz_rad_s,heading_sigma_deg,inclination_sigma_deg"
    )
    if isinstance(origin, int):
        assert [int(line.split(",")[0]) for line in lines] == time[100:].tolist()
    table = np.array([line.split(",")[1:] for line in lines], float)
    estimates = replay.estimates
    R = Rotation.from_quat(table[:, :4], scalar_first=True)
    np.testing.assert_allclose(R.as_matrix(), estimates.rotation, atol=1e-6)
    turned = Rotation.from_euler("ZYX", table[:, 6:3:-1], degrees=True)
    np.testing.assert_allclose(turned.as_matrix(), estimates.rotation, atol=1e-6)
    np.testing.assert_allclose(table[:, 7:10], estimates.bias[:, :3], rtol=1e-6)
    state = posegsa.PoseFilter("imu", rotation=late.initial().rotation)
    m = late.measurements
    for k in range(50):
        measured = {"time_step": 0.01, "gyr": m.angular_velocity[k], "acc": m.vectors[k, 0]}
        state.update(**measured, mag=m.vectors[k, 1])
    own = state.own_state
    expected = np.degrees([own.heading_deviation, own.inclination_deviation])
    np.testing.assert_allclose(table[50, 10:], expected, rtol=1e-4)


def test_what_a_file_lacks_is_bridged_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = motion()
    time = np.arange(400) / 100
    time[150] = time[140]  # goes back
    time[200:] += 0.5  # a gap
    rows = np.column_stack([time, given["angular_velocity"], 9.81 * given["vectors"][:, 0]])
    rows[300, 1] = np.nan
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="time,wx,wy,wz,ax,ay,az", comments="")
    command = ["replay", "imu", str(path)]
    assert main(command) == 2
    assert "(--bridge)" in capsys.readouterr().err
    refused = [
        ["--longest-gap", "2"],
        ["--bridge", "refuse", "--longest-gap", "2"],
        ["--bridge", "hold", "--longest-gap", "0.3"],
        ["--bridge", "hold", "--longest-gap", "nan"],
    ]
    for more in refused:
        assert main([*command, *more]) == 2
        assert "longest" in capsys.readouterr().err
    out = tmp_path / "out"
    assert main([*command, "--bridge", "interpolate", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    (data,) = json.loads((out / "replay.json").read_text())["recordings"]
    table = (out / "replay.txt").read_text()
    expected = (
        ["1 sample", "dropped"],
        ["1 gap", "5 median steps"],
        ["1 sample", "300", "bridged", "interpolate"],
    )
    for note, facts in zip(data["notes"], expected, strict=True):
        assert_states(note, *facts)
        assert note in said
        assert note in table


def paused() -> Recording:
    """An inertial sensor's recording of 100 Hz, without its samples from 2 s to 4 s."""
    given = inertial_motion(1.0, 5.0)
    time = np.arange(len(given["gyr"])) / given.pop("rate")
    kept = (time < 2) | (time >= 4)
    names = "gyr", "acc", "mag", "truth_rotation"
    return posegsa.imu(
        **{name: given[name][kept] for name in names}, time=time[kept], name="paused"
    )


def test_a_pause_is_told_and_no_line_leads_over_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = paused()
    monkeypatch.setattr(replay_figures, "MAX_POINTS", 90)  # bins that do not end at the pause
    (found,) = posegsa.replay("imu", recording, out=tmp_path)
    table = (tmp_path / "replay.txt").read_text()
    assert "paused: after 1 pause of more than 0.25 s the attitude was found anew (at 4 s)" in table
    (whole,) = posegsa.replay("imu", recording.window(4.0))
    assert "anew" not in replay_table([whole])
    assert found.errors is not None
    figures = draw_replay(found)
    assert {"attitude", "attitude_errors", "biases"} <= figures.keys()
    for figure in figures.values():
        for line in (one for ax in figure.axes for one in ax.lines):
            time, values = (np.asarray(a, float) for a in (line.get_xdata(), line.get_ydata()))
            last, first = np.flatnonzero(time < 3)[-1], np.flatnonzero(time > 3)[0]
            assert time[last] > 1.9
            assert time[first] == 4.0
            assert np.isnan(values[last + 1 : first]).any()
    inclination = figures["attitude_errors"].axes[2].lines[0]
    time, values = (np.asarray(a, float) for a in inclination.get_data())
    before = found.errors.attitude.inclination[found.errors.time < 2]
    assert np.nanmax(values[time < 3]) == pytest.approx(np.max(before))


def test_the_json_has_null_for_what_there_is_not(tmp_path: Path) -> None:
    recording = paused()
    nothing = replace(recording, judged=np.zeros(recording.samples, bool))
    posegsa.replay("imu", nothing, out=tmp_path, figures=[])
    text = (tmp_path / "replay.json").read_text()
    assert "nan" not in text.lower()
    (data,) = json.loads(text)["recordings"]
    assert data["median_gain_1_s"] is None
    assert data["rmse"]["judged"]["total"] is None


def test_figures_can_be_read(result: Result, recording: Recording) -> None:
    (found,) = posegsa.replay(result, recording)
    errors = np.geomspace(50, 0.2, 200)
    errors[[100, 101]] = 1e-7, 0.0  # passes through 0
    assert found.errors is not None
    attitude = found.errors.attitude._replace(heading=errors)
    shown = found._replace(errors=found.errors._replace(attitude=attitude))
    figure = draw_replay(shown)["attitude_errors"]
    png(figure)
    for ax in figure.axes:
        low, high = ax.get_ylim()
        texts = [
            text.get_text()
            for text, at in zip(ax.get_yticklabels(), ax.get_yticks(), strict=True)
            if low <= at <= high
        ]
        assert len(texts) >= 2
        assert all(float(text) > 0 and "10^" not in text for text in texts)
    low, high = figure.axes[1].get_ylim()
    assert 0.1 < low < 0.2
    assert high > 50
    # A constant gain has no figure, unless it is limited at samples with measurements.
    gains = found.estimates._replace(gain=np.full(200, 8.0), gain_used=np.full(200, 8.0))
    assert "gain" not in draw_replay(found._replace(estimates=gains))
    weights = recording.measurements
    nothing = weights._replace(**{k: 0 * weights._asdict()[k] for k in SEEN})
    nothing.vector_weights[::10] = 1.0
    limited = np.where(np.arange(200) % 10 == 0, 2.0, 8.0)
    sparse = replace(recording, measurements=nothing)
    gains = gains._replace(gain_used=limited)
    figure = draw_replay(Replay(sparse, gains, None))["gain"]
    asked, used = figure.axes[0].lines
    np.testing.assert_array_equal(np.unique(np.asarray(asked.get_ydata())), [8.0])
    np.testing.assert_array_equal(np.asarray(used.get_ydata()), np.full(20, 2.0))


def test_the_true_trajectory_is_all_that_is_known(
    result: Result, recording: Recording, tmp_path: Path
) -> None:
    moving = replace(recording, judged=recording.phases["motion"])
    posegsa.replay(result, [moving], out=tmp_path)
    lengths = {
        name: len(np.loadtxt(tmp_path / "bench" / name)) for name in ("true.tum", "judged.tum")
    }
    assert lengths == {"true.tum": 200, "judged.tum": 100}
    posegsa.replay(result, [recording], out=tmp_path, overwrite=True)
    assert not (tmp_path / "bench" / "judged.tum").exists()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", "x", r"a\.png.*\.csv.*\.npz.*\.mat.*folder"),
        ("none", None, r"none: .*no such file or folder"),
        ("none.csv", None, r"none\.csv: .*no such file"),
        ("folder", "", r"folder.*EuRoC"),
        ("empty.csv", "", r"empty\.csv.*empty"),
        ("head.csv", "time,wx\n", r"head\.csv.*no sample"),
        ("a.csv", "a,b\n1,2\n", r"lacks time \(time\), wx wy wz.*a, b"),
        ("t.csv", "time\n1\n", r"lacks wx wy wz.*time"),
    ],
)
def test_a_value_that_is_not_a_recording_is_named_with_what_is_allowed(
    name: str,
    content: str | None,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / name
    if name == "folder":
        path.mkdir()
    elif content is not None:
        path.write_text(content)
    assert main(["replay", "imu", str(path)]) == 2
    assert re.search(words, capsys.readouterr().err)


@pytest.mark.parametrize("argument", [{"figures": ["gain"]}, {"overwrite": True}])
def test_options_about_the_folder_are_refused_without_one(
    result: Result, recording: Recording, argument: dict
) -> None:
    (name,) = argument
    with pytest.raises(ArgumentError, match=f"{name} without out"):
        posegsa.replay(result, recording, **argument)


def test_folders_have_names_of_their_own() -> None:
    assert folder_names(["a[0:1]", "a/0:1", "..", "V1_02.b"]) == [
        "a_0_1",
        "a_0_1_2",
        "recording",
        "V1_02.b",
    ]


def test_a_recording_without_a_start_costs_no_other_its_result(
    result: Result, recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = bench(start="sensors")
    for name in ("vectors", "landmarks"):
        given[name] = np.full_like(given[name], np.nan)
    blind = Recording.from_arrays(name="blind", **given)
    with pytest.raises(MeasurementError, match="start"):
        posegsa.replay(result, [recording, blind])
    posegsa.save(result, tmp_path / "run", figures=[])
    recording.save(tmp_path / "bench.npz")
    blind.save(tmp_path / "blind.npz")
    (tmp_path / "empty.csv").write_text("")
    paths = [str(tmp_path / name) for name in ("empty.csv", "bench.npz", "blind.npz")]
    out = tmp_path / "out"
    command = ["replay", str(tmp_path / "run"), *paths, "--out", str(out), "--no-figures"]
    assert main(command) == 2
    said = capsys.readouterr()
    assert "bench" in said.out
    assert "blind: " in said.err
    assert "empty.csv: is empty" in said.err
    (data,) = json.loads((out / "replay.json").read_text())["recordings"]
    assert data["name"] == "bench"
    assert main(["replay", str(tmp_path / "run"), paths[0]]) == 2


def test_a_recording_is_checked_in_its_own_frame() -> None:
    given = inertial_motion(2.0, 20.0, noise=0.1, frame="NED")
    sensors = {"accelerometer": given.pop("acc"), "magnetometer": given.pop("mag")}
    one = Recording.from_arrays(
        time_step=1 / given.pop("rate"),
        angular_velocity=given.pop("gyr"),
        sensors=sensors,
        **given,
    )
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        warn_of_mistakes([replace(one, frame="NED")])
        assert not noted
        warn_of_mistakes([one])
    assert any("--frame NED" in str(each.message) for each in noted)
