"""Belief: how far each vector and each landmark is believed, from its own residuals.

A sensor's input is its squared residual at the estimate before the sample, over what it should be.
A schedule (`filters.noise_schedules`), one for all vectors and one for all landmarks, turns it into
a factor from 1 up; each sensor has its own memory. A Kalman filter multiplies the variance of that
sensor by the factor, an observer divides its weight by it: both are the same change of the factor
on a measurement's weight. Doubt that all sensors share counts half in a Kalman filter
(`halfway_to_the_least`), and not at all in an observer, which has no covariance (`over_the_least`).
"""

import operator
from collections.abc import Sequence
from functools import partial, reduce
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jax import Array

from posegsa.filters.covariance import ANGULAR, VECTORS, Covariance, Row, entry_of, product
from posegsa.filters.measurement_model import (
    landmark_rows,
    variance_of,
    vector_rows,
    weighted,
    with_biases,
)
from posegsa.filters.noise_schedules import (
    NoiseMemory,
    NoiseSignal,
    ResidualMean,
    initial_noise_memory,
    noise_factor,
)
from posegsa.model.elementwise import choose, minimum
from posegsa.model.estimate import FilterState
from posegsa.model.sample import LandmarkSample, Sample
from posegsa.model.schedules import GainSchedule, PreparedSchedule
from posegsa.model.se3 import Vec3, dot, rows
from posegsa.model.sensor_loops import apart, in_turn, stacked

BeliefInput = Literal["residual", "variance", "mean"]
"""The input of belief: a sensor's normalised squared residual, the variance that it implies, both
low-passed, or the normalised square of its low-passed residual."""


class Residual(NamedTuple):
    """How far each sensor of a kind disagrees with the estimate, leaves (n, ...)."""

    normalised: Array
    """|z - y|^2 over its expectation, tr(H Sigma H^T) + 3 s^2, s the standard deviation of its
    noise; 1 if the covariance is right. Or the variance that it implies, as a multiple of s^2:
    (|z - y|^2 - tr(H Sigma H^T)) / (3 s^2), which can be negative."""
    factor: Array
    """Factor on its weight, 0 where it is missing."""
    off: Vec3 | None = None
    """For the input "mean": z - y, in the sensor's unit."""
    expected: tuple[Array, Array] | None = None
    """For the input "mean", of |z - y|^2: tr(H Sigma H^T), and 3 s^2."""


