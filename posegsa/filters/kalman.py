"""A left-invariant extended Kalman filter on SE(3), the strongest baseline of the observer.

symbol | meaning                                     | here                    | unit, frame
------ | ------------------------------------------- | ------------------------ | ------------------
T_est  | estimated pose (R_est, P_est)               | `KalmanState.estimate` | B to I; m, I
b_est  | estimated bias of both velocities           | `KalmanState.estimate` | rad/s, m/s, B
c_i    | estimated bias of vector i, if estimated   | `KalmanState.estimate` | as the vector, B
xi     | pose error [theta; rho], T = T_est exp(xi^) | states 0 to 5         | rad, m, B
b, c   | errors of the biases, b = b_est + error     | states 6 to 11, 12 on | as b_est and c_i
Sigma  | covariance of all of them                   | `KalmanState.covariance` |
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
most filters do); the neglected change is of first order in the correction. With `moves_covariance`
it is moved to those of the new estimate, in the product that propagates it. That pays after a wrong
start, but in float32 it can lose the covariance where measurements are garbage. With `iterations`
above 1 the update is iterated. Schedules may change
the noises while the filter runs (`filters.noise_schedules`).

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
(`tests/filters/test_kalman.py`). For large ones it is not: the covariance does not include the
error of the linearisation. It shrinks with the first samples, whether or not they have improved the
estimate, and the remaining error is corrected only as fast as the process noise allows. At 180 deg
from the truth the vectors give no correction at all, and vector-bias states explain a wrong
attitude by biases. Noise levels tuned for such starts recover nevertheless. Those found for 18
states assume that the vectors' biases walk (0.005 / sqrt(s)), although they are constant, and are
well known at the start (0.008).

Mean and worst cost (0.3 x first second + 4 to 59 s) for starts up to 180 deg and 10 m off, the
paper's sensors, random phases, 60 s, 200 held-out scenarios, one search of 1536 evaluations on 25
others: 18 states tuned 55 and 134, with the sensors' true noise 291 and 3686; 12 states tuned 167
and 634, with the sensors' true noise 188 and 629.
"""

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from typing import Any, NamedTuple, Self, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.arguments import refuse
from posegsa.errors import ArgumentError
from posegsa.filters.base import Record, Samples, Sensors, with_vector_biases
from posegsa.filters.noise_schedules import (
    NO_NOISE_GAINS,
    SIGNAL_KEYS,
    NoiseGains,
    NoiseMemory,
    NoiseSignals,
    PreparedNoiseGains,
    initial_noise_memory,
    noise_factor,
)
from posegsa.model.elementwise import choose, maximum
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import LandmarkSample, Sample, prepare
from posegsa.model.se3 import (
    Matrix3,
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
    safe_sqrt,
    scale,
    stack,
    subtract,
    unrotate,
)
from posegsa.model.signal import TruePose
from posegsa.model.vectors import VectorSample, VectorSamples, VectorSettings, Wahba

Covariance: TypeAlias = tuple[tuple[Array, ...], ...]
"""Upper triangle of a symmetric matrix: row i holds its entries (i, i), (i, i + 1), ..., each an
array of the batch shape. Like all of the hot loop it is written by components (`se3`), which XLA
fuses into one vectorised kernel: 0.1 us per filter and sample with 12 states, 0.2 us with 18, on
one core, for the paper's three sensors. Sensors of a kind are a loop, so that the compile time,
40 s with 18 states, does not depend on how many there are.
"""

Row: TypeAlias = dict[int, Array | float]
"""A row of a sparse matrix: its nonzero entries by column."""

SMALLEST_CUT = 128
"""One scalar measurement leaves at least this many machine epsilons of a variance. Less than one
epsilon, 1e-7 in float32, would leave only rounding errors of either sign."""

LONGEST_MOVE = 100.0
"""The length [m] from which on a correction of the position moves the covariance less and less."""

POSE, ANGULAR, LINEAR, VECTORS = 0, 6, 9, 12
"""Index of the first state of the pose, of the velocities' biases and of the vectors' biases."""


