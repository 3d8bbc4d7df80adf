"""A left-invariant extended Kalman filter on SE(3): the strongest filter a user could take instead.

symbol | meaning                                     | here                    | unit, frame
------ | ------------------------------------------- | ------------------------ | ------------------
T_est  | estimated pose (R_est, P_est)               | `KalmanState.estimate` | B to I; m, I
b_est  | estimated bias of both velocities           | `KalmanState.estimate` | rad/s, m/s, B
c_i    | estimated bias of vector i, where it is one | `KalmanState.estimate` | as the vector, B
xi     | pose error [theta; rho], T = T_est exp(xi^) | states 0 to 5         | rad, m, B
b, c   | errors of the biases, b = b_est + error     | states 6 to 11, 12 on | as b_est and c_i
Sigma  | covariance of all of them                   | `KalmanState.covariance` |
y, z   | predicted and measured                      | `update`              | as measured, B
u      | displacement (Y_m - b_est) dt               | `propagate`           | rad, m, B

The sensors' model is the paper's (Eqs. 2, 4 and 6) with white noise and biases that walk at random.
A sample k is used in two halves; the estimate before both is what is recorded of it, as with the
observer:

1. Update. y = R_est^T v^I + c_i for a vector and y = R_est^T (p - P_est) for a landmark, with
       z - y = [R_est^T v^I]x theta + error of c_i + noise,    z - y = [y]x theta - rho + noise.
   All components of all sensors are linearised at the estimate before the sample. Then they are
   taken one after the other: a scalar at a time needs no matrix inverse, and as the correction is
   put into the pose only after the last one, T_est <- T_est exp(xi^), the result is that of one
   update with all of them in any order.
2. Propagation. T_est <- T_est exp(u^), and with A = Ad(exp(-u^))
       xi <- A xi - J dt (error of b + noise),   J = 1/2 (I + A).
   A is exact for the group, whatever the error: the left-invariant form's point. J is the right
   Jacobian of SE(3) but for |u|^2 / 12 of it.

After an update the covariance is left in the coordinates of the estimate before it (as J. Sola,
J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", arXiv:1812.01537, and
most filters have it); the change of coordinates is of first order in a correction.

Vectors enter as measured, neither normalised nor with their cross product, which would tell nothing
new: weights, normalisation and cross product of `VectorSettings` do not matter here. A weight in
the measurements divides the variance of that measurement.

What is proven: without velocity biases and vector biases, and for the deterministic system, the
left-invariant error's propagation is free of the trajectory, and an invariant filter converges from
errors that are small enough, on any trajectory that keeps the pose observable (A. Barrau, S.
Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE Transactions on
Automatic Control 62(4), 2017). With biases as states (an "imperfect" invariant filter) nothing of
that is proven. Vectors and landmarks are seen in the body frame, for which the theory would rather
take the right-invariant error; with velocity biases in the body frame each form gives up something.

What is measured: from small errors and with the sensors' own noise it is consistent
(`tests/model/test_ekf.py`). From large ones no promise holds: the covariance does not know how
wrong the linearisation is. It shrinks with the first samples, whether or not they have brought the
estimate nearer, and what is still wrong then is corrected only as fast as the process noise allows;
at 180 deg from the truth the vectors pull in no direction at all, and vector-bias states explain a
wrong attitude by biases. Noise levels that were tuned for such starts recover from them all the
same; those found for 18 states let the vectors' biases walk (0.005 / sqrt(s)), constant though they
are, and doubt them little at first (0.008). Starts up to 180 deg and 10 m off, the paper's sensors,
random phases, 60 s, 200 scenarios that were not tuned on, one search of 1536 evaluations on 25
others; mean cost (0.3 x first second + 4 to 59 s) and worst: 18 states tuned 55 and 134, with the
sensors' own noise 291 and 3686; 12 states tuned 167 and 634, with the sensors' own noise 188 and
629.
"""

import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, NamedTuple, Self, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.arguments import refuse
from posegsa.errors import ArgumentError
from posegsa.filters.base import Record, Samples, with_vector_biases
from posegsa.model.elementwise import choose, maximum
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import LandmarkSample, Sample, prepare
from posegsa.model.se3 import (
    Quaternion,
    Vec3,
    add,
    compose,
    cross,
    dot,
    move,
    norm,
    rotate,
    rows,
    scale,
    stack,
    subtract,
    unrotate,
)
from posegsa.model.signal import TruePose
from posegsa.model.vectors import VectorSample, VectorSettings, Wahba