def residuals(
    estimate: FilterState,
    covariance: Covariance | None,
    sample: Sample,
    vector: Array,
    landmark: Array,
    of: BeliefInput = "residual",
) -> tuple[Residual | None, Residual | None]:
    """The residuals of vectors and of landmarks, before any is used; None if there are none.

    Args:
        estimate: before the sample, of the batch shape.
        covariance: of its errors. None treats the estimate as exact, and ignores the
            sizes of the measurements' weights, which for an observer also follow the sensors'
            rates.
        sample: with its vectors as measured.
        vector: standard deviation of each component of a vector, in its unit.
        landmark: standard deviation of each coordinate of a landmark [m].
        of: which `normalised` to compute: the "residual" over its expectation, or the "variance".
            With "mean" that of "residual", and what its mean needs.
    """
    R, axes = rows(estimate.attitude), range(3)
    learnt = bool(estimate.vector_biases)

    def residual(spread: Array | float, off: Vec3, deviation: Array, factor: Array) -> Residual:
        one = deviation * deviation if covariance is None else variance_of(deviation, factor)
        square, own = dot(off, off), 3 * one
        if of == "variance":
            return Residual((square - spread) / own, factor)
        found = Residual(square / (spread + own), factor)
        return found._replace(off=off, expected=(spread + 0 * own, own)) if of == "mean" else found

    def spread(each: Sequence[Row]) -> Array | float:
        """tr(H Sigma H^T) of rows over the states of the pose."""
        if (known := covariance) is None:
            return 0.0

        def column(h: Row, j: int) -> Array:
            return product(h, lambda i: entry_of(known, i, j))

        return reduce(operator.add, (product(h, partial(column, h)) for h in each))

    def of_bias(i: int) -> tuple[list[list[Array]], Array] | None:
        """Covariance (axis, theta) of a vector's bias with the attitude, and its own trace."""
        if covariance is None or not learnt:
            return None
        first = VECTORS + 3 * i
        beside = [[entry_of(covariance, j, first + axis) for j in axes] for axis in axes]
        own = reduce(operator.add, (entry_of(covariance, first + a, first + a) for a in axes))
        return beside, own

    def by_vector(nothing: tuple[()], given: Any) -> Any:
        (seen, bias), biased = given
        each, off = vector_rows(R, seen, bias)
        thetas: list[Row] = [{j: h[j] for j in h if j < ANGULAR} for h in each]
        total = spread(thetas)
        if biased is not None:
            beside, own = biased
            pairs = zip(thetas, beside, strict=True)
            crossed = [product(h, of_axis.__getitem__) for h, of_axis in pairs]
            total = total + own + 2 * reduce(operator.add, crossed)
        return nothing, residual(total, off, vector, seen.factor)

    def by_landmark(nothing: tuple[()], seen: LandmarkSample) -> Any:
        each, off = landmark_rows(R, estimate.place, seen)
        return nothing, residual(spread(each), off, landmark, seen.factor)

    of_vectors = of_landmarks = None
    if vectors := sample.vectors.each:
        biased = stacked(map(of_bias, range(len(vectors))))
        _, of_vectors = in_turn(by_vector, (), (with_biases(vectors, estimate), biased))
    if sample.landmarks:
        _, of_landmarks = in_turn(by_landmark, (), stacked(sample.landmarks))
    return of_vectors, of_landmarks


class BeliefMemory(NamedTuple):
    """The memory of belief, one of each sensor; () for a kind of sensor without a schedule."""

    vectors: tuple[NoiseMemory, ...] = ()
    landmarks: tuple[NoiseMemory, ...] = ()


class Factors(NamedTuple):
    """The factor on the variance of each sensor, at least 1 where it is measured.

    None for a kind without a schedule.
    """

    vectors: tuple[Array, ...] | None
    landmarks: tuple[Array, ...] | None


def next_mean(past: NoiseMemory, now: Residual, smoothing: Array) -> ResidualMean:
    """The low-passed residual of a sensor after a sample; as it was if it is missing.

    Args:
        past: its memory before, with a mean.
        now: its residual.
        smoothing: time constant [s].
    """
    assert isinstance(past.mean, ResidualMean)
    assert now.off is not None
    mean, seen = past.mean, now.factor > 0
    old = choose(jnp.isinf(past.age), 0.0, smoothing / (smoothing + past.age))
    value = tuple(
        choose(seen, z + old * (m - z), m) for z, m in zip(now.off, mean.value, strict=True)
    )
    share = (1 - old) * (1 - old) + old * old * mean.share
    return ResidualMean((value[0], value[1], value[2]), choose(seen, share, mean.share))


def initial_beliefs(
    schedules: Sequence[GainSchedule | None],
    counts: Sequence[int],
    like: Array,
    of: BeliefInput = "residual",
) -> BeliefMemory:
    """The memory before the first sample, in the shape and dtype of `like`.

    Args:
        schedules: of vectors and of landmarks.
        counts: how many vectors and landmarks there are.
        like: any number of the state.
        of: the input.
    """
    zero = jnp.zeros_like(like)
    mean = ResidualMean((zero, zero, zero), zero) if of == "mean" else ()
    return BeliefMemory(
        *(
            () if one is None else (initial_noise_memory(one, like)._replace(mean=mean),) * count
            for one, count in zip(schedules, counts, strict=True)
        )
    )


