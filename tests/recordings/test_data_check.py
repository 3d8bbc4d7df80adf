"""Checks of a recording: every usual mistake is named, and nothing else."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import RATE, inertial_motion
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.errors import ArgumentError, RecordingError
from posegsa.figures.check_figures import plot_check
from posegsa.recordings import relations
from posegsa.recordings.data_check import check, found_noises
from posegsa.recordings.frames import UP, Frame
from posegsa.recordings.recording import Recording

COUNT, STEP = 1500, 0.01
BRIEF = 800
"""Samples that suffice to name a mistake."""
GRAVITY, FIELD = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.44, -0.9])
PLACES = np.array([[4.0, 1.0, 0.5], [-3.0, 4.0, 1.0], [0.5, -4.0, 2.0]])
Arguments = dict[str, Any]


@cache
def flown(seed: int = 4, count: int = COUNT) -> Arguments:
    """A tumbling flight by SciPy's rotations, with noise and biases."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(count + 1)
    angles = np.stack([0.9 * np.sin(0.9 * t), 0.7 * np.sin(1.3 * t + 1), 0.8 * t], axis=1)
    turn = Rotation.from_euler("xyz", angles)
    P = np.stack([3 * np.sin(0.7 * t), 2 * np.cos(0.5 * t), 1 + 0.5 * np.sin(1.1 * t)], axis=1)
    R = turn.as_matrix()
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / STEP
    moved = np.einsum("kji,kj->ki", R[:-1], np.diff(P, axis=0)) / STEP
    R, P = R[:-1], P[:-1]
    vectors = np.einsum("kji,nj->kni", R, np.stack([GRAVITY, FIELD]))
    landmarks = np.einsum("kji,knj->kni", R, PLACES - P[:, None])
    landmarks += 0.03 * rng.normal(size=landmarks.shape)
    landmarks[np.arange(count) % 5 != 0] = np.nan
    return {
        "time": STEP * np.arange(count),
        "angular_velocity": rate + [0.02, -0.01, 0.01] + 0.005 * rng.normal(size=rate.shape),
        "velocity": moved + [0.05, 0.05, -0.05] + 0.03 * rng.normal(size=moved.shape),
        "vectors": vectors + 0.02 * rng.normal(size=vectors.shape),
        "vector_references": np.stack([GRAVITY, FIELD]),
        "landmarks": landmarks,
        "landmark_references": PLACES,
        "truth_quaternion": turn[:-1].as_quat(scalar_first=True),
        "truth_position": P,
        "landmark_outlier": "off",
    }


TURNED = Rotation.from_euler("z", 90, degrees=True)


def rotations(a: Arguments) -> Rotation:
    return Rotation.from_quat(a["truth_quaternion"], scalar_first=True)


def true_rotations(a: Arguments) -> np.ndarray:
    return rotations(a).as_matrix()


def jumped(a: Arguments) -> np.ndarray:
    positions = a["truth_position"].copy()
    positions[700, 0] = 1e30
    return positions


def one_of(a: Arguments, name: str, index: int, change: Callable[[Any], Any]) -> Arguments:
    changed = np.array(a[name], float)
    changed[..., index, :] = change(changed[..., index, :])
    return a | {name: changed}


def to_inertial(a: Arguments, values: np.ndarray) -> np.ndarray:
    return np.einsum("kij,k...j->k...i", true_rotations(a), values)


SENSORS = ("angular_velocity", "velocity", "vectors", "landmarks")


def late(values: np.ndarray) -> np.ndarray:
    """Five samples, 50 ms."""
    return np.concatenate([np.repeat(values[:1], 5, axis=0), values[:-5]])


