"""Measurements of landmarks at impossible positions get weight 0; all others keep theirs."""

from typing import Any

import numpy as np
import pytest
from helpers.messages import assert_states
from helpers.recordings import motion

from posegsa.errors import PosegsaWarning, RecordingError
from posegsa.recordings.outliers import without_outliers
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.quick


def noisy(noise: float = 0.03, **changes: Any) -> dict[str, Any]:
    given = motion(**changes)
    rng = np.random.default_rng(0)
    given["landmarks"] = given["landmarks"] + noise * rng.normal(size=given["landmarks"].shape)
    return given


def passed_over(given: dict[str, Any], **more: Any) -> list[tuple[int, int]]:
    """(sample, landmark) of each measurement that has weight 0."""
    recording = Recording.from_arrays(**given, **more)
    seen = np.isfinite(given["landmarks"]).all(axis=-1)
    lost = seen & (recording.measurements.landmark_weights == 0)
    return [(int(k), int(i)) for k, i in np.argwhere(lost)]


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.03, 0.3])
@pytest.mark.parametrize("every", [1, 7, 50])
def test_where_there_is_no_outlier_none_is_found(noise: float, every: int) -> None:
    given = noisy(noise)  # with a biased gyroscope
    given["landmarks"][np.arange(400) % every != 0] = np.nan
    given["landmarks"][150:300, 1] = np.nan  # out of sight for 1.5 s
    assert not passed_over(given)
    given["velocity"] = np.zeros((400, 3))  # no velocity sensor
    assert not passed_over(given)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_an_outlier_is_found_in_any_place() -> None:
    given = noisy()
    wrong = [(3, 0), (120, 1), (250, 0), (250, 2), (251, 2), (399, 1)]
    for k, i in wrong:
        given["landmarks"][k, i] += [2.0, -1.0, 1.5 + k % 7]
    assert passed_over(given) == wrong
    given["landmarks"][200] = np.roll(given["landmarks"][200], 1, axis=0)  # mistaken for each other
    assert passed_over(given) == sorted([*wrong, (200, 0), (200, 1), (200, 2)])
    assert passed_over(given, landmark_outlier="off") == []
    assert passed_over(given, landmark_outlier=1e3) == []


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_what_lasts_is_believed_after_one_sighting() -> None:
    first = noisy()
    first["landmarks"][0, 0] += 3.0
    assert passed_over(first) == [(1, 0)]
    moved = noisy()
    moved["landmarks"][200:, 2] += 3.0
    assert passed_over(moved) == [(200, 2)]
    garbage = noisy()  # a sensor that measures garbage and then recovers
    garbage["landmarks"][100:170, 1] = np.random.default_rng(1).uniform(-50, 50, (70, 3))
    assert passed_over(garbage) == [(k, 1) for k in range(100, 170)]


def test_it_is_counted_and_reported() -> None:
    given = noisy()
    given["landmarks"][[120, 121], 1] += [[3.0, 0, 0], [0, 0, -4.0]]
    with pytest.warns(PosegsaWarning, match=r"2 sightings.*landmark 1"):
        recording = Recording.from_arrays(**given)
    (note,) = recording.notes
    assert_states(note, "2 sightings", "7 times", "2 of landmark 1", "1.2 s")
    assert note in recording.describe()


def test_a_saved_recording_passes_over_nothing_more(tmp_path: Any) -> None:
    given = noisy()
    given["landmarks"][0, 0] += 3.0
    with pytest.warns(PosegsaWarning, match="1 sighting"):
        recording = Recording.from_arrays(**given)
    recording.save(tmp_path / "one.npz")
    again = Recording.from_npz(tmp_path / "one.npz")
    assert again.notes == recording.notes
    np.testing.assert_array_equal(
        again.measurements.landmark_weights, recording.measurements.landmark_weights
    )
    with np.load(tmp_path / "one.npz") as held:
        arrays = dict(held)
    np.savez(tmp_path / "own.npz", **arrays | {"landmark_outlier": 5.0})
    with pytest.warns(PosegsaWarning, match="5 times"):
        Recording.from_npz(tmp_path / "own.npz")


@pytest.mark.parametrize("factor", [0.5, np.nan, np.inf, "on", True, None])
def test_a_factor_is_a_number_or_off(factor: Any) -> None:
    with pytest.raises(RecordingError, match=r"landmark_outlier = .*allowed: a number from 1 on"):
        Recording.from_arrays(**motion(), landmark_outlier=factor)


def test_the_limit_grows_with_the_root_of_the_time_between_two_sightings() -> None:
    rng = np.random.default_rng(2)
    at = np.array([*range(50), 58, *range(59, 80)])
    y = np.full((80, 1, 3), np.nan)
    y[at, 0] = [5.0, 0, 0] + 0.05 * rng.normal(size=(len(at), 3))
    median = np.median(np.linalg.norm(np.diff(y[at, 0], axis=0), axis=1))
    limit = 7 * median * 3  # 9 samples after the previous one, not 1
    still = np.zeros((80, 3))
    for jump, expected in ((1.15 * limit, 1), (0.85 * limit, 0)):
        moved = y.copy()
        moved[58:, 0] += [0, jump, 0]
        values = {
            "time_step": np.full(80, 0.01),
            "angular_velocity": still,
            "velocity": still,
            "landmarks": moved,
            "landmark_weights": np.isfinite(y[..., 0]).astype(float),
        }
        before = values["landmark_weights"]
        without_outliers(values, 0.01 * np.arange(80), 7)
        lost = before - values["landmark_weights"]
        assert lost.sum() == expected
        assert lost[58, 0] == expected