Covariance: TypeAlias = tuple[tuple[Array, ...], ...]
"""Upper triangle of a symmetric matrix: row i holds its entries (i, i), (i, i + 1), ..., each an
array of the batch shape. Like all of the hot loop it is written by components (`se3`), which XLA
makes one vectorised kernel of: 0.1 us a filter and sample with 12 states, 0.2 with 18, on one core.
Every vector and landmark adds to that, and to the compilation: 10 s and 30 s for the paper's three.
"""

Row: TypeAlias = dict[int, Array | float]
"""A row of a sparse matrix: the entries that are not 0, by column."""

SMALLEST_CUT = 128
"""Units of rounding: no scalar measurement cuts a variance to less than this share of itself. A cut
to less than one unit, 1e-7 in float32, would leave nothing but rounding, of either sign."""

POSE, ANGULAR, LINEAR, VECTORS = 0, 6, 9, 12
"""Where the errors of the pose, the velocities' biases and the vectors' biases begin."""


class KalmanNoise(NamedTuple):
    """What the filter believes of its sensors and of its start, all standard deviations, traced.

    Of a sensor with white noise of standard deviation s in every sample of dt, the density is
    s sqrt(dt).
    """

    angular_velocity: Array
    """Density of the angular velocity's noise [rad/sqrt(s)]."""
    velocity: Array
    """Density of the velocity's noise [m/sqrt(s)]."""
    angular_walk: Array
    """Random walk of the angular velocity's bias [rad/s/sqrt(s)]."""
    linear_walk: Array
    """Random walk of the velocity's bias [m/s/sqrt(s)]."""
    vector_walk: Array
    """Random walk of the vectors' biases, in the vectors' unit [1/sqrt(s)]; only with such states.
    """
    vector: Array
    """Noise of each component of a vector, in its unit."""
    landmark: Array
    """Noise of each coordinate of a landmark [m]."""
    initial_attitude: Array
    """Of the attitude at the start, about each axis [rad]."""
    initial_position: Array
    """Of the position at the start, along each axis [m]."""
    initial_angular_bias: Array
    """Of the angular velocity's bias at the start, each component [rad/s]."""
    initial_linear_bias: Array
    """Of the velocity's bias at the start, each component [m/s]."""
    initial_vector_bias: Array
    """Of the vectors' biases at the start, each component, in the vectors' unit; only with such
    states."""


