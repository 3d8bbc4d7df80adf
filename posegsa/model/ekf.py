"""A left-invariant extended Kalman filter on SE(3), the observer's strongest competitor.

It reads the same samples as the observer and returns the same records, so the same code judges
both.

symbol | meaning                                     | here                  | unit, frame
------ | ------------------------------------------- | --------------------- | ------------------
T_est  | estimated pose (R_est, P_est)               | `EkfState.estimate`   | B to I; m, I
b_est  | estimated bias of both velocities           | `EkfState.estimate`   | rad/s, m/s, B
c_i    | estimated bias of vector i, if estimated    | `EkfState.estimate`   | as the vector, B
xi     | pose error [theta; rho], T = T_est exp(xi^) | states 0 to 5         | rad, m, B
b, c   | errors of the biases, b = b_est + error     | states 6 to 11, 12 on | as b_est and c_i
Sigma  | covariance of all of them                   | `EkfState.covariance` |
y, z   | predicted and measured                      | `update`              | as measured, B
u      | displacement (Y_m - b_est) dt               | `propagate`           | rad, m, B

The sensor model is the paper's (Eqs. 2, 4 and 6) with white noise and biases that follow random
walks. Each sample is used in two steps; the record of a sample is the estimate before both, as with
the observer:

1. Update. y = R_est^T v^I + c_i for a vector and y = R_est^T (p - P_est) for a landmark, with
       z - y = [R_est^T v^I]x theta + error of c_i + noise,    z - y = [y]x theta - rho + noise.
   All components of all sensors are linearised at the estimate before the sample and processed one
   scalar at a time, which needs no matrix inverse. The correction is applied to the pose only after
   the last one, T_est <- T_est exp(xi^), so the result is that of one joint update, in any order.
2. Propagation. T_est <- T_est exp(u^), and with A = Ad(exp(-u^))
       xi <- A xi - J dt (error of b + noise),   J = 1/2 (I + A).
   A is exact for errors of any size: that is the advantage of the left-invariant form. J equals
   the right Jacobian of SE(3) to within |u|^2 / 12, relative.

After an update the covariance is left in the coordinates of the estimate before it (as J. Sola,
J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", arXiv:1812.01537, and
most filters have it); the change of coordinates is of first order in a correction.

Vectors are used as measured, neither normalised nor with their cross product, which holds no
further information: the filter ignores the weights, normalisation and cross product of
`VectorSettings`. A weight in the measurements divides the variance of that measurement.

What is proven: without noise, velocity biases and vector biases, the left-invariant error
propagates independently of the trajectory, and an invariant filter converges from
sufficiently small errors on any trajectory that keeps the pose observable (A. Barrau, S.
Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE Transactions on
Automatic Control 62(4), 2017). With biases as states (an "imperfect" invariant filter) none of
this is proven. Vectors and landmarks are measured in the body frame, for which the theory favours
the right-invariant error; with velocity biases in the body frame each form has its drawback.

What is measured: for small initial errors and the sensors' true noise it is consistent
(`tests/model/test_ekf.py`). For large ones it is not: the covariance does not include the error of
the linearisation. It shrinks with the first samples, whether or not they have improved the
estimate, and the remaining error is corrected only as fast as the process noise allows. At 180 deg
from the truth the vectors give no correction at all, and vector-bias states explain a wrong
attitude by biases. Noise levels tuned for such starts recover nevertheless. Those found for 18
states assume that the vectors' biases walk (0.005 / sqrt(s)), although they are constant, and are
known well at the start (0.008).

Mean and worst cost (0.3 x first second + 4 to 59 s) for starts up to 180 deg and 10 m off, the
paper's sensors, random phases, 60 s, 200 held-out scenarios, one search of 1536 evaluations on 25
others: 18 states tuned 55 and 134, with the sensors' true noise 291 and 3686; 12 states tuned 167
and 634, with the sensors' true noise 188 and 629.
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
fuses into one vectorised kernel: 0.1 us per filter and sample with 12 states, 0.2 us with 18, on
one core. Every vector and landmark adds to this and to the compile time, which for the paper's
three sensors is 10 s with 12 states and 30 s with 18.
"""

Row: TypeAlias = dict[int, Array | float]
"""A row of a sparse matrix: its nonzero entries by column."""

SMALLEST_CUT = 128
"""One scalar measurement reduces a variance at most to this many units of rounding times itself. A
reduction below one unit, 1e-7 in float32, would leave only rounding errors, of either sign."""

POSE, ANGULAR, LINEAR, VECTORS = 0, 6, 9, 12
"""Index of the first state of the pose, of the velocities' biases and of the vectors' biases."""