class KalmanNoise(NamedTuple):
    """Noise that the filter assumes of its sensors and its initial estimate: standard deviations.

    All are traced. White noise of standard deviation s in samples of length dt has the density
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


class KalmanMemory(NamedTuple):
    """What the schedules of the noises remember; () for a role that the filter has not."""

    unknown: NoiseMemory | tuple[()] = ()
    vectors: tuple[NoiseMemory, ...] = ()
    """One for each vector."""
    landmarks: tuple[NoiseMemory, ...] = ()
    """One for each landmark."""


class KalmanState(NamedTuple):
    """The estimate and its covariance, by components of any common batch shape."""

    estimate: FilterState
    """Like the estimate of the observer; `turning` is ()."""
    covariance: Covariance
    """Sigma of 12 states, or 12 + 3 n with the biases of n vectors."""
    memory: KalmanMemory = KalmanMemory()
    """Of the schedules of its noises."""

    @property
    def covariance_matrix(self) -> Array:
        """Sigma (..., d, d)."""
        return _matrix(self.covariance, len(self.covariance))


class Found(NamedTuple):
    """Result of the measurements of a sample that have been processed so far."""

    covariance: Covariance
    correction: tuple[Array, ...]
    """x, the estimated errors of all states; applied to the estimate after the last measurement."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KalmanFilter:
    """The invariant extended Kalman filter (`filters.base.Filter`)."""

    noise: KalmanNoise
    """Assumed noise of its sensors and its initial estimate."""
    vector_biases: bool = field(default=True, metadata={"static": True})
    """Whether the vectors' biases are states: 12 + 3 n of them for n vectors, else 12."""
    schedule: NoiseGains = NO_NOISE_GAINS
    """What changes the noises while the filter runs; by default nothing."""
    signals: NoiseSignals | None = None
    """What the schedules see; None if there are none."""
    iterations: int = field(default=1, metadata={"static": True})
    """How often the measurements of a sample are linearised, each time at the estimate that the
    last time found (an iterated extended Kalman filter)."""
    moves_covariance: bool = field(default=False, metadata={"static": True})
    """Whether the covariance is moved to the coordinates of the new estimate after an update."""

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with some numbers replaced.

        Args:
            values: By their names in `KalmanNoise`; those of a signal as "unknown_smoothing" or
                "belief_smoothing", with the names in `NoiseSignal`.

        Raises:
            ArgumentError: There is no number with this name.
        """
        known = (*KalmanNoise._fields, *(SIGNAL_KEYS if self.signals else ()))
        if wrong := [key for key in values if key not in known]:
            refuse(f"{wrong[0]}: not a number of this filter", ", ".join(known))
        noise, signals = (
            {key: value for key, value in values.items() if (key in SIGNAL_KEYS) == of_signals}
            for of_signals in (False, True)
        )
        return replace(
            self,
            noise=self.noise._replace(**noise),
            signals=self.signals and self.signals.with_values(signals),
        )

    def prepare(self, measurements: Measurements) -> Sample:
        """Each vector as measured, and landmarks.

        Samples prepared for an observer that estimates the vectors' biases work too.
        """
        return prepare(measurements, AS_MEASURED)

    def start(self, initial: FilterState, sensors: Sensors) -> KalmanState:
        """The state before the first sample; its covariance comes from the initial deviations.

        Raises:
            ArgumentError: `initial` has biases of another number of vectors.
        """
        estimate = initial._replace(turning=())
        if self.vector_biases:
            estimate = with_vector_biases(estimate, sensors.vectors)
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
        unknown, *beliefs = self.schedule
        memory = KalmanMemory(
            () if unknown is None else initial_noise_memory(unknown, like),
            *(
                () if one is None else (initial_noise_memory(one, like),) * count
                for one, count in zip(beliefs, sensors, strict=True)
            ),
        )
        return KalmanState(estimate, covariance, memory)

    def ready(self) -> "ReadyKalmanFilter":
        """The filter with its schedules prepared (slopes and overlaps of the terms)."""
        schedule = self.schedule.prepare()
        return ReadyKalmanFilter(
            self.noise, schedule, self.signals, self.iterations, self.moves_covariance
        )


class ReadyKalmanFilter(NamedTuple):
    """A `KalmanFilter` prepared for the loop."""

    noise: KalmanNoise
    schedule: PreparedNoiseGains
    signals: NoiseSignals | None
    iterations: int
    moves_covariance: bool

    def step(self, state: KalmanState, now: Samples) -> tuple[KalmanState, Record]:
        """One sample: update by vectors and landmarks, then propagation by the velocities."""
        sample, noise, record = now.sample, self.noise, Record()
        if self.signals is not None:
            sample, noise, memory, record = self._scheduled(self.signals, state, now)
            state = state._replace(memory=memory)
        updated, correction = update(state, sample, noise, self.iterations)
        moving = correction if self.moves_covariance else None
        return propagate(updated, moving, sample, noise), record

    def estimate(self, state: KalmanState) -> FilterState:
        """Pose and biases."""
        return state.estimate

    def _scheduled(
        self, signals: NoiseSignals, state: KalmanState, now: Samples
    ) -> tuple[Sample, KalmanNoise, KalmanMemory, Record]:
        """The sample with the weights that its residuals leave, the noises, and the memory."""
        sample, noise, memory, record = now.sample, self.noise, state.memory, Record()
        on_time = now.time, sample.time_step
        each = residuals(state, sample, noise)
        beliefs = self.schedule.vectors, self.schedule.landmarks
        memories: list[tuple[NoiseMemory, ...]] = []
        weights: list[list[Array]] = []
        for residual, schedule, before in zip(each, beliefs, memory[1:], strict=True):
            given = residual.factor
            if schedule is not None and before:
                follow = partial(noise_factor, schedule, signals.belief)

                def one(nothing: tuple[()], of_sensor: Any, follow: Any = follow) -> Any:
                    past, seen = of_sensor
                    factor, after, _ = follow(past, seen.normalised, seen.factor > 0, *on_time)
                    return nothing, (seen.factor / factor, after)

                _, (given, after) = lax.scan(one, (), (_stacked(before), residual))
                before = _apart(after, len(before))
            memories.append(before)
            weights.append([given[i] for i in range(given.shape[0])])
        sample = _weighted(sample, *weights)
        unknown = memory.unknown
        if self.schedule.unknown is not None and unknown:
            error, seen = measured_error(each, weights)
            factor, unknown, inputs = noise_factor(
                self.schedule.unknown, signals.unknown, unknown, error, seen, *on_time
            )
            noise = noise._replace(
                angular_velocity=factor * noise.angular_velocity,
                velocity=factor * noise.velocity,
                vector_walk=factor * noise.vector_walk,
            )
            record = Record(unknown.gain, unknown.gain, inputs.error, inputs.rate)
        return sample, noise, KalmanMemory(unknown, *memories), record


AS_MEASURED = VectorSettings(
    weights=None, cross_weight=0.0, normalise=False, cross=False, each_agent=True
)
"""Settings that leave the vectors as measured."""


def update(
    state: KalmanState, sample: Sample, noise: KalmanNoise, iterations: int = 1
) -> tuple[KalmanState, tuple[Array, ...]]:
    """The state after a sample's vectors and landmarks; missing measurements are skipped.

    The covariance is still in the coordinates before the last correction of the estimate, which is
    returned beside it: `propagate` moves it together with its own transport, in one product.

    Args:
        state: the state before the update, of the batch shape.
        sample: a sample with its vectors as measured (`KalmanFilter.prepare`).
        noise: `vector` and `landmark` are used.
        iterations: how often the measurements are linearised. From the second time on the prior is
            moved to the coordinates of the estimate found so far, in which its mean is no longer 0.

    Raises:
        ArgumentError: The sample holds only Wahba's sums of its vectors.
    """
    before, covariance = state.estimate, state.covariance
    count, zero = len(covariance), jnp.zeros_like(before.place[0])
    found = _linear_update(before, Found(covariance, (zero,) * count), sample, noise)
    estimate = _corrected(before, found.correction)

    def again(last: tuple[FilterState, Found], _: None) -> tuple[tuple[FilterState, Found], None]:
        estimate = last[0]
        back = _difference(estimate, before)
        prior = Found(_moved(covariance, tuple(-x for x in back)), back)
        found = _linear_update(estimate, prior, sample, noise)
        return (_corrected(estimate, found.correction), found), None

    if iterations > 1:
        (estimate, found), _ = lax.scan(again, (estimate, found), None, iterations - 1)
    return state._replace(estimate=estimate, covariance=found.covariance), found.correction


def _linear_update(
    estimate: FilterState, prior: Found, sample: Sample, noise: KalmanNoise
) -> Found:
    """Covariance and correction after the measurements, linearised at an estimate.

    Args:
        estimate: where to linearise.
        prior: the covariance before, and the mean of the errors of `estimate`.
        sample: as for `update`.
        noise: as for `update`.
    """
    R, found, learnt = rows(estimate.attitude), prior, bool(estimate.vector_biases)

    def by_vector(found: Found, vector: tuple[VectorSample, Vec3 | None]) -> tuple[Found, None]:
        each, residual = _vector_rows(R, *vector)
        factor = vector[0].factor
        found = _by_components(found, each, residual, _variance(noise.vector, factor), factor)
        return _next_vector_first(found) if learnt else found, None

    def by_landmark(found: Found, landmark: LandmarkSample) -> tuple[Found, None]:
        each, residual = _landmark_rows(R, estimate.place, landmark)
        variance = _variance(noise.landmark, landmark.factor)
        return _by_components(found, each, residual, variance, landmark.factor), None

    if vectors := each_vector(sample):
        found, _ = lax.scan(by_vector, found, _with_biases(vectors, estimate))
    if sample.landmarks:
        found, _ = lax.scan(by_landmark, found, _stacked(sample.landmarks))
    return found


def _vector_rows(R: Matrix3, vector: VectorSample, bias: Vec3 | None) -> tuple[list[Row], Vec3]:
    """Derivatives of a vector's components, its bias at `VECTORS`, and measured less predicted."""
    known = unrotate(R, vector.known)
    expected = known if bias is None else add(known, bias)
    each: list[Row] = [
        per_theta | ({} if bias is None else {VECTORS + axis: 1.0})
        for axis, per_theta in enumerate(_cross_rows(known))
    ]
    return each, subtract(vector.measured, expected)


