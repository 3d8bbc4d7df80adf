"""A filter of the user's own, with two numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.filters.base import Record, Samples, Sensors
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, prepare
from posegsa.model.se3 import Vec3, add, cross, move, rows, scale, subtract, unrotate
from posegsa.model.vectors import VectorSamples, VectorSettings


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Complementary:
    """Integrates the velocities; vectors correct the attitude, landmarks the position."""

    attitude_gain: Array
    """[1/s]"""
    position_gain: Array
    """[1/s]"""

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with other numbers."""
        return replace(self, **values)

    def prepare(self, measurements: Measurements) -> Sample:
        """Each vector alone."""
        return prepare(measurements, VectorSettings(each_agent=True))

    def start(self, initial: FilterState, sensors: Sensors) -> FilterState:
        """The estimate itself."""
        del sensors
        return initial

    def ready(self) -> Self:
        """Nothing to compute before the loop."""
        return self

    def step(self, state: FilterState, now: Samples) -> tuple[FilterState, Record]:
        """One sample, by its measurements and velocities."""
        sample, dt, R = now.sample, now.sample.time_step, rows(state.attitude)
        zero = jnp.zeros_like(dt)
        turn: Vec3 = (zero, zero, zero)
        pull: Vec3 = (zero, zero, zero)
        assert isinstance(sample.vectors, VectorSamples)
        for vector in sample.vectors.each:
            expected = unrotate(R, vector.known)
            turn = add(turn, scale(vector.factor, cross(vector.measured, expected)))
        for landmark in sample.landmarks:
            expected = unrotate(R, subtract(landmark.inertial, state.place))
            pull = add(pull, scale(landmark.factor, subtract(expected, landmark.body)))
        omega = add(sample.angular_velocity, scale(self.attitude_gain, turn))
        v = add(sample.velocity, scale(self.position_gain, pull))
        attitude, place = move(state.attitude, state.place, scale(dt, omega), scale(dt, v))
        return state._replace(attitude=attitude, place=place), Record()

    def estimate(self, state: FilterState) -> FilterState:
        """Pose and biases."""
        return state
