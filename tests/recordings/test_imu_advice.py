"""Advice about an inertial sensor from its own signals."""

import numpy as np
import pytest
from helpers.recordings import BIAS, RATE, inertial_motion

import posegsa
from posegsa.recordings.imu_advice import advice


def said(gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray | None) -> list[str]:
    return advice(gyr, acc, mag, 1 / RATE)


def well(**more: float) -> dict:
    """A sensor without a bias."""
    given = inertial_motion(**more)
    return given | {"gyr": given["gyr"] - BIAS}


@pytest.mark.quick
def test_there_is_no_advice_about_a_sensor_that_is_well() -> None:
    good = well(noise=0.1, shaking=3.0)
    assert said(good["gyr"], good["acc"], good["mag"]) == []
    assert said(good["gyr"], good["acc"], None) == []


def test_a_magnet_that_turns_with_the_body_is_suspected() -> None:
    good = well()
    size = np.linalg.norm(good["mag"][0])
    (words,) = said(good["gyr"], good["acc"], good["mag"] + 0.4 * size * np.eye(3)[0])
    assert "field's length varies" in words
    assert "magnet that is attached" in words


def test_a_field_of_another_length_in_motion_is_told_with_its_share() -> None:
    good = well()
    moving = good["judged"][:, None]
    (words,) = said(good["gyr"], good["acc"], np.where(moving, 1.2, 1.0) * good["mag"])
    assert "20 % between rest and motion" in words


def test_a_gyroscope_that_shows_motion_at_rest_gets_a_setting() -> None:
    good = well()
    (words,) = said(good["gyr"] + np.deg2rad([3.0, 0.0, 0.0]), good["acc"], good["mag"])
    assert "3.0 deg/s at rest" in words
    assert "filter.initial_bias = 0.1" in words


def test_a_large_bias_is_told_and_a_steady_rotation_is_none() -> None:
    good = well()
    (words,) = said(good["gyr"] + np.deg2rad([0.0, 20.0, 0.0]), good["acc"], good["mag"])
    assert "20.0 deg/s at rest" in words
    count, speed = round(20 * RATE), np.deg2rad(5.0)
    angle = speed * np.arange(count) / RATE
    turned = np.stack([np.cos(angle), -np.sin(angle), 0 * angle - 1.5], axis=1)
    still = np.ones((count, 1))
    assert said(still * [0, 0, speed], still * [0, 0, 9.81], turned) == []


@pytest.mark.parametrize("degrees", [7.0, 20.0, 45.0, 300.0, 720.0])
def test_a_steady_turn_about_the_vertical_is_no_bias(degrees: float) -> None:
    count, speed = round(20 * RATE), np.deg2rad(degrees)
    angle = speed * np.arange(count) / RATE
    field = np.stack([np.cos(angle), -np.sin(angle), 0 * angle - 1.5], axis=1)
    gyr, acc = np.tile([0, 0, speed], (count, 1)), np.tile([0, 0, 9.81], (count, 1))
    assert said(gyr, acc, None) == []
    assert said(gyr, acc, field) == []


@pytest.mark.parametrize("every", [100, 200])
def test_a_slow_magnetometer_shows_a_bias_too(every: int) -> None:
    good = inertial_motion(20.0, 0.0, noise=0.5)
    good["mag"][np.arange(len(good["mag"])) % every != 0] = np.nan
    for axis in np.eye(3):
        (words,) = said(good["gyr"] - BIAS + np.deg2rad(3.0) * axis, good["acc"], good["mag"])
        assert "3.0 deg/s at rest" in words


def test_a_sensor_that_misses_most_samples_gets_the_same_advice() -> None:
    good = well()
    size = np.linalg.norm(good["mag"][0])
    mag = good["mag"] + 0.4 * size * np.eye(3)[0]
    mag[np.arange(len(mag)) % 4 != 0] = np.nan
    good["acc"][::2] = np.nan
    (words,) = said(good["gyr"], good["acc"], mag)
    assert "field's length varies" in words


def test_an_accelerometer_out_of_scale_is_told() -> None:
    good = well()
    (words,) = said(good["gyr"], 0.95 * good["acc"], good["mag"])
    assert "9.32 m/s^2 at rest, 5 % less than gravity" in words


def test_missing_samples_and_short_recordings_are_no_reason() -> None:
    given = inertial_motion(0.0, 0.6)
    given["mag"][:] = np.nan
    given["acc"][::2] = np.nan
    with np.errstate(all="raise"):
        assert said(given["gyr"], given["acc"], given["mag"]) == []


def test_a_recording_describes_itself_with_its_advice() -> None:
    given = well()
    recording = posegsa.imu(**given | {"acc": 0.95 * given["acc"]})
    assert "\n  advice: the accelerometer shows 9.32" in recording.describe()


def test_a_field_of_zero_is_missing() -> None:
    good = well()
    good["mag"][::20] = 0.0
    assert said(good["gyr"], good["acc"], good["mag"]) == []