MISTAKES: dict[str, tuple[Callable[[Arguments], Arguments], str]] = {
    "degrees": (
        lambda a: a | {"angular_velocity": np.rad2deg(a["angular_velocity"])},
        r"angular_velocity looks like deg/s: divide by 57\.3",
    ),
    "scalar last": (
        lambda a: a | {"truth_quaternion": a["truth_quaternion"][:, [1, 2, 3, 0]]},
        "quaternion looks as if its scalar came last",
    ),
    "inverse": (
        lambda a: a | {"truth_quaternion": a["truth_quaternion"] * [1, -1, -1, -1]},
        "true rotation looks inverse",
    ),
    "axis of the gyroscope": (
        lambda a: a | {"angular_velocity": a["angular_velocity"] * [1, -1, 1]},
        "angular_velocity: the sign of its y axis looks wrong",
    ),
    "axes of the gyroscope": (
        lambda a: a | {"angular_velocity": a["angular_velocity"][:, [1, 2, 0]]},
        r"angular_velocity: its axes look exchanged: \(x, y, z\) should be \(z, x, y\)",
    ),
    "velocity, inertial": (
        lambda a: a | {"velocity": to_inertial(a, a["velocity"])},
        "velocity looks as if it were in the inertial frame",
    ),
    "axes of the velocity": (
        lambda a: a | {"velocity": a["velocity"][:, [1, 0, 2]]},
        r"velocity: its axes look exchanged: \(x, y, z\) should be \(y, x, z\)",
    ),
    "gravity down": (
        lambda a: one_of(a, "vector_references", 0, np.negative),
        "vector 0 and its reference look opposite",
    ),
    "without gravity": (
        lambda a: one_of(
            a, "vectors", 0, lambda b: b - np.einsum("kji,j->ki", true_rotations(a), GRAVITY)
        ),
        "vector 0 looks like an acceleration without gravity",
    ),
    "multiples of g": (
        lambda a: one_of(a, "vectors", 0, lambda b: b / 9.81),
        "vector 0 looks like multiples of g",
    ),
    "mirrored": (
        lambda a: one_of(a, "vector_references", 1, lambda r: r[[1, 0, 2]] * [1, 1, -1]),
        "the reference of vector 1 looks mirrored",
    ),
    "vectors exchanged": (
        lambda a: a | {"vectors": a["vectors"][:, ::-1]},
        "vector 0 and vector 1 look exchanged",
    ),
    "vector and reference": (
        lambda a: one_of(a, "vectors", 1, lambda b: to_inertial(a, b)),
        "vector 1 and its reference look exchanged",
    ),
    "axis of a vector": (
        lambda a: one_of(a, "vectors", 1, lambda b: b * [1, 1, -1]),
        "vector 1: the sign of its z axis looks wrong",
    ),
    "landmarks exchanged": (
        lambda a: a | {"landmarks": a["landmarks"][:, [2, 1, 0]]},
        "landmarks 0 and 2 look exchanged",
    ),
    "landmarks, inertial": (
        lambda a: a | {"landmarks": to_inertial(a, a["landmarks"])},
        "landmarks look as if they were measured in the inertial frame",
    ),
    "axes of a landmark": (
        lambda a: one_of(a, "landmarks", 1, lambda y: y[:, [0, 2, 1]]),
        r"landmark 1: its axes look exchanged: \(x, y, z\) should be \(x, z, y\)",
    ),
    "late gyroscope": (
        lambda a: a | {"angular_velocity": late(a["angular_velocity"])},
        "angular_velocity looks [45]0 ms late",
    ),
    "everything late": (
        lambda a: a | {name: late(a[name]) for name in SENSORS},
        "each sensor looks 50 ms late",
    ),
    "late landmark": (
        lambda a: one_of(a, "landmarks", 0, late),
        "landmark 0 looks 50 ms late",
    ),
    "very late": (
        lambda a: a | {"angular_velocity": np.roll(a["angular_velocity"], 35, axis=0)},
        "angular_velocity looks 200 ms or more late",
    ),
    "radians twice": (
        lambda a: a | {"angular_velocity": np.deg2rad(a["angular_velocity"])},
        "divided by 57.3 once too often",
    ),
    "degrees about one axis": (
        lambda a: a | {"angular_velocity": a["angular_velocity"] * [1, 57.3, 1]},
        "the y axis of angular_velocity alone looks like deg/s",
    ),
    "gyroscope, inertial": (
        lambda a: a | {"angular_velocity": to_inertial(a, a["angular_velocity"])},
        "angular_velocity looks as if it were in the inertial frame",
    ),
    "km/h": (
        lambda a: a | {"velocity": 3.6 * a["velocity"]},
        "velocity looks like km/h: divide by 3.6",
    ),
    "landmarks in cm": (
        lambda a: a | {"landmarks": 100 * a["landmarks"]},
        "landmarks look like cm: divide by 100",
    ),
    "a landmark in mm": (
        lambda a: one_of(a, "landmarks", 2, lambda y: 1000 * y),
        "landmark 2 looks like mm: divide by 1000",
    ),
    "true position in cm": (
        lambda a: a | {"truth_position": 100 * a["truth_position"]},
        "the true position looks like cm: divide by 100",
    ),
    "true position, north-east-down": (
        lambda a: a | {"truth_position": a["truth_position"][:, [1, 0, 2]] * [1, 1, -1]},
        "the true position looks north-east-down",
    ),
    "other body axes": (
        lambda a: a | {"truth_quaternion": (rotations(a) * TURNED).as_quat(scalar_first=True)},
        r"other body axes than the sensors': its \(x, y, z\) are their \(y, -x, z\) \(",
    ),
    "another inertial frame": (
        lambda a: (
            a
            | {
                "truth_quaternion": (TURNED * rotations(a)).as_quat(scalar_first=True),
                "truth_position": TURNED.apply(a["truth_position"]) + np.array([0, 0, 5]),
            }
        ),
        r"another inertial frame.*turn it by -90 deg .* shift it by \(.*, .*, -5\) m",
    ),
    "a landmark elsewhere": (
        lambda a: one_of(a, "landmark_references", 1, lambda p: p + np.array([1, 0, 0])),
        r"the reference of landmark 1 looks wrong: by the truth it is at \(-3, 4, .*\), 1 m",
    ),
    "landmarks mirrored": (
        lambda a: a | {"landmark_references": PLACES[:, [1, 0, 2]] * [1, 1, -1]},
        "the references of the landmarks look mirrored",
    ),
    "field elsewhere": (
        lambda a: one_of(a, "vector_references", 1, lambda r: r * [1, -1, 1]),
        r"the reference of vector 1 looks wrong: .*, (-)?180 deg about the vertical",
    ),
    "a velocity that is stuck": (
        lambda a: a | {"velocity": np.zeros_like(a["velocity"])},
        r"velocity never changes: it is \(0, 0, 0\) in all samples",
    ),
    "a jump of the truth": (
        lambda a: a | {"truth_position": jumped(a)},
        r"the true position jumps by 1e\+30 m in a step, at 7 s",
    ),
}
WITHOUT_TRUTH = ("degrees", "axis of the gyroscope", "axes of the velocity", "landmarks exchanged")


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_and_nothing_else(name: str) -> None:
    planted, words = MISTAKES[name]
    found = check(Recording.from_arrays(**planted(flown(count=BRIEF)))).findings
    assert len(found) == 1, found
    assert re.search(words, found[0])


