"""An attitude filter for gyroscope, accelerometer and magnetometer: a Kalman filter and two means.

It reads two vectors as they are measured: the specific force a [m/s^2], which points up at rest,
and the magnetic field m in any unit. Their references define the inertial frame: up, with the
length of gravity, and magnetic north. The velocity of a sample and landmarks are not used.

symbol | meaning                                      | here                       | unit, frame
------ | -------------------------------------------- | -------------------------- | -----------
R      | estimated attitude                           | `estimate`, `at_sample`    | B to I
b      | estimated bias of the gyroscope              | `estimate`                 | rad/s, B
v      | estimated horizontal velocity (east, north)  | `velocity`                 | m/s, I
theta  | attitude error, R_true = exp(theta^) R       | states 0 to 2 (e, n, up)   | rad, I
Sigma  | covariance of theta, the error of b, and v   | `covariance`               |
f      | mean field of the earth                      | `field`                    | as m, I
c      | mean field that turns with the body (iron)   | `iron`                     | as m, B

I is the almost inertial frame of the estimate: it drifts with the remaining bias error, and all
means in it are turned with each correction.

**Inclination.** No other sensor separates gravity from acceleration, but the velocity of a body
stays within bounds: v integrates R a + gravity, and "v is 0, plus noise" is a measurement. A wrong
inclination makes v grow at g theta. The stationary Kalman filter of this model is a low-pass filter
of second order of the acceleration in an almost inertial frame, as in VQF (D. Laidig, T. Seel,
"VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
rejection", Information Fusion 91, 2023), the bias learnt from what it corrects. Its gains follow
from the covariance, high at the start, when little is known, and low later.

**Heading.** From one sample to the next m = R^T f + c - delay omega x R^T f is compared with what
is measured: a magnetometer is some milliseconds slower than a gyroscope. f follows the part that is
fixed to the earth, c that of the body, such as an attached magnet, and only while the body turns.
If f does not point north, the heading is wrong. Iron nearby is detected by the horizontal and
vertical part of the field, which do not depend on the attitude: their distance d from their own
slow mean, as a share of its length, gives the belief 1 / (1 + (d / tolerance)^2), by which the
field's information is multiplied. An inclination error tilts the field, which changes its heading
by up to tan(dip) times as much: that too is added to the heading's variance.

**Rest.** While gyroscope and accelerometer stay near their means over half a second (thresholds of
VQF), the gyroscope measures its bias, and "v is 0" is measured with less noise.

**Outliers and pauses.** A vector that is far too long is ignored, unless such fields last longer
than the others: then the first one was wrong. So it was if the fields of the first seconds are not
believed for longer than they are. After a pause in the samples the attitude is found anew, and so
it is where gravity points upwards on average, as then the estimate is upside down.

**Start.** The first acceleration of about the length of gravity turns the initial attitude upright,
the first field to the north, by the smallest rotations that do so; large variances then let both
improve in seconds. Without a magnetometer the initial heading stays, and drifts.

A gyroscope sample is the mean over the interval before its time stamp, or after it
(`gyroscope_interval`). If before, the estimate at the next sample is predicted by the last value,
and the next step starts again from the last sample with the right value.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from typing import Any, ClassVar, Literal, NamedTuple, Self, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.arguments import check_type, refuse
from posegsa.filters.attitude_covariance import (
    BIAS,
    EAST,
    NORTH,
    STATES,
    UP,
    VELOCITY,
    Found,
    corrected,
    forgotten,
    propagated,
    turned,
    turned_about_up,
)
from posegsa.filters.base import Record, Samples, Sensors
from posegsa.filters.covariance import Covariance, entry_of
from posegsa.model.elementwise import choose, maximum, minimum, only_if
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, prepare
from posegsa.model.se3 import (
    Matrix3,
    Quaternion,
    Vec3,
    add,
    compose,
    cross,
    dot,
    exp_coefficients,
    norm,
    product,
    rotate,
    rows,
    safe_sqrt,
    scale,
    subtract,
    unrotate,
)
from posegsa.model.vectors import AS_MEASURED, VectorSample, VectorSamples

Interval = Literal["before", "after"]
"""Which interval an angular velocity is the mean of: before its time stamp, or after it."""
INITIAL_INCLINATION = 0.35
"""Standard deviation of the inclination from one acceleration of a moving body, by axis [rad]."""
INITIAL_HEADING = 1.0
"""Standard deviation of the heading from one sample of the field [rad]."""
INITIAL_DEVIATIONS = (INITIAL_INCLINATION, INITIAL_INCLINATION, INITIAL_HEADING)
INITIAL_VELOCITY = 1.0
"""Standard deviation of the velocity at the start [m/s]."""
REST_VELOCITY = 0.05
"""Noise density of "v is 0" at rest [m/s sqrt(s)]."""
ACCELERATION = 0.03
"""Noise density of the accelerometer [m/s^2 sqrt(s)]."""
REST_MEAN, REST_TIME = 0.5, 1.4999
"""Time constant of the means that detect rest, and how long the sensors must stay near them [s]:
just under 1.5 s, so that the rounding of a sum of time steps decides nothing."""
REST_TURNING, REST_SHAKING = float(np.deg2rad(2.0)), 0.5
"""Largest distances from these means at rest [rad/s, m/s^2]."""
LARGEST_BIAS = float(np.deg2rad(6.0))
"""Maximum bias of a gyroscope [rad/s], by axis; above it the body turns at a constant rate."""
FIELD_NOISE_TIME = 0.1
"""Time constant of the low-pass filter of d, so that noise is no disturbance [s]."""
LONGEST_PAUSE = 0.2501
"""Time between two samples [s] above which the attitude is found anew, as at the start: the
gyroscope has not measured how the body turned in between. Just over 0.25 s, as for REST_TIME."""
LEVELLING = 0.5, 2.0
"""Range of the first acceleration's length, in multiples of gravity: one that is much longer or
shorter does not show where up is."""
UPRIGHT_TIME, UPSIDE_DOWN = 1.5, -0.05
"""Time constant of the mean vertical part of the acceleration, in multiples of gravity within -1
and 1 [s], and the value under which the estimate is upside down: a body does not fall faster than
freely for seconds."""
DOUBTED, DOUBTED_AGE = 0.5, 10.0
"""Distance d from which on the first field may be wrong, and time of fields without such a distance
[s] after which it was right: then the field is disturbed."""
LONGEST_REFUSAL = 1.0
"""Time of refused fields [s] after which they may be right and the first field wrong."""
ASTRAY, ASTRAY_TIME = math.cos(math.radians(45)), 3.0
"""Cosine of the angle between a believed field and north, and the time of a larger one [s] after
which the heading counts as unknown, as its variance does not grow with a fault of the gyroscope."""
SMALL_ANGLE = 0.5
"""Angle between two samples [rad] up to which a short series gives the rotation."""
ALL_TURNING = 0.5
"""Angular velocity from which on c, the field of the body, is followed at its full rate [rad/s]."""

Started = tuple[Quaternion, tuple[Array, Array], Covariance]
"""What the first acceleration and the first field change: attitude, velocity, covariance."""


class AttitudeNumbers(NamedTuple):
    """The numbers of the filter; all are traced."""

    velocity: Array
    """Noise density of "the velocity is 0" [m/s sqrt(s)]."""
    angular_velocity: Array
    """Density of the gyroscope's noise [rad/sqrt(s)]."""
    turning: Array
    """Additional gyroscope noise, in proportion to the angular velocity [sqrt(s)]."""
    turning_heading: Array
    """Additional noise of the heading alone, in proportion to the angular velocity [sqrt(s)]."""
    angular_walk: Array
    """Random walk of the gyroscope's bias [rad/s/sqrt(s)]."""
    heading: Array
    """Noise density of the field's heading [rad sqrt(s)]."""
    inclination_in_heading: Array
    """Share of the inclination's variance that makes the field's heading uncertain."""
    field_time: Array
    """Time constant of f [s]."""
    field_tolerance: Array
    """Distance d of the field from its mean, as a share of it, at which the belief is 1/2."""
    field_memory: Array
    """Time over which the field's horizontal and vertical part are averaged, while the body turns
    [s]."""
    disbelieved: Array
    """Share of their normal rate at which the means follow a field that is not believed."""
    iron_time: Array
    """Time constant of c while the body turns [s]."""
    magnetometer_delay: Array
    """Delay of the magnetometer behind the gyroscope [s]."""
    rest_bias: Array
    """Noise density of the gyroscope at rest, as a measurement of its bias [rad/s sqrt(s)]."""
    initial_bias: Array
    """Standard deviation of each component of the gyroscope's bias at the start [rad/s]."""
    outlier: Array
    """An acceleration or a field more than this many times as long as its reference is ignored."""


