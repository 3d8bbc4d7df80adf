"""A user's filter that breaks the protocol: the error names its function and what is allowed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.own_filter import Complementary
from jax import Array

import posegsa
from posegsa.errors import ArgumentError
from posegsa.filters.base import Record
from posegsa.model.estimate import FilterState
from posegsa.model.sample import prepare
from posegsa.model.se3 import scale
from posegsa.model.vectors import VectorSettings

pytestmark = pytest.mark.quick

SAMPLES = 4
SENSED: dict[str, Any] = {
    "angular_velocity": np.full((SAMPLES, 3), 0.1),
    "velocity": np.ones((SAMPLES, 3)),
    "vectors": np.tile(np.eye(3)[:2], (SAMPLES, 1, 1)),
    "landmarks": np.ones((SAMPLES, 1, 3)),
}
REFERENCES = {"vector_references": np.eye(3)[:2], "landmark_references": np.ones((1, 3))}
POSE = {"rotation": np.eye(3), "position": np.zeros(3)}


class Own(NamedTuple):
    """A state of one's own."""

    pose: FilterState
    level: Any


class Unknown:
    """A class that JAX does not know."""


def over_arrays(own: Any) -> np.ndarray:
    sensed = posegsa.Measurements.from_arrays(time_step=0.01, **SENSED, **REFERENCES)
    return np.asarray(posegsa.run_filter(own, sensed, posegsa.initial_state(**POSE)).position)


def over_a_recording(own: Any) -> np.ndarray:
    recording = posegsa.Recording.from_arrays(time_step=0.01, **SENSED, **REFERENCES)
    return posegsa.run_filter(own, recording, posegsa.initial_state(**POSE)).position


def streamed(own: Any) -> np.ndarray:
    stream = posegsa.PoseFilter(own, **POSE, **REFERENCES)
    each = ({name: a[k] for name, a in SENSED.items()} for k in range(SAMPLES - 1))
    poses = [stream.pose, *(stream.update(time_step=0.01, **one) for one in each)]
    return np.array([pose.position for pose in poses])


def in_c(own: Any) -> str:
    return posegsa.filter_to_c(own, vectors=np.eye(3)[:2], landmarks=np.ones((1, 3)))


WAYS: tuple[Callable[[Any], Any], ...] = (over_arrays, over_a_recording, streamed, in_c)


def made(**functions: Any) -> Any:
    """A filter of one's own with some of its functions replaced."""
    kind = jax.tree_util.register_dataclass(
        dataclass(frozen=True)(type("Mine", (Complementary,), functions))
    )
    return kind(jnp.float32(1.0), jnp.float32(1.0))


def leaning(self, state, now):
    """A step with an if on a traced value."""
    if state.place[0] > 0:
        state = state._replace(place=state.bias_linear)
    return state, Record()


def with_level(level: Any, after: Callable[[Any], Any] = lambda level: level) -> dict[str, Any]:
    """Functions of a filter whose state has a level beside the pose; `after` is that of a step."""

    def step(self, state, now):
        pose, record = Complementary.step(self, state.pose, now)
        return Own(pose, after(state.level)), record

    return {
        "start": lambda self, initial, sensors: Own(initial, level),
        "step": step,
        "estimate": lambda self, state: state.pose,
    }


