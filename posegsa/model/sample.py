"""One sample in the form of the loop, by components: all that does not depend on the estimate."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.model.measurements import Measurements
from posegsa.model.se3 import Vec3, unstack
from posegsa.model.vectors import VectorSamples, VectorSettings, Wahba, prepare_vectors


class LandmarkSample(NamedTuple):
    """One landmark in one sample, by components."""

    body: Vec3
    """y_i [m]."""
    inertial: Vec3
    """p_i [m]."""
    factor: Array
    """Factor on its weight, 0 where it is missing."""


class Sample(NamedTuple):
    """What one sample tells the filter, by components of any common batch shape."""

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


def prepare(measurements: Measurements, settings: VectorSettings) -> Sample:
    """What the filter needs from the measurements, by components (pure, jittable).

    Works with and without a time axis; components have the shape of `time_step`.
    """
    factors = measurements.landmark_weights
    seen = jnp.where(factors[..., None] > 0, measurements.landmarks, 0.0)
    landmarks = tuple(
        LandmarkSample(
            body=_vec3(seen[..., i, :]),
            inertial=_vec3(measurements.landmark_references[..., i, :]),
            factor=factors[..., i],
        )
        for i in range(factors.shape[-1])
    )
    return Sample(
        time_step=measurements.time_step,
        angular_velocity=_vec3(measurements.angular_velocity),
        velocity=_vec3(measurements.velocity),
        vectors=prepare_vectors(measurements, settings),
        landmarks=landmarks,
        reach=jnp.max(jnp.sum(seen * seen, axis=-1), axis=-1, initial=0.0),
    )


def _vec3(a: Array) -> Vec3:
    x, y, z = unstack(a)
    return x, y, z