@pytest.mark.parametrize("name", WITHOUT_TRUTH)
def test_some_are_named_without_a_truth(name: str) -> None:
    planted, words = MISTAKES[name]
    given = planted(flown(count=BRIEF)) | {"truth_quaternion": None, "truth_position": None}
    found = check(Recording.from_arrays(**given)).findings
    assert len(found) == 1, found
    assert re.search(words, found[0])


def test_vectors_of_very_different_units_are_named() -> None:
    """Otherwise a bias that is small for gravity would be larger than the whole field."""
    given = flown(count=BRIEF)
    for units, named in (([9.81, 1.0], False), ([9.81, 5e-5], True)):
        size = np.array(units)[:, None]
        changes = {key: given[key] * size for key in ("vectors", "vector_references")}
        findings = check(Recording.from_arrays(**given | changes)).findings
        assert len(findings) == named
        if named:
            assert_states(
                findings[0], "5.01e-05 to 9.81 long", "divide each vector and its reference"
            )


def test_two_mistakes_are_named_one_after_the_other() -> None:
    first, second = "axis of the gyroscope", "landmarks exchanged"
    planted = MISTAKES[second][0](MISTAKES[first][0](flown()))
    found = check(Recording.from_arrays(**planted)).findings
    assert len(found) == 2, found
    for name in (first, second):
        assert any(re.search(MISTAKES[name][1], words) for words in found)