class EkfNoise(NamedTuple):
    """The filter's noise model, of sensors and start: standard deviations, all traced.

    White noise of standard deviation s in every sample of length dt has the density s sqrt(dt).
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
    """Random walk of the vectors' biases, in their unit [1/sqrt(s)]; used if they are states."""
    vector: Array
    """Noise of each component of a vector, in its unit."""
    landmark: Array
    """Noise of each coordinate of a landmark [m]."""
    initial_attitude: Array
    """Initial attitude error about each axis [rad]."""
    initial_position: Array
    """Initial position error along each axis [m]."""
    initial_angular_bias: Array
    """Initial error of each component of the angular velocity's bias [rad/s]."""
    initial_linear_bias: Array
    """Initial error of each component of the velocity's bias [m/s]."""
    initial_vector_bias: Array
    """Initial error of each component of the vectors' biases, in their unit; used if they are
    states."""


class EkfState(NamedTuple):
    """The estimate and its covariance, by components of any common batch shape."""

    estimate: FilterState
    """As the observer's; `turning` is ()."""
    covariance: Covariance
    """Sigma of 12 states, or 12 + 3 n with the biases of n vectors."""

    @property
    def covariance_matrix(self) -> Array:
        """Sigma (..., d, d)."""
        return _matrix(self.covariance, len(self.covariance))


def ekf_samples(
    measurements: Measurements, rotation: Array | None = None, position: Array | None = None
) -> Samples:
    """Measurements, and the truth where it is known, in the form of the loop (pure, jittable).

    Samples made for an observer that estimates the vectors' biases work too.

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
    """The state after the vectors and landmarks of a sample; missing ones are skipped.

    Args:
        state: before them, of the batch shape.
        sample: from `ekf_samples`, with each vector as measured.
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
    """The state at the next sample, predicted from the measured velocities.

    Args:
        state: at this sample, of the batch shape.
        sample: its velocities and its time step are used.
        noise: of the velocities, and of the biases' random walks.
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

    For a consistent filter it is chi-squared with 6 degrees of freedom, 6 on average. (Y.
    Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    2001, section 5.4.) The initial deviations of the pose must not be 0.
    """
    estimate = state.estimate
    w, x, y, z = estimate.attitude
    R, R_true = rows(estimate.attitude), rows(truth.attitude)
    between = subtract(rotate(R_true, truth.origin), estimate.place)
    theta, rho = _log(compose((w, -x, -y, -z), truth.attitude), unrotate(R, between))
    error = stack(theta + rho)
    # The states have different units. Their correlation matrix is solved: float32 suffices for it.
    sigma = _matrix(state.covariance, 6)
    deviation = jnp.sqrt(jnp.diagonal(sigma, axis1=-2, axis2=-1))
    correlation = sigma / (deviation[..., :, None] * deviation[..., None, :])
    relative = error / deviation
    return jnp.sum(relative * jnp.linalg.solve(correlation, relative[..., None])[..., 0], axis=-1)


# --- simulations ---


def ekf_cost(
    samples: Samples, initial: FilterState, weights: CostWeights, noise: EkfNoise
) -> CostParts:
    """Cost of one simulation, accumulated over samples; nothing else is stored (pure, jittable)."""

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
    """Cost on a recording, accumulated over samples; nothing else is stored (pure, jittable)."""

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

    The filter has no gain K: that of the track is NaN. With `together`, S simulations run at once,
    and all leaves except those of the noise have a leading axis S.
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
"""Maps the sum so far, the state before a sample, the sample and its entry of `extra` to the new
sum and to what is stored for the sample."""


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
    """A sparse row times a column, which is a function from index to entry."""
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

    The outer product of one vector with itself is subtracted, so the covariance stays symmetric.

    Args:
        covariance: before the measurement.
        correction: x from the measurements before it.
        h: derivatives of the measurement.
        residual: measured minus predicted with x = 0.
        variance: of the noise.
        factor: 0 where the measurement is missing.
    """
    every = range(len(covariance))
    # Sigma h^T: the Kalman gain times `total`.
    gain = [_product(h, lambda j, i=i: _entry(covariance, i, j)) for i in every]
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
    """F Sigma F^T, where F is the identity except for the given rows."""
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
    """The rows of xi, [A, -1/2 (I + A) dt] with A = Ad(exp(-[omega; v]^)) (rad, m)."""
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
    """Variance of a measurement with this weight; arbitrary where it is missing."""
    return deviation * deviation / choose(factor > 0, factor, 1.0)


def _corrected(estimate: FilterState, correction: list[Array]) -> FilterState:
    """The estimate after the correction xi, b and c."""

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