class KalmanState(NamedTuple):
    """The estimate and how far it may be off, by components of any common batch shape."""

    estimate: FilterState
    """As the observer's; `turning` is ()."""
    covariance: Covariance
    """Sigma, 12 + 3 n states with the biases of n vectors."""

    @property
    def covariance_matrix(self) -> Array:
        """Sigma (..., d, d)."""
        return _matrix(self.covariance, len(self.covariance))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KalmanFilter:
    """The invariant extended Kalman filter (`filters.base.Filter`)."""

    noise: KalmanNoise
    """What it believes of its sensors and of its start."""
    vector_biases: bool = field(default=True, metadata={"static": True})
    """Whether the vectors' biases are states: 12 + 3 n of them for n vectors, else 12."""

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same with some standard deviations replaced, by their names in `KalmanNoise`.

        Raises:
            ArgumentError: There is none of such a name.
        """
        for key in values:
            if key not in KalmanNoise._fields:
                refuse(f"{key}: not a number of this filter", ", ".join(KalmanNoise._fields))
        return replace(self, noise=self.noise._replace(**values))

    def prepare(self, measurements: Measurements) -> Sample:
        """Each vector as measured, and landmarks.

        Samples that were prepared for an observer which learns the vectors' biases serve as well.
        """
        return prepare(measurements, AS_MEASURED)

    def start(self, initial: FilterState, vectors: int) -> KalmanState:
        """The state before the first sample; its covariance is that of the noise's start.

        Raises:
            ArgumentError: `initial` has biases of another number of vectors.
        """
        estimate = initial._replace(turning=())
        if self.vector_biases:
            estimate = with_vector_biases(estimate, vectors)
        else:
            estimate = estimate._replace(vector_biases=())
        noise, like = self.noise, initial.place[0]
        deviations = [
            *(noise.initial_attitude,) * 3,
            *(noise.initial_position,) * 3,
            *(noise.initial_angular_bias,) * 3,
            *(noise.initial_linear_bias,) * 3,
            *(noise.initial_vector_bias,) * (3 * len(estimate.vector_biases)),
        ]
        count, zero = len(deviations), jnp.zeros_like(like)
        covariance = tuple(
            (zero + deviation * deviation, *(zero,) * (count - 1 - i))
            for i, deviation in enumerate(deviations)
        )
        return KalmanState(estimate, covariance)

    def ready(self) -> "KalmanFilter":
        """Nothing to compute."""
        return self

    def step(self, state: KalmanState, now: Samples) -> tuple[KalmanState, Record]:
        """One sample: update by vectors and landmarks, then propagation by the velocities."""
        updated = update(state, now.sample, self.noise)
        return propagate(updated, now.sample, self.noise), Record()

    def estimate(self, state: KalmanState) -> FilterState:
        """Pose and biases."""
        return state.estimate


AS_MEASURED = VectorSettings(
    weights=None, cross_weight=0.0, normalise=False, cross=False, each_agent=True
)
"""Vectors as the update wants them."""


def update(state: KalmanState, sample: Sample, noise: KalmanNoise) -> KalmanState:
    """The state after a sample's vectors and landmarks; what is missing is passed over.

    Args:
        state: before them, of the batch shape.
        sample: with its vectors as measured (`KalmanFilter.prepare`).
        noise: of vectors and landmarks.

    Raises:
        ArgumentError: The sample holds only Wahba's sums of its vectors.
    """
    if isinstance(sample.vectors, Wahba):
        raise ArgumentError(
            "the Kalman filter needs each vector as measured: make its samples by its `prepare`"
        )
    estimate, covariance = state
    R = rows(estimate.attitude)
    zero = jnp.zeros_like(estimate.place[0])
    found = Found(covariance, (zero,) * len(covariance))
    vectors, landmarks = sample.vectors.each, sample.landmarks
    learnt = bool(estimate.vector_biases)

    def by_vector(found: Found, vector: tuple[VectorSample, Vec3 | None]) -> tuple[Found, None]:
        seen, bias = vector
        known = unrotate(R, seen.known)
        expected = known if bias is None else add(known, bias)
        variance = _variance(noise.vector, seen.factor)
        for axis, per_theta in enumerate(_cross_rows(known)):
            h: Row = per_theta | ({VECTORS + axis: 1.0} if learnt else {})
            residual = seen.measured[axis] - expected[axis]
            found = _by_scalar(found, h, residual, variance, seen.factor)
        return _next_vector_first(found) if learnt else found, None

    def by_landmark(found: Found, landmark: LandmarkSample) -> tuple[Found, None]:
        expected = unrotate(R, subtract(landmark.inertial, estimate.place))
        variance = _variance(noise.landmark, landmark.factor)
        for axis, per_theta in enumerate(_cross_rows(expected)):
            h = per_theta | {3 + axis: -1.0}
            residual = landmark.body[axis] - expected[axis]
            found = _by_scalar(found, h, residual, variance, landmark.factor)
        return found, None

    if vectors:
        biases = estimate.vector_biases if learnt else (None,) * len(vectors)
        found, _ = lax.scan(by_vector, found, _stacked(zip(vectors, biases, strict=True)))
    if landmarks:
        found, _ = lax.scan(by_landmark, found, _stacked(landmarks))
    return KalmanState(_corrected(estimate, found.correction), found.covariance)


def _stacked(sensors: Iterable[Any]) -> Any:
    """Sensors of one kind along a first axis: a loop over them is compiled once, however many."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *sensors)