@pytest.mark.parametrize("truth", [True, False])
def test_where_there_is_no_mistake_none_is_named(truth: bool) -> None:
    given = flown() if truth else flown() | {"truth_quaternion": None, "truth_position": None}
    found = check(Recording.from_arrays(**given))
    assert found.findings == []
    assert max(found.misfits.values()) < 0.1
    assert found.unobservable == ""


def test_noise_rate_and_bias_are_those_of_the_sensors() -> None:
    sensors = {one.name: one for one in check(Recording.from_arrays(**flown())).sensors}
    known = {"angular_velocity": 0.005, "velocity": 0.03, "vector 0": 0.02, "landmark 2": 0.03}
    for name, noise in known.items():
        assert sensors[name].noise == pytest.approx(noise, rel=0.15), name
    assert sensors["angular_velocity"].bias == pytest.approx(np.sqrt(6) * 0.01, rel=0.1)
    assert sensors["velocity"].bias == pytest.approx(np.sqrt(3) * 0.05, rel=0.1)
    assert sensors["landmark 1"].rate == pytest.approx(20)
    assert sensors["landmark 1"].gap == pytest.approx(0.05)
    assert sensors["vector 1"].rate == pytest.approx(100)


def test_the_noises_are_a_configuration(tmp_path) -> None:
    path = tmp_path / "found.toml"
    path.write_text(check(Recording.from_arrays(**flown())).settings)
    filter: Any = posegsa.load_config(path).filter
    assert filter.kind == "kalman"
    assert filter.angular_velocity == pytest.approx(0.0005, rel=0.15)
    assert filter.velocity == pytest.approx(0.003, rel=0.15)
    assert filter.landmark == pytest.approx(0.03, rel=0.15)
    assert filter.initial_linear_bias == pytest.approx(0.05, rel=0.15)
    assert check(posegsa.imu(**inertial_motion())).settings == ""


def test_noises_of_several_recordings_are_medians_and_the_largest_biases() -> None:
    one, other = (Recording.from_arrays(**flown(seed=seed)) for seed in (0, 1))
    first, second, both = found_noises([one]), found_noises([other]), found_noises([one, other])
    assert both["velocity"] == pytest.approx((first["velocity"] + second["velocity"]) / 2)
    biases = first["initial_linear_bias"], second["initial_linear_bias"]
    assert both["initial_linear_bias"] == max(biases)
    assert "linear_walk" not in both, "it is left to the search"


def test_a_start_that_is_off_has_deviations_as_large() -> None:
    usual = found_noises([Recording.from_arrays(**flown())])
    assert (usual["initial_attitude"], usual["initial_position"]) == (0.15, 0.25)
    off = found_noises([Recording.from_arrays(**flown()).off(90, 4.0)])
    assert off["initial_attitude"] == pytest.approx(np.pi / 2, rel=1e-3)
    assert off["initial_position"] == pytest.approx(4.0, rel=1e-3)
    unseen = flown() | {"landmarks": flown()["landmarks"].copy()}
    unseen["landmarks"][:200] = np.nan  # so that the start knows no position
    distance = np.linalg.norm(unseen["truth_position"][0])
    found = found_noises([Recording.from_arrays(**unseen)])
    assert found["initial_position"] == pytest.approx(distance, rel=1e-3)