def _landmark_rows(R: Matrix3, place: Vec3, landmark: LandmarkSample) -> tuple[list[Row], Vec3]:
    """Derivatives of a landmark's coordinates, and measured less predicted."""
    expected = unrotate(R, subtract(landmark.inertial, place))
    each: list[Row] = [
        per_theta | {3 + axis: -1.0} for axis, per_theta in enumerate(_cross_rows(expected))
    ]
    return each, subtract(landmark.body, expected)


def each_vector(sample: Sample) -> tuple[VectorSample, ...]:
    """The vectors of a sample one by one.

    Raises:
        ArgumentError: The sample holds only Wahba's sums of its vectors.
    """
    if isinstance(sample.vectors, Wahba):
        raise ArgumentError(
            "the Kalman filter needs each vector as measured: make its samples with its `prepare`"
        )
    return sample.vectors.each


def _with_biases(vectors: tuple[VectorSample, ...], estimate: FilterState) -> Any:
    """Vectors with their estimated biases, or with None, stacked for a loop."""
    biases = estimate.vector_biases or (None,) * len(vectors)
    return _stacked(zip(vectors, biases, strict=True))


class Residual(NamedTuple):
    """How far each sensor of a kind disagrees with the estimate, leaves (n, ...)."""

    square: Array
    """|z - y|^2 / (3 s^2), s the standard deviation of its noise; 1 if the estimate is right."""
    normalised: Array
    """|z - y|^2 over its expectation, tr(H Sigma H^T) + 3 s^2; 1 if the covariance is right."""
    factor: Array
    """Factor on its weight, 0 where it is missing."""


