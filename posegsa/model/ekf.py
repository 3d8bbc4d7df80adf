"""A left-invariant extended Kalman filter on SE(3): the strongest filter a user could take instead.

It reads the same samples as the observer and gives the same records, so that both are judged by the
same code.

symbol | meaning                                     | here                  | unit, frame
------ | ------------------------------------------- | --------------------- | ------------------
T_est  | estimated pose (R_est, P_est)               | `EkfState.estimate`   | B to I; m, I
b_est  | estimated bias of both velocities           | `EkfState.estimate`   | rad/s, m/s, B
c_i    | estimated bias of vector i, where it is one | `EkfState.estimate`   | as the vector, B
xi     | pose error [theta; rho], T = T_est exp(xi^) | states 0 to 5         | rad, m, B
b, c   | errors of the biases, b = b_est + error     | states 6 to 11, 12 on | as b_est and c_i
Sigma  | covariance of all of them                   | `EkfState.covariance` |
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
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.errors import ArgumentError
from posegsa.model.cost import (
    CostParts,
    CostWeights,
    RecordedCost,
    SquaredErrors,
    sample_error,
)
from posegsa.model.elementwise import choose, maximum
from posegsa.model.filter import FilterState
from posegsa.model.loops import scan_rows, scan_together
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import (
    ErrorTrack,
    Estimates,
    Samples,
    distances,
    samples_of,
    squared_errors,
)
from posegsa.model.sample import Sample
from posegsa.model.se3 import (
    Quaternion,
    Vec3,
    add,
    clip_distance,
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
from posegsa.model.signal import TruePose, pose_errors
from posegsa.model.vectors import VectorSettings, Wahba
from posegsa.stored_programs import stored

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


class EkfNoise(NamedTuple):
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


class EkfState(NamedTuple):
    """The estimate and how far it may be off, by components of any common batch shape."""

    estimate: FilterState
    """As the observer's; `turning` is ()."""
    covariance: Covariance
    """Sigma, 12 + 3 n states with the biases of n vectors."""

    @property
    def covariance_matrix(self) -> Array:
        """Sigma (..., d, d)."""
        return _matrix(self.covariance, len(self.covariance))


def ekf_samples(
    measurements: Measurements, rotation: Array | None = None, position: Array | None = None
) -> Samples:
    """Measurements, and the truth where it is known, in the form of the loop (pure, jittable).

    Samples made for an observer that learns the vectors' biases serve as well.

    Args:
        measurements: N samples.
        rotation: (N, 3, 3) true R, body to inertial.
        position: (N, 3) true P [m], inertial frame.
    """
    as_measured = VectorSettings(
        weights=None,
        cross_weight=jnp.zeros_like(measurements.time_step[0]),
        normalise=False,
        cross=False,
        each_agent=True,
    )
    return samples_of(measurements, as_measured, rotation, position)


def ekf_start(initial: FilterState, noise: EkfNoise) -> EkfState:
    """The filter before its first sample.

    Args:
        initial: the estimate there; the vectors' biases are states if it has any
            (`initial_state(..., learnt_vectors=n)`).
        noise: its initial standard deviations are used.
    """
    like = initial.place[0]
    deviations = [
        *(noise.initial_attitude,) * 3,
        *(noise.initial_position,) * 3,
        *(noise.initial_angular_bias,) * 3,
        *(noise.initial_linear_bias,) * 3,
        *(noise.initial_vector_bias,) * (3 * len(initial.vector_biases)),
    ]
    count, zero = len(deviations), jnp.zeros_like(like)
    covariance = tuple(
        (zero + deviation * deviation, *(zero,) * (count - 1 - i))
        for i, deviation in enumerate(deviations)
    )
    return EkfState(initial._replace(turning=()), covariance)


def update(state: EkfState, sample: Sample, noise: EkfNoise) -> EkfState:
    """The state after a sample's vectors and landmarks; what is missing is passed over.

    Args:
        state: before them, of the batch shape.
        sample: with its vectors as measured (`ekf_samples`).
        noise: of vectors and landmarks.

    Raises:
        ArgumentError: The sample holds only Wahba's sums of its vectors.
    """
    if isinstance(sample.vectors, Wahba):
        raise ArgumentError(
            "the Kalman filter needs each vector as measured: make its samples by ekf_samples"
        )
    estimate, covariance = state
    R = rows(estimate.attitude)
    correction = [jnp.zeros_like(estimate.place[0])] * len(covariance)
    learnt = bool(estimate.vector_biases)
    for i, vector in enumerate(sample.vectors.each):
        known = unrotate(R, vector.known)
        expected = add(known, estimate.vector_biases[i]) if learnt else known
        residual, per_theta = subtract(vector.measured, expected), _cross_rows(known)
        variance = _variance(noise.vector, vector.factor)
        for axis in range(3):
            h: Row = per_theta[axis] | ({VECTORS + 3 * i + axis: 1.0} if learnt else {})
            covariance, correction = _update_by_scalar(
                covariance, correction, h, residual[axis], variance, vector.factor
            )
    for landmark in sample.landmarks:
        expected = unrotate(R, subtract(landmark.inertial, estimate.place))
        residual, per_theta = subtract(landmark.body, expected), _cross_rows(expected)
        variance = _variance(noise.landmark, landmark.factor)
        for axis in range(3):
            h = per_theta[axis] | {3 + axis: -1.0}
            covariance, correction = _update_by_scalar(
                covariance, correction, h, residual[axis], variance, landmark.factor
            )
    return EkfState(_corrected(estimate, correction), covariance)


def propagate(state: EkfState, sample: Sample, noise: EkfNoise) -> EkfState:
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
    return EkfState(estimate._replace(attitude=attitude, place=place), covariance)


def nees(state: EkfState, truth: TruePose) -> Array:
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


