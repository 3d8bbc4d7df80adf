"""Signals in a wrong unit are detected."""

import numpy as np
import pytest
from helpers.recordings import RATE, inertial_motion

from posegsa.errors import RecordingError
from posegsa.recordings.units import check_units, gyroscope_unit

pytestmark = pytest.mark.quick
STEP = 1 / RATE


@pytest.mark.parametrize("shaking", [0.0, 2.0])
def test_the_gyroscope_s_unit_is_seen_in_the_acceleration(shaking: float) -> None:
    given = inertial_motion(1.0, 10.0, noise=1.0, shaking=shaking)
    unit = gyroscope_unit(given["gyr"], given["acc"], STEP)
    in_degrees = gyroscope_unit(np.degrees(given["gyr"]), given["acc"], STEP)
    assert unit is not None
    assert unit == pytest.approx(1.0, abs=0.2)
    assert in_degrees == pytest.approx(np.deg2rad(unit), rel=1e-9)


def test_degrees_per_second_are_refused() -> None:
    given = inertial_motion(1.0, 10.0, noise=1.0, shaking=2.0)
    check_units(given["gyr"], given["acc"], STEP)
    with pytest.raises(RecordingError, match=r"gyr: .* deg/s.*rad/s"):
        check_units(np.degrees(given["gyr"]), given["acc"], STEP)


def test_what_no_gyroscope_measures_is_refused_though_the_body_shakes() -> None:
    rng = np.random.default_rng(0)
    gyr, acc = rng.normal(0, 3, (500, 3)), rng.normal(0, 10, (500, 3))
    check_units(gyr, acc, STEP)
    gyr[:4] = 1000.0  # outliers
    check_units(gyr, acc, STEP)
    with pytest.raises(RecordingError, match=r"gyr: is above 75 in .* deg/s"):
        check_units(np.degrees(gyr), acc, STEP)


def test_accelerations_alone_are_no_sign_of_degrees() -> None:
    """A body that is thrown about for 20 s: its accelerations do not follow its turns."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        gyr, acc = (np.repeat(rng.normal(0, size, (200, 3)), 10, axis=0) for size in (6, 8))
        check_units(gyr, acc, STEP)


@pytest.mark.parametrize("every", [2, 10])
def test_a_slow_accelerometer_shows_degrees_too(every: int) -> None:
    given = inertial_motion(1.0, 10.0, noise=1.0)
    given["acc"][np.arange(len(given["acc"])) % every != 0] = np.nan
    check_units(given["gyr"], given["acc"], STEP)
    with pytest.raises(RecordingError, match=r"gyr: .* deg/s"):
        check_units(np.degrees(given["gyr"]), given["acc"], STEP)


def test_where_little_turns_nothing_is_said_of_the_gyroscope() -> None:
    given = inertial_motion(5.0, 0.0, noise=1.0)
    assert gyroscope_unit(given["gyr"], given["acc"], STEP) is None
    assert gyroscope_unit(given["gyr"][:5], given["acc"][:5], STEP) is None
    check_units(np.degrees(given["gyr"]), given["acc"], STEP)


def test_acceleration_in_g_without_gravity_or_missing_is_refused() -> None:
    given = inertial_motion(1.0, 1.0)
    gyr, acc = given["gyr"], given["acc"]
    with pytest.raises(RecordingError, match=r"acc: .*multiples of g.*m/s\^2"):
        check_units(gyr, acc / 9.80665, STEP)
    with pytest.raises(RecordingError, match=r"acc: .*with gravity in it"):
        check_units(gyr, 0.01 * acc, STEP)
    with pytest.raises(RecordingError, match=r"acc: .*with gravity in it"):
        check_units(gyr, 1000 * acc, STEP)
    with pytest.raises(RecordingError, match="acc: holds no finite sample"):
        check_units(gyr, np.full_like(acc, np.nan), STEP)