def residuals(state: KalmanState, sample: Sample, noise: KalmanNoise) -> tuple[Residual, Residual]:
    """The residuals of vectors and of landmarks, before any of them is used."""
    estimate, covariance = state.estimate, state.covariance
    R, like, axes = rows(estimate.attitude), estimate.place[0], range(3)
    learnt = bool(estimate.vector_biases)

    def residual(spread: Array, off: Vec3, deviation: Array, factor: Array) -> Residual:
        square, variance = dot(off, off), 3 * _variance(deviation, factor)
        return Residual(square / variance, square / (spread + variance), factor)

    def spread(each: Sequence[Row]) -> Array:
        """tr(H Sigma H^T) of rows over the states of the pose."""

        def column(h: Row, j: int) -> Array:
            return _product(h, lambda i: _entry(covariance, i, j))

        return reduce(operator.add, (_product(h, partial(column, h)) for h in each))

    def of_bias(i: int) -> tuple[list[list[Array]], Array] | None:
        """Covariance (axis, theta) of a vector's bias with the attitude, and its own trace."""
        if not learnt:
            return None
        first = VECTORS + 3 * i
        beside = [[_entry(covariance, j, first + axis) for j in axes] for axis in axes]
        own = reduce(operator.add, (_entry(covariance, first + a, first + a) for a in axes))
        return beside, own

    def by_vector(nothing: tuple[()], given: Any) -> Any:
        (vector, bias), biased = given
        each, off = _vector_rows(R, vector, bias)
        thetas: list[Row] = [{j: h[j] for j in h if j < ANGULAR} for h in each]
        total = spread(thetas)
        if biased is not None:
            beside, own = biased
            pairs = zip(thetas, beside, strict=True)
            crossed = [_product(h, of_axis.__getitem__) for h, of_axis in pairs]
            total = total + own + 2 * reduce(operator.add, crossed)
        return nothing, residual(total, off, noise.vector, vector.factor)

    def by_landmark(nothing: tuple[()], landmark: LandmarkSample) -> Any:
        each, off = _landmark_rows(R, estimate.place, landmark)
        return nothing, residual(spread(each), off, noise.landmark, landmark.factor)

    none = Residual(*(jnp.zeros((0, *like.shape), like.dtype),) * 3)
    of_vectors = of_landmarks = none
    if vectors := each_vector(sample):
        biased = _stacked(map(of_bias, range(len(vectors))))
        _, of_vectors = lax.scan(by_vector, (), (_with_biases(vectors, estimate), biased))
    if sample.landmarks:
        _, of_landmarks = lax.scan(by_landmark, (), _stacked(sample.landmarks))
    return of_vectors, of_landmarks


