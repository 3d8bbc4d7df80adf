"""One sample in the form that a filter's step reads, by components."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.se3 import Matrix3, Vec3, add, rotate, vec3
from posegsa.model.vectors import VectorSamples, VectorSettings, Wahba, prepare_vectors


class LandmarkSample(NamedTuple):
    """One landmark in one sample, by components."""

    body: Vec3
    """y_i [m]."""
    inertial: Vec3
    """p_i [m]."""
    factor: Array
    """Factor on its weight, 0 if it is missing."""


class Sample(NamedTuple):
    """The measurements of one sample, by components of any common batch shape."""

    time_step: Array
    """[s]."""
    angular_velocity: Vec3
    """[rad/s], body frame."""
    velocity: Vec3
    """[m/s], body frame."""
    vectors: Wahba | VectorSamples
    """Wahba's sums, or the single vectors where the loop itself computes the sums."""
    landmarks: tuple[LandmarkSample, ...]
    reach: Array
    """Largest |y_i|^2 [m^2] of the measured landmarks; 0 if there are none."""


class Seen(NamedTuple):
    """A sample after correction by the current estimates."""

    wahba: Wahba
    freed: tuple[Vec3, ...]
    """d_i = v_i^B - c_i; () if the biases are not estimated."""
    landmark_weights: tuple[Array, ...]
    """s_i^L, 0 if the landmark is missing."""


def prepare(measurements: Measurements, settings: VectorSettings) -> Sample:
    """What the filter needs from the measurements, by components (pure, jittable).

    Works with and without a time axis; components have the shape of `time_step`.
    """
    factors = measurements.landmark_weights
    seen = jnp.where(factors[..., None] > 0, measurements.landmarks, 0.0)
    landmarks = tuple(
        LandmarkSample(
            body=vec3(seen[..., i, :]),
            inertial=vec3(measurements.landmark_references[..., i, :]),
            factor=factors[..., i],
        )
        for i in range(factors.shape[-1])
    )
    return Sample(
        time_step=measurements.time_step,
        angular_velocity=vec3(measurements.angular_velocity),
        velocity=vec3(measurements.velocity),
        vectors=prepare_vectors(measurements, settings),
        landmarks=landmarks,
        reach=jnp.max(jnp.sum(seen * seen, axis=-1), axis=-1, initial=0.0),
    )


def seen_from_estimate(state: FilterState, R: Matrix3, sample: Sample) -> tuple[Vec3, ...]:
    """x_i = T_est y_i, the estimated position of each landmark [m, inertial frame]."""
    return tuple(add(rotate(R, landmark.body), state.place) for landmark in sample.landmarks)