def _root(variance: Array) -> Array:
    """Standard deviation; of a stream's state, which is in NumPy, in its own precision."""
    if isinstance(variance, np.ndarray | np.generic):
        return cast(Array, np.sqrt(np.maximum(variance, 0)))
    return safe_sqrt(variance)


class AttitudeState(NamedTuple):
    """The filter between two samples."""

    estimate: FilterState
    """The attitude at the next sample, and the gyroscope's bias; the rest is 0."""
    at_sample: Quaternion
    """The attitude at the last sample."""
    last_step: Array
    """Time since the last sample [s]; 0 before the first."""
    velocity: tuple[Array, Array]
    """v, to the east and to the north [m/s]."""
    covariance: Covariance
    """Sigma: attitude error (east, north, up), the bias's error, velocity."""
    field: Vec3
    """f by east, north, up."""
    iron: Vec3
    """c."""
    parts: tuple[Array, Array]
    """Mean horizontal and vertical part of the field."""
    parts_time: Array
    """Time over which they are averaged [s]."""
    off: tuple[Array, Array]
    """Low-passed distances of both parts from their means, as shares of its length."""
    field_belief: Array
    """How far the field is believed, in [0, 1]."""
    upright: Array
    """1 once an acceleration has been seen, else 0."""
    field_age: Array
    """Time since the first field [s]; below 0 before it."""
    field_gap: Array
    """Time since the last field that was used [s], at most LONGEST_PAUSE."""
    field_refused: Array
    """Time of the fields since then that were too long [s]."""
    field_doubted: Array
    """Time for which d has been above DOUBTED [s]."""
    astray_time: Array
    """Time of believed fields since the field last pointed about north [s]."""
    forget: Array
    """1 after a pause: the next sample forgets the covariances of attitude and velocity; 2 if the
    attitude is lost: those of the bias too; else 0."""
    upwards: Array
    """Mean vertical part of the acceleration over UPRIGHT_TIME, in multiples of gravity."""
    slow_turning: Vec3
    """Mean of the gyroscope over REST_MEAN [rad/s], body frame."""
    slow_force: Vec3
    """Mean of the accelerometer over REST_MEAN [m/s^2], body frame."""
    still_time: Array
    """How long both sensors have been near these means [s]."""

    @property
    def at_rest(self) -> Array:
        """Whether the body rests."""
        return self.still_time >= REST_TIME

    @property
    def heading_deviation(self) -> Array:
        """Standard deviation of the heading [rad]."""
        return _root(entry_of(self.covariance, UP, UP))

    @property
    def inclination_deviation(self) -> Array:
        """Standard deviation of the inclination [rad]."""
        east, north = (entry_of(self.covariance, i, i) for i in (EAST, NORTH))
        return _root(east + north)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AttitudeFilter:
    """The attitude filter for inertial sensors (`filters.base.Filter`)."""

    elementwise: ClassVar[bool] = True
    numbers: AttitudeNumbers
    """Its numbers."""
    gyroscope_interval: Interval = field(default="before", metadata={"static": True})
    """Whether an angular velocity is the mean over the interval before its time stamp, since the
    last sample, or after it, until the next sample."""

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with some numbers replaced, by their names in `AttitudeNumbers`.

        Raises:
            ArgumentError: A name is not in `AttitudeNumbers`.
        """
        for key in values:
            if key not in AttitudeNumbers._fields:
                refuse(f"{key}: not a number of this filter", ", ".join(AttitudeNumbers._fields))
        return replace(self, numbers=self.numbers._replace(**values))

    def prepare(self, measurements: Measurements) -> Sample:
        """The vectors as measured.

        Raises:
            ArgumentError: There are other vectors than specific force and magnetic field.
        """
        _check_vectors(np.shape(measurements.vector_weights)[-1])
        return prepare(measurements, AS_MEASURED)

    def start(self, initial: FilterState, sensors: Sensors) -> AttitudeState:
        """The state before the first sample.

        The first acceleration and the first field correct the attitude of `initial`. What they
        can't determine is kept: its bias, and its heading where there is no magnetometer.

        Raises:
            ArgumentError: There are other vectors than specific force and magnetic field, or
                `numbers` are no `AttitudeNumbers`.
        """
        check_type("numbers", self.numbers, AttitudeNumbers, allowed="AttitudeNumbers")
        _check_vectors(sensors.vectors)
        zero = jnp.zeros_like(initial.place[0])
        zeros = (zero, zero, zero)
        variances = _at_start(zero)
        for of_bias in range(BIAS, VELOCITY):
            variances[of_bias] = zero + self.numbers.initial_bias * self.numbers.initial_bias
        return AttitudeState(
            estimate=FilterState(initial.attitude, zeros, initial.bias_angular, zeros),
            at_sample=initial.attitude,
            last_step=zero,
            velocity=(zero, zero),
            covariance=tuple((variances[i], *(zero,) * (STATES - 1 - i)) for i in range(STATES)),
            field=zeros,
            iron=zeros,
            parts=(zero, zero),
            parts_time=zero,
            off=(zero, zero),
            field_belief=zero,
            upright=zero,
            field_age=zero - 1,
            field_gap=zero,
            field_refused=zero,
            field_doubted=zero,
            astray_time=zero,
            forget=zero,
            upwards=zero + 1,
            slow_turning=zeros,
            slow_force=zeros,
            still_time=zero,
        )

    def ready(self) -> "AttitudeFilter":
        """The filter itself; there is nothing to precompute."""
        return self

    def estimate(self, state: AttitudeState) -> FilterState:
        """Attitude and gyroscope bias; position and velocity bias are 0."""
        return state.estimate

    def step(self, state: AttitudeState, now: Samples) -> tuple[AttitudeState, Record]:
        """One sample: its corrections, then the rotation until the next one."""
        sample, numbers = now.sample, self.numbers
        assert isinstance(sample.vectors, VectorSamples)
        force, field_seen = sample.vectors.each
        gyr, dt = sample.angular_velocity, sample.time_step
        q, bias = state.estimate.attitude, state.estimate.bias_angular
        omega = subtract(gyr, bias)
        speed = norm(omega)
        if self.gyroscope_interval == "before":
            q = product(state.at_sample, _rotation_by(scale(state.last_step, omega)))
        axes = _axes(force, field_seen)
        gravity = norm(force.known)

        # Outliers, and the first acceleration and the first field, which set the attitude.
        a, m, parts = force.measured, field_seen.measured, state.parts
        longest = numbers.outlier * gravity
        square, (least, most) = dot(a, a), (share * gravity for share in LEVELLING)
        of_force = choose(square < longest * longest, force.factor, 0.0)
        shows_up = (of_force > 0) & (square > least * least) & (square < most * most)
        level = shows_up & (state.upright < 1)
        upright = maximum(state.upright, choose(shows_up, jnp.ones_like(dt), 0.0))
        of_force = choose(upright > 0, of_force, 0.0)
        longest = numbers.outlier * numbers.outlier * (parts[0] * parts[0] + parts[1] * parts[1])
        plausible = dot(m, m) < longest
        # Fields that were refused for longer than others were used are no outliers: the first one
        # was too short. Where fields are doubted for longer than the few before them were believed,
        # it was too long or had another direction.
        outvoted = state.field_refused >= maximum(state.field_age, LONGEST_REFUSAL)
        believed_time = state.field_age - state.field_doubted
        doubted = state.field_doubted >= maximum(believed_time, LONGEST_REFUSAL)
        wrong = (outvoted & jnp.logical_not(plausible)) | (doubted & (believed_time < DOUBTED_AGE))
        restart = (state.field_age < 0) | wrong
        of_field = choose((plausible | restart) & (upright > 0), field_seen.factor, 0.0)
        first = (of_field > 0) & restart
        # A sample stands for the time until the next one, but not for a pause.
        paused, span = dt > LONGEST_PAUSE, minimum(dt, LONGEST_PAUSE)
        started = q, state.velocity, state.covariance
        astray = state.astray_time >= ASTRAY_TIME

        def set_(old: Started) -> Started:
            q, velocity, covariance = old
            covariance = _uncorrelated(covariance, state.forget)
            return _set((q, velocity, covariance), level, first, astray, axes, a, m)

        changes = level | first | astray | (state.forget > 0)
        q, velocity, covariance = only_if(changes, set_, started)

        R = _in(axes, rows(q))
        still, slow_turning, slow_force = _stillness(state, gyr, a, of_force, span)
        still_time = choose(still, state.still_time + span, 0.0)
        rests = still_time >= REST_TIME
        state = state._replace(
            upright=upright, velocity=velocity, covariance=covariance, forget=jnp.zeros_like(dt)
        )
        # A slow magnetometer's sample speaks for the time since the one before.
        field_span = span + state.field_gap
        state = self._with_field(state, R, omega, m, of_field, field_span, first, wrong)

        # Corrections, each by a scalar measurement.
        correction = (jnp.zeros_like(dt),) * STATES
        found = state.covariance, correction
        spread = choose(rests, jnp.full_like(dt, REST_VELOCITY), numbers.velocity)
        felt = choose(of_force > 0, span, 0.0)
        for i in range(2):
            found = corrected(found, VELOCITY + i, -state.velocity[i], spread * spread, felt)
        f, (level_mean, up_mean) = state.field, state.parts
        level_length = norm((f[0], f[1], jnp.zeros_like(dt)))
        known = (of_field > 0) & (level_length > 0) & (level_mean > 0)
        safe = choose(known, level_length, 1.0)
        dip = up_mean / choose(known, level_mean, 1.0)
        tilt = entry_of(state.covariance, EAST, EAST) + entry_of(state.covariance, NORTH, NORTH)
        seen = choose(known, field_span * state.field_belief * of_field, 0.0)
        tilted = 0.5 * numbers.inclination_in_heading * dip * dip * tilt
        noise = numbers.heading * numbers.heading + seen * tilted
        behind = choose(f[0] >= 0, jnp.ones_like(dt), -1.0)
        found = corrected(found, UP, choose(f[1] > 0, f[0] / safe, behind), noise, seen)

        def at_rest(found: Found) -> Found:
            """After what the gyroscope measures of its bias."""
            noise = numbers.rest_bias * numbers.rest_bias
            for i in range(3):
                found = corrected(found, BIAS + i, omega[i], noise, span)
            return found

        found = only_if(rests, at_rest, found)
        covariance, x = found
        angle = (x[0], x[1], x[2])
        # The rotation by 2 atan(|x| / 2) about x: to third order that by x, without a series.
        cosine = 1 / jnp.sqrt(1 + 0.25 * dot(angle, angle))
        sine = 0.5 * cosine
        q = compose((cosine, *scale(sine, unrotate(axes, angle))), q)
        bias = _within(add(bias, (x[3], x[4], x[5])), LARGEST_BIAS)
        v = state.velocity[0] + x[6], state.velocity[1] + x[7]
        f = rotate(rows((cosine, *scale(sine, angle))), f)

        believed = choose((of_field > 0) & (state.field_belief > 0.5), field_span, 0.0)
        elsewhere = f[1] < ASTRAY * safe
        astray_time = choose(elsewhere, state.astray_time + believed, 0.0)
        astray_time = choose(of_field > 0, astray_time, state.astray_time)

        # The time until the next sample.
        R = _in(axes, rows(q))
        pushed = rotate(R, force.measured)
        v = v[0] + felt * pushed[EAST], v[1] + felt * pushed[NORTH]
        up = maximum(minimum(pushed[UP] * (1 / gravity), 1.0), -1.0)
        upwards = state.upwards + felt * (1 / UPRIGHT_TIME) * (up - state.upwards)
        omega = subtract(gyr, bias)
        next_attitude = product(q, _rotation_by(scale(dt, omega)))
        density = numbers.angular_velocity**2 + numbers.turning**2 * speed * speed
        of_heading = numbers.turning_heading**2 * speed * speed
        walk = numbers.angular_walk**2
        noises = [density, density, density + of_heading, walk, walk, walk]
        noises += [jnp.full_like(dt, ACCELERATION**2)] * 2
        covariance = propagated(covariance, R, dt, felt * gravity)
        covariance = tuple(
            (row[0] + dt * noise, *row[1:]) for row, noise in zip(covariance, noises, strict=True)
        )
        gap = minimum(state.field_gap + dt, LONGEST_PAUSE)
        refused = state.field_refused + choose(field_seen.factor > 0, span, 0.0)
        after = state._replace(
            estimate=state.estimate._replace(attitude=next_attitude, bias_angular=bias),
            at_sample=q,
            last_step=dt,
            velocity=v,
            covariance=covariance,
            field=f,
            field_gap=choose(of_field > 0, jnp.zeros_like(dt), gap),
            field_refused=choose(of_field > 0, jnp.zeros_like(dt), refused),
            astray_time=astray_time,
            upwards=upwards,
            slow_turning=slow_turning,
            slow_force=slow_force,
            still_time=still_time,
        )
        lost = upwards < UPSIDE_DOWN
        return _anew(after, paused, lost, numbers.initial_bias), Record()

    def _with_field(
        self,
        state: AttitudeState,
        R: Matrix3,
        omega: Vec3,
        measured: Vec3,
        factor: Array,
        span: Array,
        first: Array,
        wrong: Array,
    ) -> AttitudeState:
        """The means of the field, and the belief in it, after a sample.

        Args:
            state: before it.
            R: rows of the attitude, to east, north, up.
            omega: angular velocity without its bias [rad/s].
            measured: the magnetic field, body frame.
            factor: 0 where it is missing.
            span: time that the sample stands for [s].
            first: whether the means begin with it.
            wrong: whether they do since those before it were wrong.
        """
        numbers, seen, zero = self.numbers, factor > 0, jnp.zeros_like(span)
        before, iron = (_where(first, state.field), _where(wrong, state.iron))
        age = choose(first, zero, state.field_age)
        time = span * factor
        slow, speed = unrotate(R, before), norm(omega)
        # A body turns by little within the delay. More than 1 rad is a fault of the gyroscope: it
        # counts as 1 rad, as f would grow without limit.
        delay = numbers.magnetometer_delay / maximum(numbers.magnetometer_delay * speed, 1.0)
        m = subtract(subtract(measured, iron), scale(delay, cross(omega, slow)))
        earthly = rotate(R, m)
        level = norm((earthly[EAST], earthly[NORTH], zero))
        parts = tuple(
            choose(first, new, old)
            for new, old in zip((level, earthly[UP]), state.parts, strict=True)
        )
        size = parts[0] * parts[0] + parts[1] * parts[1]
        per_size = 1 / safe_sqrt(choose(size > 0, size, 1.0))
        new = time / (FIELD_NOISE_TIME + time)
        off = tuple(
            old + new * ((now - mean) * per_size - old)
            for old, now, mean in zip(
                _where(first, state.off), (level, earthly[UP]), parts, strict=True
            )
        )
        square = off[0] * off[0] + off[1] * off[1]
        tolerance = numbers.field_tolerance * numbers.field_tolerance
        belief = tolerance / (tolerance + square)
        follow = numbers.disbelieved + (1 - numbers.disbelieved) * belief
        turning = minimum(speed * (1 / ALL_TURNING), jnp.ones_like(span))
        residual = subtract(earthly, before)
        share = maximum(time / (numbers.field_time + time), time / (age + time + 1e-9))
        to_iron = minimum(time * turning * follow / numbers.iron_time, jnp.ones_like(span))
        weight = time * turning * follow
        parts_time = choose(first, zero, state.parts_time)
        parts_time = minimum(parts_time + weight, numbers.field_memory)
        to_parts = minimum(weight / (parts_time + 1e-6), 1.0)
        near = square < DOUBTED * DOUBTED
        doubted = choose(first | near, zero, state.field_doubted + span)
        changed = state._replace(
            field=add(before, scale(share, residual)),
            iron=add(iron, scale(choose(first, zero, to_iron), unrotate(R, residual))),
            parts=(
                parts[0] + to_parts * (level - parts[0]),
                parts[1] + to_parts * (earthly[UP] - parts[1]),
            ),
            parts_time=parts_time,
            off=(off[0], off[1]),
            field_belief=belief,
            field_age=age + span,
            field_doubted=doubted,
        )
        return jax.tree.map(lambda new, old: choose(seen, new, old), changed, state)


def _at_start(zero: Array) -> dict[int, Array]:
    """Variances of attitude and velocity at the start, by state."""
    deviations = dict(enumerate(INITIAL_DEVIATIONS))
    deviations |= dict.fromkeys(range(VELOCITY, STATES), INITIAL_VELOCITY)
    return {state: zero + deviation * deviation for state, deviation in deviations.items()}


def _anew(state: AttitudeState, paused: Array, lost: Array, initial_bias: Array) -> AttitudeState:
    """The state before a start, after a pause or where the attitude is lost; else as it is.

    Where it is lost, bias and iron are wrong too. Of the covariance the variances, which users
    read, are set; the next sample forgets the rest, which costs nothing at the others.
    `initial_bias` is the bias's standard deviation at the start [rad/s].
    """
    zero = jnp.zeros_like(state.last_step)
    ends = paused | lost
    entries = [list(row) for row in state.covariance]
    for i, variance in _at_start(zero).items():
        entries[i][0] = choose(ends, variance, entries[i][0])
    for i in range(BIAS, VELOCITY):
        entries[i][0] = choose(lost, zero + initial_bias * initial_bias, entries[i][0])
    return state._replace(
        estimate=state.estimate._replace(bias_angular=_where(lost, state.estimate.bias_angular)),
        velocity=_where(ends, state.velocity),
        covariance=tuple(map(tuple, entries)),
        iron=_where(lost, state.iron),
        forget=choose(lost, zero + 2, choose(paused, zero + 1, zero)),
        upwards=choose(ends, zero + 1, state.upwards),
        upright=choose(ends, zero, state.upright),
        field_age=choose(ends, zero - 1, state.field_age),
        still_time=choose(ends, zero, state.still_time),
    )


def _uncorrelated(covariance: Covariance, forget: Array) -> Covariance:
    """The covariance after `AttitudeState.forget`: variances as they are."""
    entries = [list(row) for row in covariance]
    for i in range(STATES):
        for j in range(i + 1, STATES):
            of_bias = i >= BIAS and j < VELOCITY
            forgets = forget > 1 if of_bias else forget > 0
            entries[i][j - i] = choose(forgets, 0.0, entries[i][j - i])
    return tuple(map(tuple, entries))


def _check_vectors(count: int) -> None:
    if count != 2:
        refuse(
            f"vectors: {count} of them",
            "two, specific force and magnetic field (weight 0 without a magnetometer)",
        )


def _axes(force: VectorSample, field_seen: VectorSample) -> Matrix3:
    """East, north and up in the inertial frame, from the references of both vectors."""
    up = _unit(force.known)
    east = _unit(cross(field_seen.known, up))
    return east, cross(up, east), up


def _in(axes: Matrix3, R: Matrix3) -> Matrix3:
    """Rows of the rotation from the body to east, north, up."""
    east, north, up = (unrotate(R, axis) for axis in axes)
    return east, north, up


def _unit(a: Vec3) -> Vec3:
    square = dot(a, a)
    return scale(1 / safe_sqrt(choose(square > 0, square, 1.0)), a)


def _rotation_by(angle: Vec3) -> Quaternion:
    """The rotation by a vector of an angle [rad]."""
    square = dot(angle, angle)

    def by_any(_: Any) -> Any:
        return exp_coefficients(square)[:2]

    # Between two samples a body turns by little: a short series is exact to rounding.
    cosine, sine = only_if(square > SMALL_ANGLE * SMALL_ANGLE, by_any, _half_angle(square))
    return (cosine, *scale(sine, angle))


def _half_angle(square: Array) -> tuple[Array, Array]:
    """cos(t/2) and sin(t/2)/t up to t = SMALL_ANGLE, from t^2 [rad^2]."""
    x = -0.25 * square
    cosine, sine = (
        reduce(lambda sum_, n: 1 / math.factorial(n) + x * sum_, range(first, -1, -2), 0 * x)
        for first in (12, 13)
    )
    return cosine, 0.5 * sine


def _smallest_rotation(a: Vec3, b: Vec3, across: Vec3) -> Quaternion:
    """The rotation by the smallest angle that takes a to b; half a turn is about `across`.

    All have length 1, and `across` is perpendicular to b.
    """
    w, axis = 1 + dot(a, b), cross(a, b)
    square = w * w + dot(axis, axis)
    turned = square > 1e-12
    per_length = 1 / safe_sqrt(choose(turned, square, 1.0))
    x, y, z = (choose(turned, per_length * s, half) for s, half in zip(axis, across, strict=True))
    return choose(turned, per_length * w, 0.0), x, y, z


def _set(
    old: Started,
    level: Array,
    first: Array,
    astray: Array,
    axes: Matrix3,
    force: Vec3,
    field_seen: Vec3,
) -> Started:
    """The attitude after the first acceleration and the first field.

    The axes of the estimate turn with the heading, and so do velocity and covariance, which may
    have been estimated before the first field.

    Args:
        old: attitude, velocity and covariance before them.
        level: whether the acceleration is the first.
        first: whether the field is.
        astray: whether the heading is unknown again.
        axes: east, north and up in the inertial frame.
        force: the acceleration, body frame.
        field_seen: the field, body frame.
    """
    q, velocity, covariance = old
    to_up = _smallest_rotation(_unit(rotate(rows(q), force)), axes[UP], axes[EAST])
    q = compose(_if(level, to_up), q)
    seen = rotate(rows(q), field_seen)
    level_part = _unit(subtract(seen, scale(dot(seen, axes[UP]), axes[UP])))
    q = compose(_if(first, _smallest_rotation(level_part, axes[NORTH], axes[UP])), q)
    sine = choose(first, dot(level_part, axes[EAST]), 0.0)
    cosine = choose(first, dot(level_part, axes[NORTH]), 1.0)
    covariance = turned_about_up(covariance, cosine, sine)
    anew = forgotten(covariance, {UP: jnp.full_like(sine, INITIAL_HEADING**2)})
    covariance = jax.tree.map(partial(choose, first | astray), anew, covariance)
    return q, turned(velocity, cosine, sine), covariance


def _if(condition: Array, q: Quaternion) -> Quaternion:
    """The rotation q where the condition holds, else the identity."""
    identity = (1.0, 0.0, 0.0, 0.0)
    w, x, y, z = (choose(condition, s, same) for s, same in zip(q, identity, strict=True))
    return w, x, y, z


def _stillness(
    state: AttitudeState, gyr: Vec3, force: Vec3, factor: Array, dt: Array
) -> tuple[Array, Vec3, Vec3]:
    """Whether the body rests at a sample, and the slow means of gyroscope and accelerometer."""
    share = dt / (REST_MEAN + dt)
    started = state.upright > 0
    of_turning = choose(started, share, 1.0)
    of_force = choose(factor > 0, choose(started, share, 1.0), 0.0)
    turning = add(state.slow_turning, scale(of_turning, subtract(gyr, state.slow_turning)))
    slow = add(state.slow_force, scale(of_force, subtract(force, state.slow_force)))
    still = (
        _is_within(subtract(gyr, turning), REST_TURNING)
        & ((factor <= 0) | _is_within(subtract(force, slow), REST_SHAKING))
        & _is_within(turning, LARGEST_BIAS)
    )
    return still, turning, slow


def _within(a: Vec3, limit: float) -> Vec3:
    """A vector with each component limited."""
    x, y, z = (maximum(minimum(s, limit), -limit) for s in a)
    return x, y, z


V = TypeVar("V", bound=tuple[Array, ...])


def _where(none: Array, a: V) -> V:
    """A vector, or zeros where the condition holds."""
    return cast(V, tuple(choose(none, 0.0, s) for s in a))


def _is_within(a: Vec3, length: float) -> Array:
    return dot(a, a) < length * length