def measured_error(
    each: Iterable[Residual], weights: Iterable[Sequence[Array]]
) -> tuple[Array, Array]:
    """Root mean square residual in standard deviations of the noises, and whether there is one.

    A sensor that is believed less, with a weight below its factor, counts as much less.

    Args:
        each: The residuals of vectors and of landmarks.
        weights: Their weights after belief.
    """
    squares: list[Array] = []
    counts: list[Array] = []
    for residual, of_kind in zip(each, weights, strict=True):
        for i, weight in enumerate(of_kind):
            factor = residual.factor[i]
            seen = factor > 0
            believed = weight / choose(seen, factor, 1.0)
            squares.append(choose(seen, believed * residual.square[i], 0.0))
            counts.append(choose(seen, jnp.ones_like(weight), 0.0))
    total, count = reduce(operator.add, squares), reduce(operator.add, counts)
    return safe_sqrt(total / maximum(count, 1.0)), count > 0


def _weighted(sample: Sample, vectors: Sequence[Array], landmarks: Sequence[Array]) -> Sample:
    """A sample with other weights of its sensors."""
    assert isinstance(sample.vectors, VectorSamples)
    pairs = zip(sample.vectors.each, vectors, strict=True)
    points = zip(sample.landmarks, landmarks, strict=True)
    return sample._replace(
        vectors=sample.vectors._replace(each=tuple(v._replace(factor=w) for v, w in pairs)),
        landmarks=tuple(p._replace(factor=w) for p, w in points),
    )


def _stacked(sensors: Iterable[Any]) -> Any:
    """Sensors of one kind, stacked along a first axis for a loop that is compiled once."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *sensors)


def _apart(stacked: Any, count: int) -> tuple[Any, ...]:
    """The inverse of `_stacked`."""
    return tuple(jax.tree.map(lambda leaf, i=i: leaf[i], stacked) for i in range(count))


def propagate(
    state: KalmanState, correction: Sequence[Array] | None, sample: Sample, noise: KalmanNoise
) -> KalmanState:
    """The state at the next sample, by the measured velocities.

    Args:
        state: the state at this sample, of the batch shape.
        correction: of its estimate; its covariance is moved from the coordinates before it. None
            leaves it there.
        sample: its velocities and its time step are used.
        noise: densities of the velocities' noise and random walks of the biases are used.
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
    moved = _transported(state.covariance, correction, omega, v, dt)
    covariance = tuple(
        (row[0] + dt * density * density, *row[1:])
        for row, density in zip(moved, densities, strict=True)
    )
    moved_to = estimate._replace(attitude=attitude, place=place)
    return state._replace(estimate=moved_to, covariance=covariance)


