"""The sensors of one kind in turn: on a GPU written out, with the same results as a loop."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from posegsa.model import sensor_loops
from posegsa.model.sensor_loops import apart, in_turn, kept_as_loops, stacked

SENSORS = [(jnp.float32(i), (jnp.full(3, i + 0.5, jnp.float32), None)) for i in range(4)]


def step(carry: Array, sensor: Any) -> tuple[Array, tuple[Array, Array]]:
    number, (row, _) = sensor
    return 0.5 * carry + number, (carry * row, number)


def run() -> Any:
    last, found = in_turn(step, jnp.float32(1), stacked(SENSORS))
    # What one loop found is an input of the next one.
    total, _ = in_turn(lambda sums, one: (sums + one[0] * one[1], ()), jnp.zeros(3), found)
    return last, apart(found, len(SENSORS)), total


def test_sensors_written_out_are_those_of_a_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    want = run()
    assert "scan" in str(jax.make_jaxpr(lambda: run())())
    monkeypatch.setattr(sensor_loops, "on_gpu", lambda: True)
    got = run()
    assert "scan" not in str(jax.make_jaxpr(lambda: run())())
    jax.tree.map(np.testing.assert_array_equal, got, want)
    with kept_as_loops():  # for C
        assert "scan" in str(jax.make_jaxpr(lambda: run())())