def propagate(state: KalmanState, sample: Sample, noise: KalmanNoise) -> KalmanState:
    """The state at the next sample, by the measured velocities.

    Args:
        state: at this sample, of the batch shape.
        sample: with the velocities, and the time step to the next one.
        noise: of the velocities, and the biases' random walks.
    """
    estimate, dt = state.estimate, sample.time_step
    omega = scale(dt, subtract(sample.angular_velocity, estimate.bias_angular))
    v = scale(dt, subtract(sample.velocity, estimate.bias_linear))
    attitude, place = move(estimate.attitude, estimate.place, omega, v)
    densities = [
        *(noise.angular_velocity,) * 3,
        *(noise.velocity,) * 3,
        *(noise.angular_walk,) * 3,
        *(noise.linear_walk,) * 3,
        *(noise.vector_walk,) * (3 * len(estimate.vector_biases)),
    ]
    moved = _congruent(state.covariance, _transition(omega, v, dt))
    covariance = tuple(
        (row[0] + dt * density * density, *row[1:])
        for row, density in zip(moved, densities, strict=True)
    )
    return KalmanState(estimate._replace(attitude=attitude, place=place), covariance)


def nees(state: KalmanState, truth: TruePose) -> Array:
    """Normalised estimation error squared of the pose, xi^T Sigma^-1 xi, of the batch shape.

    Chi-squared with 6 degrees of freedom for a consistent filter: 6 on average. (Y. Bar-Shalom,
    X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
    section 5.4.) The initial deviations of the pose must not be 0.
    """
    estimate = state.estimate
    w, x, y, z = estimate.attitude
    R, R_true = rows(estimate.attitude), rows(truth.attitude)
    between = subtract(rotate(R_true, truth.origin), estimate.place)
    theta, rho = _log(compose((w, -x, -y, -z), truth.attitude), unrotate(R, between))
    error = stack(theta + rho)
    # States of unlike units: solved as a correlation matrix, which float32 can hold.
    sigma = _matrix(state.covariance, 6)
    deviation = jnp.sqrt(jnp.diagonal(sigma, axis1=-2, axis2=-1))
    correlation = sigma / (deviation[..., :, None] * deviation[..., None, :])
    relative = error / deviation
    return jnp.sum(relative * jnp.linalg.solve(correlation, relative[..., None])[..., 0], axis=-1)


# --- the covariance, by components ---


def _entry(covariance: Covariance, i: int, j: int) -> Array:
    return covariance[i][j - i] if i <= j else covariance[j][i - j]


def _matrix(covariance: Covariance, count: int) -> Array:
    """The first `count` rows and columns, (..., count, count)."""
    every = range(count)
    return jnp.stack([stack(tuple(_entry(covariance, i, j) for j in every)) for i in every], -2)


def _product(row: Row, column: Callable[[int], Array]) -> Array:
    """A sparse row times a column, which is given by its entries."""
    return reduce(operator.add, (factor * column(j) for j, factor in row.items()))


class Found(NamedTuple):
    """What the measurements of a sample so far have told."""

    covariance: Covariance
    correction: tuple[Array, ...]
    """x, the errors of all states found so far; the estimate gets them after the last one."""


def _by_scalar(found: Found, h: Row, residual: Array, variance: Array, factor: Array) -> Found:
    """Covariance and correction x of the states after a measurement h x = residual + noise.

    The covariance loses an outer product of one vector with itself, so that it stays symmetric.

    Args:
        found: before it.
        h: the measurement's derivatives.
        residual: measured minus predicted with x = 0.
        variance: of its noise.
        factor: 0 where it is missing.
    """
    covariance, correction = found
    every = range(len(covariance))
    gain = [_product(h, lambda j, i=i: _entry(covariance, i, j)) for i in every]  # not yet / total
    own = _product(h, gain.__getitem__)
    smallest = SMALLEST_CUT * float(jnp.finfo(own.dtype).eps)
    total = own + maximum(variance, smallest * own)
    used = (factor > 0) & (total > 0)
    per_total = choose(used, 1 / choose(used, total, 1.0), 0.0)
    surprise = per_total * (residual - _product(h, correction.__getitem__))
    part = [per_total * g for g in gain]
    cut = tuple(
        tuple(entry - part[i] * gain[j] for j, entry in enumerate(row, start=i))
        for i, row in enumerate(covariance)
    )
    return Found(cut, tuple(x + surprise * g for x, g in zip(correction, gain, strict=True)))