def nees(state: KalmanState, truth: TruePose) -> Array:
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
    # The states have different units, so their correlation matrix is used; float32 suffices for it.
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
    """A sparse row times a column, which is a function from index to entry."""
    return reduce(operator.add, (factor * column(j) for j, factor in row.items()))


def _by_components(
    found: Found, each: Sequence[Row], residual: Vec3, variance: Array, factor: Array
) -> Found:
    """Covariance and correction x of the states after a sensor's scalars h x = residual + noise.

    Each scalar is a measurement of its own, after those before it. What these took off the
    covariance is taken off the next one's gain; off the covariance itself only once, for all
    together, so that its many numbers are read and written once a sensor. Outer products of one
    vector with itself are subtracted, so the covariance stays symmetric.

    Args:
        found: before it.
        each: the derivatives h of each scalar.
        residual: measured minus predicted with x = 0.
        variance: of each component's noise.
        factor: 0 where the measurement is missing.
    """
    covariance, correction = found
    every = range(len(covariance))
    gains: list[list[Array]] = []
    parts: list[list[Array]] = []
    for h, off in zip(each, residual, strict=True):
        # Sigma h^T: the Kalman gain times `total`.
        gain = [_product(h, lambda j, i=i, h=h: _entry(covariance, i, j)) for i in every]
        for earlier, part in zip(gains, parts, strict=True):
            taken = _product(h, part.__getitem__)
            gain = [g - taken * e for g, e in zip(gain, earlier, strict=True)]
        own = _product(h, gain.__getitem__)
        smallest = SMALLEST_CUT * float(jnp.finfo(own.dtype).eps)
        total = own + maximum(variance, smallest * own)
        used = (factor > 0) & (total > 0)
        per_total = choose(used, 1 / choose(used, total, 1.0), 0.0)
        surprise = per_total * (off - _product(h, correction.__getitem__))
        correction = tuple(x + surprise * g for x, g in zip(correction, gain, strict=True))
        gains.append(gain)
        parts.append([per_total * g for g in gain])

    def cut(entry: Array, i: int, j: int) -> Array:
        for part, gain in zip(parts, gains, strict=True):
            entry = entry - part[i] * gain[j]
        return entry

    covariance = tuple(
        tuple(cut(entry, i, j) for j, entry in enumerate(row, start=i))
        for i, row in enumerate(covariance)
    )
    return Found(covariance, correction)


def _next_vector_first(found: Found) -> Found:
    """The same with the vectors' bias states rotated, so that the second vector comes first.

    So the loop over vectors always finds the states of its vector in the same place; after the last
    vector they are back in their original order.
    """
    order = list(range(VECTORS))
    biases = range(VECTORS, len(found.covariance))
    order += [*biases[3:], *biases[:3]]
    covariance = tuple(
        tuple(_entry(found.covariance, order[i], order[j]) for j in range(i, len(order)))
        for i in range(len(order))
    )
    return Found(covariance, tuple(found.correction[i] for i in order))


def _moved(covariance: Covariance, correction: Sequence[Array]) -> Covariance:
    """The covariance in the coordinates of the estimate after a correction x of it.

    The error of the pose is then J (xi - x), with the right Jacobian J of SE(3) at x; here J is
    Ad of the inverse of `_half_way`: equal up to terms of second order in x, and never singular.
    """
    q, P = _half_way(correction)
    return _turned(covariance, rows(q), P)


def _half_way(correction: Sequence[Array]) -> tuple[Quaternion, Vec3]:
    """exp(x^ / 2) of the pose's part [theta; rho] of a correction x, up to second order.

    The quaternion is [1; theta / 4], normalised: simpler than the exponential, and a rotation too.
    """
    tx, ty, tz, *rho = correction[:ANGULAR]
    moved = rho[0], rho[1], rho[2]
    x, y, z = quarter = scale(0.25, (tx, ty, tz))
    w = 1 / jnp.sqrt(1 + dot(quarter, quarter))
    # In float32 a leap of kilometres, from garbage, would leave only rounding of the covariance.
    half = 0.5 / jnp.sqrt(1 + dot(moved, moved) / LONGEST_MOVE**2)
    return (w, w * x, w * y, w * z), scale(half, add(moved, cross(quarter, moved)))


