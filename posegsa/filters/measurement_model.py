"""The measurement model of a Kalman filter: derivatives and predictions of its sensors.

The equations are those of `filters.kalman`: a vector is R^T v^I + c_i, a landmark R^T (p - P).
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import Array

from posegsa.filters.covariance import VECTORS, Row
from posegsa.model.elementwise import choose, maximum
from posegsa.model.estimate import FilterState
from posegsa.model.sample import LandmarkSample, Sample
from posegsa.model.se3 import Matrix3, Vec3, add, dot, rows, safe_sqrt, subtract, unrotate
from posegsa.model.sensor_loops import in_turn, stacked
from posegsa.model.vectors import VectorSample, VectorSamples


def vector_rows(R: Matrix3, vector: VectorSample, bias: Vec3 | None) -> tuple[list[Row], Vec3]:
    """Derivatives of a vector's components, its bias at `VECTORS`, and measured less predicted."""
    known = unrotate(R, vector.known)
    expected = known if bias is None else add(known, bias)
    each: list[Row] = [
        per_theta | ({} if bias is None else {VECTORS + axis: 1.0})
        for axis, per_theta in enumerate(_cross_rows(known))
    ]
    return each, subtract(vector.measured, expected)


def landmark_rows(R: Matrix3, place: Vec3, landmark: LandmarkSample) -> tuple[list[Row], Vec3]:
    """Derivatives of a landmark's coordinates, and measured less predicted."""
    expected = unrotate(R, subtract(landmark.inertial, place))
    each: list[Row] = [
        per_theta | {3 + axis: -1.0} for axis, per_theta in enumerate(_cross_rows(expected))
    ]
    return each, subtract(landmark.body, expected)


def with_biases(vectors: tuple[VectorSample, ...], estimate: FilterState) -> Any:
    """Vectors with their estimated biases, or with None, stacked for a loop."""
    biases = estimate.vector_biases or (None,) * len(vectors)
    return stacked(zip(vectors, biases, strict=True))


def measured_error(
    estimate: FilterState, sample: Sample, vector: Array, landmark: Array
) -> tuple[Array, Array]:
    """Root mean square residual in standard deviations of the noises, and whether there is one.

    A sensor that is believed less has a lower weight here too. The sums of a loop
    store nothing, so that they can be written as C.

    Args:
        estimate: Before the sample, of the batch shape.
        sample: With its vectors as measured, and the weights after belief.
        vector: Standard deviation of each component of a vector, in its unit.
        landmark: Standard deviation of each coordinate of a landmark [m].
    """
    R, zero = rows(estimate.attitude), jnp.zeros_like(estimate.place[0])

    def add(sums: tuple[Array, Array], off: Vec3, deviation: Array, factor: Array) -> Any:
        total, count = sums
        seen = factor > 0
        square = dot(off, off) / (3 * variance_of(deviation, factor))
        return (total + choose(seen, square, 0.0), count + choose(seen, zero + 1, 0.0)), None

    def by_vector(sums: tuple[Array, Array], given: Any) -> Any:
        _, off = vector_rows(R, *given)
        return add(sums, off, vector, given[0].factor)

    def by_landmark(sums: tuple[Array, Array], seen: LandmarkSample) -> Any:
        _, off = landmark_rows(R, estimate.place, seen)
        return add(sums, off, landmark, seen.factor)

    sums = zero, zero
    if vectors := sample.vectors.each:
        sums, _ = in_turn(by_vector, sums, with_biases(vectors, estimate))
    if sample.landmarks:
        sums, _ = in_turn(by_landmark, sums, stacked(sample.landmarks))
    total, count = sums
    return safe_sqrt(total / maximum(count, 1.0)), count > 0


def weighted(sample: Sample, vectors: Sequence[Array], landmarks: Sequence[Array]) -> Sample:
    """A sample with other weights of its sensors."""
    assert isinstance(sample.vectors, VectorSamples)
    pairs = zip(sample.vectors.each, vectors, strict=True)
    points = zip(sample.landmarks, landmarks, strict=True)
    return sample._replace(
        vectors=sample.vectors._replace(each=tuple(v._replace(factor=w) for v, w in pairs)),
        landmarks=tuple(p._replace(factor=w) for p, w in points),
    )


def _cross_rows(a: Vec3) -> tuple[Row, Row, Row]:
    """Rows of [a]x, over theta."""
    return {1: -a[2], 2: a[1]}, {0: a[2], 2: -a[0]}, {0: -a[1], 1: a[0]}


def variance_of(deviation: Array, factor: Array) -> Array:
    """Variance of a measurement with this weight; arbitrary if it is missing."""
    return deviation * deviation / choose(factor > 0, factor, 1.0)
