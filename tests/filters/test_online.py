"""Flat arrays on-line: packing is reversible; filters of one structure share a program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.filters import settings

from posegsa.filters.observer import Observer
from posegsa.filters.online import Layout, OnlineLoop, OnlineParameters
from posegsa.model.estimate import initial_state
from posegsa.model.schedules import ConstantGain
from posegsa.model.signal import SignalSettings

pytestmark = pytest.mark.quick


def test_packed_values_are_unpacked_unchanged():
    record = {"a": np.arange(6.0).reshape(2, 3), "b": (np.array(7.0), np.zeros((0, 3)))}
    layout = Layout(record)
    flat = layout.pack(record, np.dtype("float32"))
    assert (flat.dtype, flat.shape, layout.size) == (np.float32, (7,), 7)
    again = layout.unpack(flat)
    assert jax.tree.structure(again) == jax.tree.structure(record)
    for got, want in zip(jax.tree.leaves(again), jax.tree.leaves(record), strict=True):
        np.testing.assert_array_equal(got, want)
        assert got.shape == want.shape


def test_layouts_are_equal_where_shapes_and_structure_are():
    one, same = Layout((np.zeros(3), np.zeros(()))), Layout((np.ones(3), np.ones(())))
    assert one == same
    assert hash(one) == hash(same)
    assert one != Layout((np.zeros(()), np.zeros(3)))
    assert one != Layout([np.zeros(3), np.zeros(())])


@pytest.mark.usefixtures("x64")
def test_filters_of_one_structure_are_compiled_once(caplog):
    def loop(gain: float, landmarks: int = 0) -> OnlineLoop:
        numbers = {"position_weight": gain, "smoothing": 0.0, "error_scale": 1.0, "rate_scale": 1.0}
        signal = SignalSettings(
            signal="measured",
            rate="per_sample",
            **{name: jnp.asarray(value) for name, value in numbers.items()},
        )
        parameters = OnlineParameters(
            Observer(ConstantGain(jnp.asarray(gain)), settings(gamma=(gain, gain)), signal),
            np.eye(3)[:1],
            np.ones((landmarks, 3)),
        )
        return OnlineLoop(parameters, initial_state(np.eye(3), np.zeros(3)))

    def gain_used(one: OnlineLoop) -> float:
        sample = np.zeros(one.sample_size)
        sample[1], sample[8:11], sample[11] = 0.01, [0.0, 1.0, 0.0], 1.0  # step, vector, its weight
        state = one.start(initial_state(np.eye(3), np.zeros(3)))
        return one.record.unpack(one(state, sample)).gain_used

    assert gain_used(loop(1.0)) == 1.0
    with jax.log_compiles():
        assert gain_used(loop(2.0)) == 2.0
        assert "Compiling" not in caplog.text
        gain_used(loop(2.0, landmarks=1))
        assert "Compiling" in caplog.text, "another structure"