def test_raw_inertial_sensors_are_compared_too() -> None:
    given = inertial_motion(rest=2, moving=20)
    recording = posegsa.imu(**given)
    assert check(recording).findings == []
    turned = given | {"mag": given["mag"] * [1, -1, 1]}
    (words,) = check(posegsa.imu(**turned)).findings
    assert "magnetometer: the sign of its y axis looks wrong" in words


@pytest.mark.parametrize("frame", UP)
def test_a_truth_in_another_frame_than_stated_is_named(frame: Frame) -> None:
    given = inertial_motion(rest=2, moving=20, frame=frame)
    for stated in UP:
        findings = check(posegsa.imu(**given, frame=stated)).findings
        if stated == frame:
            assert findings == []
        else:
            (words,) = findings
            assert f"looks like {frame}, not {stated}: --frame {frame}," in words


def test_an_accelerometer_of_the_wrong_sign_is_not_taken_for_another_frame() -> None:
    given = inertial_motion(rest=2, moving=20)
    (words,) = check(posegsa.imu(**given | {"acc": -given["acc"]})).findings
    assert "accelerometer and its reference look opposite" in words
    # Without a field both look the same, and both are said.
    del given["mag"]
    (words,) = check(posegsa.imu(**given | {"acc": -given["acc"]})).findings
    assert re.search(r"z axis points down \(NED\): --frame NED.*change its sign", words)


def test_a_field_off_north_is_no_other_frame() -> None:
    """By declination, or because the truth has a heading of its own."""
    given = inertial_motion(rest=2, moving=20)
    for degrees in (15, 45, 90, 180):
        turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        turned = given | {"truth_rotation": turn @ given["truth_rotation"]}
        assert check(posegsa.imu(**turned)).findings == []


def test_a_body_that_hardly_moves_gives_no_finding() -> None:
    given = flown()
    still = {
        name: np.repeat(given[name][:1], COUNT, axis=0)
        for name in ("vectors", "landmarks", "truth_quaternion", "truth_position")
    }
    zeros = {name: np.zeros((COUNT, 3)) for name in ("angular_velocity", "velocity")}
    found = check(Recording.from_arrays(**given | still | zeros))
    assert found.findings == []
    assert not {"gyroscope and truth", "velocity and truth"} & set(found.misfits)


def test_the_text_has_what_was_found() -> None:
    planted = MISTAKES["degrees"][0](flown())
    text = check(Recording.from_arrays(**planted)).text()
    for words in ("look: angular_velocity", "noise by axis", "landmark 2", "fits over 100 times"):
        assert words in text
    alone = flown() | {"vectors": None, "vector_references": None, "landmarks": None}
    alone |= {"landmark_references": None}
    text = check(Recording.from_arrays(**alone)).text()
    assert "can't be determined: found no vectors and no landmarks" in text


@pytest.mark.parametrize("factor", [1000.0, 1e-5])
def test_time_stamps_of_another_unit_are_refused(factor: float) -> None:
    given = flown() | {"time": factor * flown()["time"]}
    with pytest.raises(
        RecordingError, match=r'time: a median step .* line time_unit = "ms" .*toml'
    ):
        Recording.from_arrays(**given)


def test_something_else_is_refused() -> None:
    with pytest.raises(ArgumentError, match="recording"):
        posegsa.check("flight.csv")  # type: ignore[arg-type]  # wrong on purpose


def test_the_figure_has_a_panel_for_each_sensor() -> None:
    found = check(Recording.from_arrays(**flown()))
    axes = plot_check(found).axes
    assert len(axes) == 2 * len(found.sensors) == 14
    assert [ax.get_title(loc="left") for ax in axes[:2]] == [
        "angular velocity",
        "difference from the truth",
    ]
    untold = flown() | {"truth_quaternion": None, "truth_position": None}
    assert len(plot_check(check(Recording.from_arrays(**untold))).axes) == 7


def test_the_figure_shows_a_long_recording_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relations, "MAX_SAMPLES", 600)
    monkeypatch.setattr(relations, "PART_SAMPLES", 300)
    found = check(Recording.from_arrays(**flown()))
    drawn = plot_check(found).axes[0].lines[0].get_xdata()
    assert (drawn[0], drawn[-1]) == (found.recording.time[0], found.recording.time[-1])