def belief_factors(
    schedules: Sequence[PreparedSchedule | None],
    signal: NoiseSignal,
    memory: BeliefMemory,
    each: Sequence[Residual | None],
    time: Array,
    time_step: Array,
) -> tuple[Factors, BeliefMemory]:
    """The factor on the variance of each sensor at a sample, and the memory after it.

    Args:
        schedules: of vectors and of landmarks.
        signal: of both.
        memory: after the last sample.
        each: the `residuals` of vectors and of landmarks.
        time: since the first sample [s].
        time_step: to the next sample [s].
    """
    factors: list[tuple[Array, ...] | None] = []
    memories: list[tuple[NoiseMemory, ...]] = []
    for schedule, before, residual in zip(schedules, memory, each, strict=True):
        if schedule is None or residual is None:
            factors.append(None)
            memories.append(before)
            continue

        def one(nothing: tuple[()], of_sensor: Any, schedule: Any = schedule) -> Any:
            past, now = of_sensor
            seen, value, own = now.factor > 0, now.normalised, signal
            if now.expected is not None:
                mean = next_mean(past, now, signal.smoothing)
                spread, variance = now.expected
                value = dot(mean.value, mean.value) / (spread + mean.share * variance)
                past = past._replace(mean=mean)
                own = signal._replace(smoothing=0 * signal.smoothing)
            factor, after, _ = noise_factor(schedule, own, past, value, seen, time, time_step)
            return nothing, (factor, after)

        _, found = in_turn(one, (), (stacked(before), residual))
        of_sensors, after = (apart(those, len(before)) for those in found)
        factors.append(of_sensors)
        memories.append(after)
    return Factors(*factors), BeliefMemory(*memories)


def _leasts(factors: Factors, sample: Sample, largest: Array) -> list[Array]:
    """The least factor of each kind, of those that are measured; `largest` if none is."""
    leasts = []
    for sensors, of_kind in zip((sample.vectors.each, sample.landmarks), factors, strict=True):
        each = (jnp.ones_like(largest),) * len(sensors) if of_kind is None else of_kind
        pairs = zip(sensors, each, strict=True)
        measured = (choose(sensor.factor > 0, factor, largest) for sensor, factor in pairs)
        leasts.append(reduce(minimum, measured, largest))
    return leasts


def _divided(factors: Factors, by: Sequence[Array]) -> Factors:
    """The factors of each kind over a number."""
    pairs = zip(factors, by, strict=True)
    return Factors(*(of if of is None else tuple(one / over for one in of) for of, over in pairs))


def over_the_least(factors: Factors, sample: Sample, largest: Array) -> Factors:
    """The factors of each kind over its least one: one vector and one landmark are fully believed.

    Without a covariance all sensors disagree with an estimate that is lost. Those that disagree
    least bring it back: a vector the attitude, a landmark the position.

    Args:
        factors: up to `largest`.
        sample: whose sensors with a weight above 0 are measured.
        largest: any number that no factor exceeds.
    """
    return _divided(factors, _leasts(factors, sample, largest))


def halfway_to_the_least(factors: Factors, sample: Sample, largest: Array) -> Factors:
    """All factors over the square root of the least one, of both kinds.

    When every sensor of a sample is doubted, it may as well be the estimate that is wrong, although
    its covariance is small. Half of the doubt that all of them share is then taken as such, in the
    logarithm. While one sensor is believed nothing changes.

    Args:
        factors: up to `largest`; a kind without a schedule is believed.
        sample: whose sensors with a weight above 0 are measured.
        largest: any number that no factor exceeds.
    """
    root = jnp.sqrt(minimum(*_leasts(factors, sample, largest)))
    return _divided(factors, (root, root))


def as_believed(sample: Sample, factors: Factors) -> Sample:
    """The sample with the weight of each sensor divided by the factor on its variance."""
    weights = [
        [sensor.factor for sensor in sensors]
        if by is None
        else [sensor.factor / factor for sensor, factor in zip(sensors, by, strict=True)]
        for sensors, by in zip((sample.vectors.each, sample.landmarks), factors, strict=True)
    ]
    return weighted(sample, *weights)
