"""The noise of each sensor, found while a filter runs from how far successive samples differ.

White noise of variance s^2 makes two successive samples differ by 2 s^2 in the mean square,
whatever both have in common: the *mean square successive difference* (J. von Neumann, R. H. Kent,
H. R. Bellinson, B. I. Hart, Annals of Mathematical Statistics 12, 1941). So a sensor that is off
for a while, an estimate that is wrong or a body that has been moved are not taken for noise: they
count only at the samples where they begin and end. Each sensor has a factor f on the variance that
is stated for it, 1 at first. At each of its samples but the first

    f <- f (1 + (min(q / f, 5) - 1) / n),    q = |r_k - r_k-1|^2 / (6 s^2),

r its residual, measured less predicted at the estimate before the sample, or the velocity itself, s
the standard deviation stated for each of its three components, and n the memory in samples. The
factor from the samples before is the one that is used. The motion within one step counts as noise
of a velocity.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.filters.measurement_model import (
    landmark_rows,
    variance_of,
    vector_rows,
    weighted,
    with_biases,
)
from posegsa.model.elementwise import choose, maximum, minimum
from posegsa.model.estimate import FilterState
from posegsa.model.sample import LandmarkSample, Sample
from posegsa.model.se3 import Vec3, dot, rows, subtract
from posegsa.model.sensor_loops import apart, in_turn, stacked

LARGEST = 5.0
"""Of q / f, so that a single jump hardly counts. White noise exceeds it in 0.2 % of all samples."""
BOUNDS = 1e-2, 1e2
"""Of f: standard deviations from a tenth to ten times those that are stated."""


class NoiseLevel(NamedTuple):
    """What is known of one sensor's noise."""

    factor: Array
    """f, on the variance that is stated."""
    last: Vec3
    """The last residual or velocity, in the sensor's unit."""
    known: Array
    """1 if there is a last one, else 0."""


class NoiseLevels(NamedTuple):
    """Those of all sensors."""

    angular_velocity: NoiseLevel
    velocity: NoiseLevel
    vectors: tuple[NoiseLevel, ...]
    landmarks: tuple[NoiseLevel, ...]


def stated(sensors: Sequence[int], like: Array) -> NoiseLevels:
    """Before the first sample, in the shape and dtype of `like`: the noises are those stated.

    Args:
        sensors: how many vectors and landmarks there are.
        like: any number of the state.
    """
    zero = jnp.zeros_like(like)
    one = NoiseLevel(zero + 1, (zero, zero, zero), zero)
    vectors, landmarks = sensors
    return NoiseLevels(one, one, (one,) * vectors, (one,) * landmarks)


def next_level(
    level: NoiseLevel, now: Vec3, variance: Array, seen: Array, memory: Array
) -> NoiseLevel:
    """After one more residual, or velocity.

    Args:
        level: before it.
        now: the residual or velocity, in the sensor's unit.
        variance: stated for each of its components, the unit squared.
        seen: whether it was measured.
        memory: n, in samples.
    """
    step = subtract(now, level.last)
    q = dot(step, step) / (6 * variance)
    more = minimum(q / level.factor, LARGEST) - 1
    factor = maximum(minimum(level.factor * (1 + more / memory), BOUNDS[1]), BOUNDS[0])
    counts = choose(seen, level.known, 0.0) > 0
    kept = [choose(seen, new, old) for new, old in zip(now, level.last, strict=True)]
    return NoiseLevel(
        choose(counts, factor, level.factor),
        (kept[0], kept[1], kept[2]),
        choose(seen, jnp.ones_like(level.known), level.known),
    )


def at_levels(sample: Sample, levels: NoiseLevels) -> Sample:
    """The sample, each measurement's weight divided by the factor on the sensor's variance."""
    vectors = zip(sample.vectors.each, levels.vectors, strict=True)
    landmarks = zip(sample.landmarks, levels.landmarks, strict=True)
    return weighted(
        sample,
        [sensor.factor / level.factor for sensor, level in vectors],
        [sensor.factor / level.factor for sensor, level in landmarks],
    )


def next_levels(
    levels: NoiseLevels,
    estimate: FilterState,
    sample: Sample,
    deviations: Sequence[Array],
    memory: Array,
) -> NoiseLevels:
    """The levels after a sample, of the batch shape.

    Args:
        levels: before it.
        estimate: before it.
        sample: with its vectors as measured, and the weights that are stated.
        deviations: the densities of both velocities' noise, [rad/sqrt(s)] and [m/sqrt(s)], and the
            standard deviations of a component of a vector and of a landmark [m].
        memory: n, in samples.
    """
    R = rows(estimate.attitude)
    angular, linear, vector, landmark = deviations

    def by_vector(nothing: tuple[()], given: Any) -> Any:
        level, (seen, bias) = given
        _, off = vector_rows(R, seen, bias)
        variance = variance_of(vector, seen.factor)
        return nothing, next_level(level, off, variance, seen.factor > 0, memory)

    def by_landmark(nothing: tuple[()], given: tuple[NoiseLevel, LandmarkSample]) -> Any:
        level, seen = given
        _, off = landmark_rows(R, estimate.place, seen)
        variance = variance_of(landmark, seen.factor)
        return nothing, next_level(level, off, variance, seen.factor > 0, memory)

    of_vectors: tuple[NoiseLevel, ...] = ()
    of_landmarks: tuple[NoiseLevel, ...] = ()
    if vectors := sample.vectors.each:
        each = stacked(levels.vectors), with_biases(vectors, estimate)
        _, found = in_turn(by_vector, (), each)
        of_vectors = apart(found, len(vectors))
    if sample.landmarks:
        _, found = in_turn(by_landmark, (), (stacked(levels.landmarks), stacked(sample.landmarks)))
        of_landmarks = apart(found, len(sample.landmarks))
    dt = sample.time_step
    moving = dt > 0
    over = 1 / choose(moving, dt, 1.0)

    def by_velocity(level: NoiseLevel, now: Vec3, density: Array) -> NoiseLevel:
        return next_level(level, now, density * density * over, moving, memory)

    return NoiseLevels(
        by_velocity(levels.angular_velocity, sample.angular_velocity, angular),
        by_velocity(levels.velocity, sample.velocity, linear),
        of_vectors,
        of_landmarks,
    )