def test_what_an_inertial_sensor_lacks_is_said() -> None:
    given = inertial_motion(rest=2, moving=8, noise=1.0, shaking=3.0)
    step, sensors = 1 / RATE, {"accelerometer": given["acc"], "magnetometer": given["mag"]}

    def text(*kept: str) -> str:
        some = {name: sensors[name] for name in kept}
        made = Recording.from_arrays(time_step=step, angular_velocity=given["gyr"], sensors=some)
        return check(made).text()

    assert "100 Hz, accelerometer, magnetometer, 0 landmarks" in text(*sensors)
    six = text("accelerometer")
    assert_states(
        six, "Without a magnetometer the heading is free", "The inclination is", "No mistake"
    )
    assert "no accelerometer (columns ax ay az" in text("magnetometer")
    assert_states(text(), "attitude can't be determined", "an accelerometer (columns ax ay az")
    # Motion is no noise of an accelerometer, whatever the truth.
    noises = {one.name: one.noise for one in check(posegsa.imu(**given)).sensors}
    assert noises["accelerometer"] == pytest.approx(0.1, rel=0.2)


def test_what_fits_nowhere_is_told_without_a_name_for_it() -> None:
    """Landmarks twice as far, and a field in microtesla."""
    a = flown()
    found = check(Recording.from_arrays(**a | {"landmarks": 2 * a["landmarks"]})).findings
    assert any("landmark 0 and truth do not fit" in words for words in found), found
    found = check(Recording.from_arrays(**one_of(a, "vectors", 1, lambda b: 48 * b))).findings
    assert found == [
        "vector 1 differs in length from its reference, by a factor of 48: another unit?"
    ]


def test_a_truth_with_gaps_makes_no_mistake_look_right() -> None:
    """Where it is missing it can't say what a velocity would be in another frame."""
    a = flown()
    seen = np.arange(COUNT)[:, None] % 300 > 100
    names = "truth_quaternion", "truth_position"
    a: Arguments = {**a, **{name: np.where(seen, a[name], np.nan) for name in names}}
    a["angular_velocity"] = 1.15 * a["angular_velocity"]  # which looks suspicious
    assert check(Recording.from_arrays(**a)).findings == []
    planted, words = MISTAKES["velocity, inertial"]
    inertial = planted(flown())["velocity"]
    (found,) = check(Recording.from_arrays(**a | {"velocity": inertial})).findings
    assert re.search(words, found)


def test_without_a_truth_it_is_not_said_to_agree_with_it() -> None:
    a = {name: value for name, value in flown().items() if not name.startswith("truth")}
    text = check(Recording.from_arrays(**a)).text()
    assert "there is no truth to compare them with" in text


def test_a_sensor_that_never_measured_is_reported() -> None:
    a = flown()
    landmarks = a["landmarks"].copy()
    landmarks[:, 1] = np.nan
    found = check(Recording.from_arrays(**a | {"landmarks": landmarks})).findings
    assert found == ["landmark 1 has no measurement"]
    vectors = a["vectors"].copy()
    vectors[:, 1] = np.nan
    found = check(Recording.from_arrays(**a | {"vectors": vectors})).findings
    assert found == ["vector 1 has no measurement"]


