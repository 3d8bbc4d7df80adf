"""Rest at the start of a recording."""

import numpy as np
import pytest
from helpers.recordings import BIAS, RATE, inertial_motion

from posegsa.recordings.rest import MARGIN, WINDOW, rest_at_start

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("rest", [2.0, 3.5, 10.0])
def test_it_lasts_until_shortly_before_the_motion(rest: float) -> None:
    given = inertial_motion(rest, 4.0, noise=1.0)
    found = rest_at_start(given["gyr"], given["acc"], 1 / RATE) / RATE
    # The motion begins slowly, so its start is detected only to about half a second.
    assert rest - MARGIN - WINDOW <= found <= rest
    resting = given["gyr"][: round(found * RATE)]
    np.testing.assert_allclose(resting.mean(axis=0), BIAS, atol=3e-3)


def test_a_recording_that_begins_in_motion_has_none() -> None:
    given = inertial_motion(0.0, 5.0)
    assert rest_at_start(given["gyr"], given["acc"], 1 / RATE) == 0


def test_all_of_a_recording_can_be_rest() -> None:
    given = inertial_motion(5.0, 0.0, noise=1.0)
    assert rest_at_start(given["gyr"], given["acc"], 1 / RATE) == 500


def test_an_even_turn_is_no_rest() -> None:
    acc = np.tile([0.0, 0.0, 9.81], (500, 1))
    assert rest_at_start(np.tile([0.0, 0.0, 0.5], (500, 1)), acc, 1 / RATE) == 0
    assert rest_at_start(np.tile([0.0, 0.0, 0.05], (500, 1)), acc, 1 / RATE) == 500


def test_missing_accelerations_are_passed_over() -> None:
    given = inertial_motion(3.0, 3.0)
    acc = given["acc"]
    expected = rest_at_start(given["gyr"], acc, 1 / RATE)
    acc[np.arange(len(acc)) % 4 > 0] = np.nan
    assert rest_at_start(given["gyr"], acc, 1 / RATE) == expected > 0
    acc[:] = np.nan
    assert rest_at_start(given["gyr"], acc, 1 / RATE) == 0


def test_too_short_a_recording_has_none() -> None:
    given = inertial_motion(0.5, 0.0)
    assert rest_at_start(given["gyr"], given["acc"], 1 / RATE) == 0