MISTAKES = {
    "a step without a record": (
        {"step": lambda self, state, now: state},
        r"Mine.step: returns a FilterState; allowed: \(state, record\)",
    ),
    "a step that returns nothing": (
        {"step": lambda self, state, now: None},
        r"Mine.step: returns a NoneType; allowed: \(state, record\)",
    ),
    "a record that is a dict": (
        {"step": lambda self, state, now: (state, {"gain": 1.0})},
        r"Mine.step: its record is a dict; allowed: .*a Record, such as Record\(\)",
    ),
    "an estimate that is the state": (
        with_level(0.0) | {"estimate": lambda self, state: state},
        "Mine.estimate: returns a Own; allowed: a FilterState",
    ),
    "an estimate with an array": (
        {"estimate": lambda self, state: state._replace(place=jnp.stack(state.place))},
        r"Mine.estimate: returns components 4 \(attitude\), no tuple \(place\), .*allowed: a Fil",
    ),
    "an if on a traced value": (
        {"step": leaning},
        "Mine.step: uses the state or the sample outside JAX, .*allowed: jax.numpy, and jnp.where",
    ),
    "a number of NumPy": (
        {"estimate": lambda self, state: FilterState(*map(np.asarray, state))},
        "Mine.estimate: uses the state outside JAX",
    ),
    "a state that changes its shape": (
        with_level(0.0, lambda level: jnp.stack([level, level])),
        r"Mine.step: state.level is .*\[\] before, .*\[2\] after; allowed: .*as that of `start`",
    ),
    "a state that changes its type": (
        with_level(jnp.float32(0.0), lambda level: level > 0),
        "Mine.step: state.level is float32.* before, bool.* after; allowed",
    ),
    "a state that loses a number": (
        with_level((0.0, 0.0), lambda level: level[:1]),
        r"Mine.step: state.level\[1\] is in the state before it; allowed",
    ),
    "a state that changes its class": (
        with_level((0.0, 0.0), list),
        "Mine.step: its state has other classes than the one before; allowed",
    ),
    "a step with a class that JAX does not know": (
        with_level(0.0, lambda level: Unknown()),
        "Mine.step: its state holds a Unknown; allowed: numbers, .*register_dataclass",
    ),
}


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
@pytest.mark.parametrize("name", MISTAKES)
def test_what_is_wrong_is_named(name: str, way: Callable[[Any], Any]) -> None:
    functions, message = MISTAKES[name]
    if name == "a state that changes its type" and way is in_c:
        message = "Mine.step: state.level"  # its numbers are float64
    with pytest.raises(ArgumentError, match=message):
        way(made(**functions))


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_vectors_one_by_one_that_were_not_asked_for(way: Callable[[Any], Any]) -> None:
    functions = {
        "prepare": lambda self, measurements: prepare(measurements, VectorSettings()),
        "step": lambda self, state, now: (state, Record(gain=len(now.sample.vectors.each))),
    }
    with pytest.raises(ArgumentError, match=r"vectors.*; allowed: .*VectorSettings\(each_agent=T"):
        way(made(**functions))


@pytest.mark.parametrize("way", [over_arrays, streamed, in_c], ids=lambda way: way.__name__)
def test_a_start_with_a_class_that_jax_does_not_know(way: Callable[[Any], Any]) -> None:
    with pytest.raises(ArgumentError, match=r"Mine.start: its state holds a Unknown"):
        way(made(**with_level(Unknown())))


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_a_filter_that_jax_does_not_know(way: Callable[[Any], Any]) -> None:
    kind = dataclass(frozen=True)(type("Mine", (Complementary,), {}))
    with pytest.raises(ArgumentError, match="the class Mine, which JAX does not know; allowed"):
        way(kind(jnp.float32(1.0), jnp.float32(1.0)))


@pytest.mark.parametrize("way", WAYS[:-1], ids=lambda way: way.__name__)
def test_python_numbers_in_a_state_and_an_estimate_are_arrays(way: Callable[[Any], Any]) -> None:
    def estimate(self, state):
        return state.pose._replace(bias_linear=(0.0, 0.0, 0.0))

    def step(self, state, now):
        pose, record = Complementary.step(self, state.pose, now)
        return Own(pose._replace(place=scale(0.5 + state.level, pose.place)), 0.5), record

    plain = with_level(0.5) | {"step": step, "estimate": estimate}
    given = way(made(**plain))
    assert np.isfinite(given).all()
    assert np.ptp(given, axis=0).min() > 0
    np.testing.assert_array_equal(given, way(made(**plain | with_level(jnp.float32(0.5)) | plain)))


def test_a_filter_with_python_numbers_in_its_state_is_written_as_c() -> None:
    assert "level" in in_c(made(**with_level(0.5)))


def test_a_filter_that_is_right_is_stepped() -> None:
    own, one = made(), posegsa.Measurements.from_arrays(time_step=0.01, **SENSED, **REFERENCES)
    state = own.start(posegsa.initial_state(**POSE), posegsa.Sensors(2, 1))
    after, record = posegsa.step(own, state, one.at(0))
    assert record == Record()
    assert isinstance(after.place[0], Array)
    with pytest.raises(ArgumentError, match=r"Mine.step: returns a FilterState"):
        posegsa.step(made(step=lambda self, state, now: state), state, one.at(0))