# --- simulations ---


def ekf_cost(
    samples: Samples, initial: FilterState, weights: CostWeights, noise: EkfNoise
) -> CostParts:
    """Cost of one simulation, run up sample by sample; nothing else is stored (pure, jittable)."""

    def look(
        total: CostParts, state: EkfState, now: Samples, weight: Any
    ) -> tuple[CostParts, None]:
        transient, steady = weight
        error = sample_error(*pose_errors(state.estimate, now.truth), weights)
        return CostParts(total.transient + transient * error, total.steady + steady * error), None

    zero = jnp.zeros_like(initial.place[0])
    _, parts, _ = _simulate(
        look,
        samples,
        initial,
        noise,
        extra=(weights.transient, weights.steady),
        total=CostParts(zero, zero),
    )
    return parts


def ekf_recorded_cost(
    samples: Samples, initial: FilterState, recorded: RecordedCost, noise: EkfNoise
) -> Array:
    """Cost on a recording, run up sample by sample; nothing else is stored (pure, jittable)."""

    def look(
        total: SquaredErrors, state: EkfState, now: Samples, entry: Any
    ) -> tuple[SquaredErrors, None]:
        return squared_errors(total, state.estimate, now, *entry), None

    zero = jnp.zeros_like(initial.place[0])
    _, squares, _ = _simulate(
        look,
        samples,
        initial,
        noise,
        extra=(recorded.weight, recorded.position),
        total=SquaredErrors(zero, zero),
    )
    return squares.cost(recorded.position_weight)


def ekf_errors(
    samples: Samples, initial: FilterState, noise: EkfNoise, *, together: bool = False
) -> ErrorTrack:
    """The true errors of one simulation over all its samples (pure, jittable).

    The filter has no gain K: the track's is NaN. Of S simulations `together`, all leaves but the
    noise's have one more axis (S, ...) in front.
    """

    def look(
        total: tuple[()], state: EkfState, now: Samples, entry: tuple[()]
    ) -> tuple[tuple[()], tuple[Array, Array, Vec3]]:
        return total, (*pose_errors(state.estimate, now.truth), state.estimate.place)

    last, _, errors = _simulate(look, samples, initial, noise, together=together)
    attitude, position, place = errors
    return ErrorTrack(
        attitude=clip_distance(attitude),
        position=position,
        gain=jnp.full_like(attitude, jnp.nan),
        distance=distances(place, samples),
        bias=last.estimate.bias,
        vector_bias=last.estimate.vector_bias,
    )


def ekf_nees(samples: Samples, initial: FilterState, noise: EkfNoise) -> tuple[Array, EkfState]:
    """`nees` (N,) before each sample's update, and the last state (pure, jittable).

    Raises:
        ArgumentError: The samples do not hold the true pose.
    """

    def look(
        total: tuple[()], state: EkfState, now: Samples, entry: tuple[()]
    ) -> tuple[tuple[()], Array]:
        if now.truth is None:
            raise ArgumentError("the NEES needs the true pose, which these samples do not hold")
        return total, nees(state, now.truth)

    last, _, values = _simulate(look, samples, initial, noise)
    return values, last


@stored
def run_ekf(samples: Samples, initial: FilterState, noise: EkfNoise) -> Estimates:
    """The estimates of one simulation over all its samples.

    The filter has neither a gain K nor an error signal: those entries are NaN.
    """

    def look(
        total: tuple[()], state: EkfState, now: Samples, entry: tuple[()]
    ) -> tuple[tuple[()], FilterState]:
        return total, state.estimate

    _, _, states = _simulate(look, samples, initial, noise)
    nothing = jnp.full_like(samples.time, jnp.nan)
    return Estimates(
        time=samples.time,
        rotation=states.rotation,
        position=states.position,
        bias=states.bias,
        vector_bias=states.vector_bias,
        gain=nothing,
        gain_used=nothing,
        error=nothing,
        rate=nothing,
    )


Look = Callable[[Any, EkfState, Samples, Any], tuple[Any, Any]]
"""Maps what has been summed up, the state before a sample, the sample and its entry of `extra` to
the new sum and to what is stored of the sample."""


def _simulate(
    look: Look,
    samples: Samples,
    initial: FilterState,
    noise: EkfNoise,
    *,
    together: bool = False,
    extra: Any = (),
    total: Any = (),
) -> tuple[EkfState, Any, Any]:
    """Run the filter over all samples: the last state, the sum, and what `look` stored."""

    def body(carry: Any, inputs: Any) -> tuple[Any, Any]:
        (state, total), (now, entry) = carry, inputs
        total, stored = look(total, state, now, entry)
        return (propagate(update(state, now.sample, noise), now.sample, noise), total), stored

    if together:
        first = jax.vmap(lambda one: ekf_start(one, noise))(initial)
        over_time = scan_together
    else:
        first, over_time = ekf_start(initial, noise), scan_rows
    (last, total), stored = over_time(body, (first, total), (samples, extra))
    return last, total, stored


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


def _update_by_scalar(
    covariance: Covariance,
    correction: list[Array],
    h: Row,
    residual: Array,
    variance: Array,
    factor: Array,
) -> tuple[Covariance, list[Array]]:
    """Covariance and correction x of the states after a measurement h x = residual + noise.

    The covariance loses an outer product of one vector with itself, so that it stays symmetric.

    Args:
        covariance: before it.
        correction: x, of what has been measured before it.
        h: the measurement's derivatives.
        residual: measured minus predicted with x = 0.
        variance: of its noise.
        factor: 0 where it is missing.
    """
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
    return cut, [x + surprise * g for x, g in zip(correction, gain, strict=True)]


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


def _corrected(estimate: FilterState, correction: list[Array]) -> FilterState:
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