def driven(shake: float = 0.0, wander: float = 1.0, count: int = 3000) -> Arguments:
    """A flight with an accelerometer that measures all accelerations; truth by motion capture.

    Its thrust is along z, so that a wrong sign of y hardly changes the whole.
    """
    rng = np.random.default_rng(11)
    t = STEP * np.arange(count)
    at = wander * np.stack([np.sin(0.7 * t), 0.6 * np.cos(0.9 * t), 0.3 * np.sin(1.1 * t)], axis=1)
    speed, often = 2 * np.pi * 7, 2 * np.pi * np.array([7.0, 6.1, 8.3])
    P = at + shake / speed**2 * np.sin(often * t[:, None])
    pulled = -wander * np.stack(
        [0.49 * np.sin(0.7 * t), 0.486 * np.cos(0.9 * t), 0.363 * np.sin(1.1 * t)], axis=1
    ) - shake * (often / speed) ** 2 * np.sin(often * t[:, None])
    lean = np.arctan2(pulled[:, :2] * [1, -0.7], 9.81)  # so that little is felt across the thrust
    lean += 0.03 * np.sin(1.7 * t[:, None] + [0.0, 1.0])
    turn = Rotation.from_euler("zyx", np.stack([0.3 * t, *lean.T], axis=1))
    R = turn.as_matrix()
    rate = (turn[:-1].inv() * turn[1:]).as_rotvec() / STEP
    rate = np.concatenate([rate, rate[-1:]])
    moving = np.gradient(P, STEP, axis=0)
    force = np.einsum("kji,kj->ki", R, GRAVITY + pulled / 9.81)
    field = np.einsum("kji,j->ki", R, FIELD)
    vectors = np.stack([force, field], axis=1) + 0.01 * rng.normal(size=(count, 2, 3))
    landmarks = np.einsum("kji,knj->kni", R, PLACES - P[:, None])
    seen = turn * Rotation.from_rotvec(0.002 * rng.normal(size=(count, 3)))
    return {
        "time": t,
        "angular_velocity": rate + 0.005 * rng.normal(size=rate.shape),
        "velocity": np.einsum("kji,kj->ki", R, moving) + 0.03 * rng.normal(size=rate.shape),
        "vectors": vectors,
        "vector_references": np.stack([GRAVITY, FIELD]),
        "landmarks": landmarks + 0.03 * rng.normal(size=landmarks.shape),
        "landmark_references": PLACES,
        "truth_quaternion": seen.as_quat(scalar_first=True),
        "truth_position": P + 0.001 * rng.normal(size=P.shape),
        "landmark_outlier": "off",
    }


@pytest.mark.parametrize("truth", [True, False])
def test_an_accelerometer_that_is_shaken_has_no_mistake(truth: bool) -> None:
    given = driven(shake=30.0)
    lengths = np.linalg.norm(given["vectors"][:, 0], axis=1)
    assert np.median(lengths) > 2.5, "most of its measurement is not gravity"
    given |= {} if truth else {"truth_quaternion": None, "truth_position": None}
    assert check(Recording.from_arrays(**given)).findings == []