def _next_vector_first(found: Found) -> Found:
    """The same with the states of the vectors' biases in turn: the second vector's come first.

    So the loop over vectors always finds those of its vector in the same place, and after as many
    turns as there are vectors all are where they were.
    """
    order = list(range(VECTORS))
    biases = range(VECTORS, len(found.covariance))
    order += [*biases[3:], *biases[:3]]
    covariance = tuple(
        tuple(_entry(found.covariance, order[i], order[j]) for j in range(i, len(order)))
        for i in range(len(order))
    )
    return Found(covariance, tuple(found.correction[i] for i in order))


def _congruent(covariance: Covariance, F: dict[int, Row]) -> Covariance:
    """F Sigma F^T of a matrix that is the identity but for the rows given."""
    every = range(len(covariance))

    def of_left(i: int, j: int) -> Array:
        return (
            _product(F[i], lambda k: _entry(covariance, k, j))
            if i in F
            else (_entry(covariance, i, j))
        )

    left = [[of_left(i, j) for j in every] for i in every]
    return tuple(
        tuple(_product(F[j], left[i].__getitem__) if j in F else left[i][j] for j in every[i:])
        for i in every
    )


def _transition(omega: Vec3, v: Vec3, dt: Array) -> dict[int, Row]:
    """Rows of xi in [A, -1/2 (I + A) dt], A = Ad(exp(-[omega; v]^)) (rad, m)."""
    zero, one = jnp.zeros_like(dt), jnp.ones_like(dt)
    q, P = move((one, zero, zero, zero), (zero, zero, zero), omega, v)
    columns = tuple(zip(*rows(q), strict=True))  # rows of R^T
    half = 0.5 * dt
    F: dict[int, Row] = {i: {} for i in range(6)}
    for i in range(3):
        e: Vec3 = (columns[i][0], columns[i][1], columns[i][2])
        below = cross(P, e)  # of -R^T [P]x
        for k in range(3):
            mean = half * e[k] + half if k == i else half * e[k]
            F[i] |= {k: e[k], ANGULAR + k: -mean}
            F[3 + i] |= {k: below[k], 3 + k: e[k], ANGULAR + k: -half * below[k], LINEAR + k: -mean}
    return F


def _cross_rows(a: Vec3) -> tuple[Row, Row, Row]:
    """Rows of [a]x, over theta."""
    return {1: -a[2], 2: a[1]}, {0: a[2], 2: -a[0]}, {0: -a[1], 1: a[0]}


def _variance(deviation: Array, factor: Array) -> Array:
    """Of a measurement of this weight; anything where it is missing."""
    return deviation * deviation / choose(factor > 0, factor, 1.0)


def _corrected(estimate: FilterState, correction: tuple[Array, ...]) -> FilterState:
    """The estimate with the errors found taken off it."""

    def part(first: int) -> Vec3:
        return correction[first], correction[first + 1], correction[first + 2]

    attitude, place = move(estimate.attitude, estimate.place, part(POSE), part(POSE + 3))
    return estimate._replace(
        attitude=attitude,
        place=place,
        bias_angular=add(estimate.bias_angular, part(ANGULAR)),
        bias_linear=add(estimate.bias_linear, part(LINEAR)),
        vector_biases=tuple(
            add(c, part(VECTORS + 3 * i)) for i, c in enumerate(estimate.vector_biases)
        ),
    )


def _log(q: Quaternion, P: Vec3) -> tuple[Vec3, Vec3]:
    """[theta; rho] of the pose (q, P) = exp([theta; rho]^), |theta| <= pi (rad, m)."""
    sign = choose(q[0] < 0, -jnp.ones_like(q[0]), 1.0)
    w, axis = sign * q[0], scale(sign, (q[1], q[2], q[3]))
    sine = norm(axis)
    turned = sine > 0
    angle = 2 * jnp.arctan2(sine, w)
    theta = scale(choose(turned, angle / choose(turned, sine, 1.0), 2.0), axis)
    # rho = V^-1 P with V^-1 = I - 1/2 [theta]x + c [theta]x^2, c = (1 - t/2 cot t/2) / t^2.
    t2 = dot(theta, theta)
    small = t2 < 0.01
    series = 1 / 12 + t2 * (1 / 720 + t2 * (1 / 30240))
    closed = (1 - 0.5 * angle * w / choose(small, 1.0, sine)) / choose(small, 1.0, t2)
    once = cross(theta, P)
    twice = scale(choose(small, series, closed), cross(theta, once))
    return theta, add(subtract(P, scale(0.5, once)), twice)
