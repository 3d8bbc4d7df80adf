"""Write your own filter
=====================

A complementary filter, run over an array and as a stream. ::

    python examples/own_filter.py
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import posegsa
from posegsa.filters.base import Record
from posegsa.model.sample import prepare
from posegsa.model.se3 import add, cross, move, rows, scale, subtract, unrotate
from posegsa.model.vectors import VectorSettings

UP, NORTH, BEACON = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [2.0, -1.5, 1.0]  # inertial frame


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ComplementaryFilter:
    """Integrates the velocities; vectors correct the attitude, landmarks the position."""

    attitude_gain: jax.Array  # [1/s]
    position_gain: jax.Array  # [1/s]
    bias_gain: jax.Array  # of the gyroscope's bias [1/s^2]

    def with_values(self, values):
        """The same filter with other numbers, for a search."""
        return replace(self, **values)

    def prepare(self, measurements):
        """The input of `step`."""
        return prepare(measurements, VectorSettings(each_agent=True))  # vectors one by one

    def start(self, initial, sensors):
        """The initial state; here it is the estimate itself."""
        return initial

    def ready(self):
        """Nothing to compute before the loop."""
        return self

    def step(self, state, now):
        """The state at the next sample."""
        sample, dt, R = now.sample, now.sample.time_step, rows(state.attitude)
        turn = pull = (jnp.zeros_like(dt),) * 3
        for vector in sample.vectors.each:  # its factor is 0 where it was not measured
            expected = unrotate(R, vector.known)
            turn = add(turn, scale(vector.factor, cross(vector.measured, expected)))
        for landmark in sample.landmarks:
            expected = unrotate(R, subtract(landmark.inertial, state.place))
            pull = add(pull, scale(landmark.factor, subtract(expected, landmark.body)))
        rate = subtract(sample.angular_velocity, state.bias_angular)
        omega = add(rate, scale(self.attitude_gain, turn))
        v = add(sample.velocity, scale(self.position_gain, pull))
        attitude, place = move(state.attitude, state.place, scale(dt, omega), scale(dt, v))
        bias = subtract(state.bias_angular, scale(dt * self.bias_gain, turn))
        return state._replace(attitude=attitude, place=place, bias_angular=bias), Record()

    def estimate(self, state):
        """Pose and biases of a state."""
        return state


# %%
# Measurements of a body that rotates and flies a circle; read your own from a file.


def made_measurements(samples):
    """The measurements of a body that rotates and flies a circle, and its true poses."""
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(samples)
    turn, bias = np.array([0.1, -0.2, 0.4]), np.array([0.02, -0.03, 0.01])  # [rad/s]
    attitude = Rotation.from_rotvec(time[:, None] * turn)  # body to inertial
    position = np.stack([np.sin(0.5 * time), np.cos(0.5 * time), 0.1 * time], axis=1)  # [m]
    to_body, velocity = attitude.inv(), np.gradient(position, time, axis=0)
    vectors = [to_body.apply(np.tile(v, (samples, 1))) for v in (UP, NORTH)]
    exact = {"angular_velocity": np.tile(turn + bias, (samples, 1))}
    exact |= {"velocity": to_body.apply(velocity), "vectors": np.stack(vectors, axis=1)}
    exact |= {"landmarks": to_body.apply(BEACON - position)[:, None]}
    sensed = {name: a + 0.02 * rng.normal(size=a.shape) for name, a in exact.items()}
    sensed["landmarks"][np.arange(samples) % 4 > 0] = np.nan  # the beacon is measured at 25 Hz
    return sensed, attitude, position


# %%
# The same filter over the arrays at once, and sample by sample: the errors of both are equal.


def main(samples=3001):
    sensed, attitude, position = made_measurements(samples)
    known = {"vector_references": np.array([UP, NORTH]), "landmark_references": np.array([BEACON])}
    start = {"rotation": Rotation.from_rotvec([1.5, 0, 0]).as_matrix(), "position": np.zeros(3)}
    own = ComplementaryFilter(*(jnp.asarray(gain) for gain in (1.0, 4.0, 0.2)))
    measurements = posegsa.Measurements.from_arrays(time_step=0.01, **sensed, **known)
    # Sample k is the estimate before measurement k; so is the k-th pose of the stream.
    run = posegsa.run_filter(own, measurements, posegsa.initial_state(**start))
    stream = posegsa.PoseFilter(own, **start, **known)
    each = ({name: a[k] for name, a in sensed.items()} for k in range(samples - 1))
    poses = [stream.pose, *(stream.update(time_step=0.01, **one) for one in each)]
    errors = []
    for R, P in ((run.rotation, run.position), map(np.array, zip(*poses, strict=True))):
        angle = (Rotation.from_matrix(R) * attitude.inv()).magnitude()
        errors.append((np.degrees(angle), np.linalg.norm(P - position, axis=1)))
    print("   time         run_filter            PoseFilter")
    for k in range(0, samples, samples // 6):
        both = "   ".join(f"{angle[k]:8.4f} deg {metres[k]:.4f} m" for angle, metres in errors)
        print(f"{run.time[k]:5.2f} s   {both}")
    _, axes = plt.subplots(2, sharex=True, layout="constrained")
    axes[0].semilogy(run.time, errors[0][0])
    axes[0].set_ylabel("attitude error [deg]")
    axes[1].semilogy(run.time, errors[0][1])
    axes[1].set(xlabel="time [s]", ylabel="position error [m]")
    return errors


if __name__ == "__main__":
    posegsa.enable_fast_path()
    main()
    plt.show()