@pytest.mark.parametrize("shake", [10.0, 30.0])
def test_a_shaken_accelerometer_without_a_position_has_gravity(shake: float) -> None:
    given = driven(shake=shake)
    acc = 9.81 * given["vectors"][:, 0]
    names = "time", "angular_velocity", "truth_quaternion"
    alone: Arguments = {name: given[name] for name in names}
    whole = Recording.from_arrays(**alone, sensors={"accelerometer": acc})
    assert check(whole).findings == []
    rest = acc - 9.81 * true_rotations(given)[:, 2]
    without = Recording.from_arrays(**alone, sensors={"accelerometer": rest})
    (words,) = check(without).findings
    assert "without gravity" in words


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: -a, "accelerometer and its reference look opposite"),
        (lambda a: a / 9.81, "accelerometer looks like multiples of g"),
        (lambda a: a * [1, -1, 1], "accelerometer: the sign of its y axis looks wrong"),
        (lambda a: a[:, [1, 0, 2]], "accelerometer: its axes look exchanged"),
    ],
)
def test_a_mistake_of_an_accelerometer_shows_below_accelerations_larger_than_gravity(
    change: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    """A body that moves fast and to and fro; the truth has no position."""
    given = inertial_motion(rest=0, moving=60, shaking=15)
    assert check(posegsa.imu(**given)).findings == []
    recording = posegsa.imu(**given)
    changed = recording.sensors | {"accelerometer": change(given["acc"])}
    (found,) = check(replace(recording, sensors=changed)).findings
    assert words in found


def test_a_bias_is_told_only_where_the_motion_shows_it() -> None:
    def of(sensor: str, recording: Recording) -> float | None:
        return next(one.bias for one in check(recording).sensors if one.name == sensor)

    given, iron = inertial_motion(rest=2, moving=20, shaking=5), np.array([3.0, -4.0, 0.0])
    moved = posegsa.imu(**given | {"mag": given["mag"] + iron})
    assert of("magnetometer", moved) == pytest.approx(5.0, rel=0.02)
    assert of("accelerometer", moved) is None, "the truth has no position"
    assert re.search(r"accelerometer .* - +m/s\^2", check(moved).text())
    assert of("magnetometer", moved.window(0, 2)) is None, "the body rests"
    flight = driven()
    names = "time", "angular_velocity", "velocity", "truth_quaternion", "truth_position"
    acc = 9.81 * flight["vectors"][:, 0] + [0.3, 0.0, -0.4]
    some: Arguments = {name: flight[name] for name in names}
    flown = Recording.from_arrays(**some, sensors={"accelerometer": acc})
    assert of("accelerometer", flown) == pytest.approx(0.5, abs=0.02)


def test_a_noise_that_rounding_hides_is_not_told() -> None:
    """A field of 50 Hz in rows of 100 Hz, with midpoints between its measurements, or rounded."""
    given = inertial_motion(rest=2, moving=20, noise=1)
    slow = given["mag"][::2]
    between = np.stack([slow[:-1], 0.5 * (slow[:-1] + slow[1:])], axis=1).reshape(-1, 3)
    between = np.concatenate([between, slow[-1:], slow[-1:]])
    for mag in (between, 40.0 * np.round(given["mag"] / 40.0)):
        found = check(posegsa.imu(**given | {"mag": mag}))
        (field,) = [one for one in found.sensors if one.name == "magnetometer"]
        assert np.isnan(field.noise)
        assert re.search(r"magnetometer +100 +0\.01 +- ", found.text())
    (field,) = [one for one in check(posegsa.imu(**given)).sensors if one.name == "magnetometer"]
    assert field.noise > 0


@pytest.mark.parametrize("axis", [0, 1])
def test_the_sign_of_an_axis_across_the_thrust_is_detected(axis: int) -> None:
    sign = np.where(np.arange(3) == axis, -1.0, 1.0)
    flipped = one_of(driven(), "vectors", 0, lambda b: b * sign)
    (words,) = check(Recording.from_arrays(**flipped)).findings
    assert f"vector 0: the sign of its {'xyz'[axis]} axis looks wrong" in words


@pytest.mark.parametrize("seed", range(4))
def test_a_body_that_hardly_moves_has_no_late_sensor(seed: int) -> None:
    """The noise of the truth alone makes some shift fit best."""
    given, rng = driven(wander=0.001), np.random.default_rng(seed)
    given["velocity"] = given["velocity"] + 0.02 * rng.normal(size=given["velocity"].shape)
    position = given["truth_position"]
    given["truth_position"] = position + 0.001 * rng.normal(size=position.shape)
    assert check(Recording.from_arrays(**given)).findings == []


@pytest.mark.parametrize("repeats", [2, 5])
def test_a_velocity_that_is_held_has_its_own_rate_and_noise(repeats: int) -> None:
    given = driven()
    held = np.repeat(given["velocity"][::repeats], repeats, axis=0)
    found = check(Recording.from_arrays(**given | {"velocity": held}))
    (velocity,) = [one for one in found.sensors if one.name == "velocity"]
    assert velocity.rate == pytest.approx(100 / repeats)
    assert velocity.noise == pytest.approx(0.03, rel=0.25)
    assert found.findings == []
    assert f"velocity is held: measured at {100 / repeats:g} Hz" in found.text()
    alone = given | {"velocity": held, "truth_quaternion": None, "truth_position": None}
    found = check(Recording.from_arrays(**alone))
    (velocity,) = [one for one in found.sensors if one.name == "velocity"]
    assert velocity.noise == pytest.approx(0.03, rel=0.25)
