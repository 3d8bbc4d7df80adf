"""Signals that repeat each value until the next is measured."""

import numpy as np
import pytest

from posegsa.recordings.held import held

COUNT = 1000


def noise(count: int = COUNT) -> np.ndarray:
    return np.random.default_rng(3).normal(size=(count, 3))


@pytest.mark.parametrize("rate", [90.0, 75.0, 60.0, 50.0, 40.0, 30.0, 10.0])
def test_the_last_value_of_a_slower_clock_is_found(rate: float) -> None:
    """Signals of 100 Hz."""
    last = np.floor(0.01 * np.arange(COUNT) * rate + 1e-9).astype(int)
    found = held(noise()[last])
    assert found.samples == pytest.approx(100 / rate, rel=0.02)
    np.testing.assert_array_equal(
        np.flatnonzero(found.fresh)[1:], 1 + np.flatnonzero(np.diff(last))
    )


def test_each_value_of_a_usual_signal_is_new() -> None:
    found = held(noise())
    assert found.samples == 1
    assert found.fresh.all()


def test_a_coarse_resolution_is_not_held() -> None:
    slow = np.cumsum(0.1 * noise(), axis=0)
    assert held(np.round(slow)).samples == 1


def test_a_rest_is_not_held() -> None:
    signal = noise()
    signal[300:700] = 0.0
    assert held(signal).samples == 1
    assert held(np.zeros((COUNT, 3))).samples == 1


def test_values_that_repeat_by_chance_are_not_held() -> None:
    """As often as those of a sensor of 75 Hz, but not regularly."""
    chance = np.random.default_rng(4).random(COUNT) < 0.75
    assert held(noise()[np.cumsum(chance)]).samples == 1