def _turned(covariance: Covariance, R: Matrix3, P: Vec3) -> Covariance:
    """The covariance after xi <- Ad((R, P)^-1) xi."""
    every = range(len(covariance))
    left = [_adjoint(R, P, [_entry(covariance, i, j) for i in range(ANGULAR)]) for j in every]
    pose = [_adjoint(R, P, [left[j][i] for j in range(ANGULAR)]) for i in range(ANGULAR)]
    return tuple(
        tuple(pose[i][j] if j < ANGULAR else left[j][i] for j in every[i:])
        if i < ANGULAR
        else covariance[i]
        for i in every
    )


def _transported(
    covariance: Covariance, correction: Sequence[Array] | None, omega: Vec3, v: Vec3, dt: Array
) -> Covariance:
    """The covariance after xi <- A xi - 1/2 (I + A) dt b, A = Ad(exp(-[omega; v]^)) J (rad, m).

    J is that of `_moved`. It is in the factor of b too, where it does not belong: a second order
    in correction and time step. In three steps, which take half the products of one: xi <- xi -
    dt/2 b, A xi, xi - dt/2 b.
    """
    zero, one, half = jnp.zeros_like(dt), jnp.ones_like(dt), 0.5 * dt
    begin = ((one, zero, zero, zero), (zero, zero, zero))
    q, P = move(*(begin if correction is None else _half_way(correction)), omega, v)
    return _less_bias(_turned(_less_bias(covariance, half), rows(q), P), half)


def _less_bias(covariance: Covariance, factor: Array) -> Covariance:
    """The covariance after xi <- xi - factor b."""
    every, pose = range(len(covariance)), range(ANGULAR)
    beside = [
        [_entry(covariance, i, j) - factor * _entry(covariance, ANGULAR + i, j) for j in every]
        for i in pose
    ]  # the biases' columns are final, those of xi lack their own share
    return tuple(
        tuple(
            beside[i][j] - factor * beside[i][ANGULAR + j] if j < ANGULAR else beside[i][j]
            for j in every[i:]
        )
        if i < ANGULAR
        else covariance[i]
        for i in every
    )


def _adjoint(R: Matrix3, P: Vec3, xi: Sequence[Array]) -> tuple[Array, ...]:
    """[R^T theta; R^T (rho - P x theta)] of xi = [theta; rho], the inverse adjoint of (R, P)."""
    theta, rho = (xi[0], xi[1], xi[2]), (xi[3], xi[4], xi[5])
    return unrotate(R, theta) + unrotate(R, subtract(rho, cross(P, theta)))


def _cross_rows(a: Vec3) -> tuple[Row, Row, Row]:
    """Rows of [a]x, over theta."""
    return {1: -a[2], 2: a[1]}, {0: a[2], 2: -a[0]}, {0: -a[1], 1: a[0]}


def _variance(deviation: Array, factor: Array) -> Array:
    """Variance of a measurement with this weight; arbitrary if it is missing."""
    return deviation * deviation / choose(factor > 0, factor, 1.0)


def _corrected(estimate: FilterState, correction: tuple[Array, ...]) -> FilterState:
    """The estimate after the correction."""

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


def _difference(estimate: FilterState, other: FilterState) -> tuple[Array, ...]:
    """The errors of an estimate if another one were the truth, in the order of the states."""
    w, x, y, z = estimate.attitude
    R = rows(estimate.attitude)
    turned = compose((w, -x, -y, -z), other.attitude)
    theta, rho = _log(turned, unrotate(R, subtract(other.place, estimate.place)))
    errors = theta + rho
    for name in ("bias_angular", "bias_linear"):
        errors += subtract(getattr(other, name), getattr(estimate, name))
    for new, old in zip(estimate.vector_biases, other.vector_biases, strict=True):
        errors += subtract(old, new)
    return errors


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
