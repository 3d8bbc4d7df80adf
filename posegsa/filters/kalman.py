"""A left-invariant extended Kalman filter on SE(3), whose noises schedules may change.

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
most filters do); the neglected change is of first order in the correction. With `reset` it is
carried to those of the new estimate, in the product that propagates it, so that the right error of
pose and biases as one group keeps its covariance (A. Barrau, S. Bonnabel, "The Geometry of
Navigation Problems", arXiv:2201.04426). That pays after a wrong start with one linearisation, if
the noises are not tuned for it. With `iterations` above 1 the update is iterated until the attitude
hardly changes; then a wrong start does little harm, without any tuning. Schedules may change the
noises while the filter runs (`filters.noise_schedules`).

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
(`tests/filters/test_kalman.py`). For large ones a single linearisation is not: the covariance does
not include its error. It shrinks with the first samples, whether or not they have improved the
estimate, and the remaining error is corrected only as fast as the process noise allows. At 180 deg
from the truth the vectors give no correction at all, and vector-bias states explain a wrong
attitude by biases. With up to ten linearisations it converges from such starts, with nothing tuned
(docs/recommended.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self, cast

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.arguments import check_type, refuse
from posegsa.filters.base import Record, Samples, Sensors, with_vector_biases
from posegsa.filters.belief import (
    BeliefInput,
    BeliefMemory,
    as_believed,
    belief_factors,
    halfway_to_the_least,
    initial_beliefs,
    residuals,
)
from posegsa.filters.covariance import (
    ANGULAR,
    LINEAR,
    POSE,
    VECTORS,
    Covariance,
    Found,
    Reset,
    by_components,
    matrix,
    next_vector_first,
    transported,
)
from posegsa.filters.leads import LEAD_KEYS, LastSample, Leads, extrapolated, no_sample
from posegsa.filters.measurement_model import (
    landmark_rows,
    measured_error,
    variance_of,
    vector_rows,
    weighted,
    with_biases,
)
from posegsa.filters.noise_levels import NoiseLevels, at_levels, next_levels, stated
from posegsa.filters.noise_schedules import (
    NO_NOISE_GAINS,
    SIGNAL_KEYS,
    NoiseGains,
    NoiseMemory,
    NoiseSignals,
    initial_noise_memory,
    noise_factor,
)
from posegsa.filters.uncertainty import PoseCovariance
from posegsa.model.elementwise import as_long_as, choose, maximum
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import LandmarkSample, Sample, prepare
from posegsa.model.schedules import PreparedSchedule, all_elementwise, prepared
from posegsa.model.se3 import (
    Vec3,
    add,
    log,
    move,
    product,
    rows,
    safe_sqrt,
    scale,
    subtract,
    unrotate,
)
from posegsa.model.sensor_loops import in_turn, stacked
from posegsa.model.vectors import AS_MEASURED, VectorSample

LINEAR_UP_TO = 0.03
"""An update of several iterations ends when the attitude's correction is at most so large [rad].
What the linearisation then neglects is under 0.05 % of a vector, and under 1.5 % of the position's
correction in a landmark."""


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
    """The memory of the noise schedules; () for a role that the filter does not have."""

    unknown: NoiseMemory | tuple[()] = ()
    vectors: tuple[NoiseMemory, ...] = ()
    """One for each vector."""
    landmarks: tuple[NoiseMemory, ...] = ()
    """One for each landmark."""


class KalmanState(NamedTuple):
    """The estimate and its covariance, by components of any common batch shape."""

    estimate: FilterState
    """As for the observer, with `turning` ()."""
    covariance: Covariance
    """Sigma of 12 states, or 12 + 3 n with the biases of n vectors."""
    memory: KalmanMemory = KalmanMemory()
    """Memory of the noise schedules."""
    last: LastSample | tuple[()] = ()
    """The last velocities; () for a filter that does not extrapolate them."""
    levels: NoiseLevels | tuple[()] = ()
    """What is known of each sensor's noise; () for a filter that does not estimate it."""

    @property
    def covariance_matrix(self) -> Array:
        """Sigma (..., d, d)."""
        return matrix(self.covariance, len(self.covariance))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KalmanFilter:
    """The invariant extended Kalman filter (`filters.base.Filter`)."""

    noise: KalmanNoise
    """Assumed noise of its sensors and its initial estimate."""
    vector_biases: bool = field(default=True, metadata={"static": True})
    """Whether the vectors' biases are states: 12 + 3 n of them for n vectors, else 12."""
    schedule: NoiseGains = NO_NOISE_GAINS
    """The schedules that change the noises while the filter runs; by default none."""
    signals: NoiseSignals | None = None
    """The input signals of the schedules; None if there are no schedules."""
    belief_input: BeliefInput = field(default="residual", metadata={"static": True})
    """Which function of a sensor's residual is the input of belief (`Residual.normalised`)."""
    iterations: int = field(default=1, metadata={"static": True})
    """How often the measurements of a sample are linearised at most, each time at the estimate that
    the last time found (an iterated extended Kalman filter), until its attitude hardly changes any
    more (`LINEAR_UP_TO`)."""
    reset: Reset = field(default="off", metadata={"static": True})
    """How the covariance is carried to the coordinates of the new estimate after an update."""
    leads: Leads | None = None
    """How far the measured velocities are extrapolated; None leaves them as they are."""
    noise_adaptation: Array | None = None
    """Memory with which the noise of each sensor is estimated, in its samples
    (`filters.noise_levels`); None leaves the noises as they are."""
    vector_scales: tuple[float, ...] = field(default=(), metadata={"static": True})
    """Noise of each vector, in order, as a multiple of `noise.vector`; 1 for further ones."""
    landmark_scales: tuple[float, ...] = field(default=(), metadata={"static": True})
    """The same for landmarks, as multiples of `noise.landmark`."""

    @property
    def elementwise(self) -> bool:
        """Whether its step works on components of any shape, as all do but users' schedules."""
        return all_elementwise(self.schedule)

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with some numbers replaced.

        Args:
            values: By their names in `KalmanNoise`; those of a signal as "unknown_smoothing" or
                "belief_smoothing", with the names in `NoiseSignal`; "angular_lead", "linear_lead";
                "noise_adaptation", if it is not None.

        Raises:
            ArgumentError: There is no number with this name.
        """
        of_signals, of_leads = (
            keys if there else ()
            for keys, there in ((SIGNAL_KEYS, self.signals), (LEAD_KEYS, self.leads))
        )
        of_levels = () if self.noise_adaptation is None else ("noise_adaptation",)
        known = (*KalmanNoise._fields, *of_signals, *of_leads, *of_levels)
        if wrong := [key for key in values if key not in known]:
            refuse(f"{wrong[0]}: not a number of this filter", ", ".join(known))
        noise, signals, leads = (
            {key: values[key] for key in keys if key in values}
            for keys in (KalmanNoise._fields, of_signals, of_leads)
        )
        ahead = {key.removesuffix("_lead"): value for key, value in leads.items()}
        return replace(
            self,
            noise=self.noise._replace(**noise),
            signals=self.signals and self.signals.with_values(signals),
            leads=self.leads and self.leads._replace(**ahead),
            noise_adaptation=values.get("noise_adaptation", self.noise_adaptation),
        )

    def prepare(self, measurements: Measurements) -> Sample:
        """Each vector as measured, and landmarks.

        Samples prepared for an observer that estimates the vectors' biases work too.
        """
        return prepare(measurements, AS_MEASURED)

    def start(self, initial: FilterState, sensors: Sensors) -> KalmanState:
        """The state before the first sample; its covariance comes from the initial deviations.

        Raises:
            ArgumentError: `initial` has biases of another number of vectors, or `noise` is no
                `KalmanNoise`.
        """
        check_type("noise", self.noise, KalmanNoise)
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
            *initial_beliefs(beliefs, sensors, like, self.belief_input),
        )
        last = () if self.leads is None else no_sample(like)
        levels = () if self.noise_adaptation is None else stated(sensors, like)
        return KalmanState(estimate, covariance, memory, last, levels)

    def ready(self) -> Self:
        """The filter for `step`, its schedules prepared (slopes and overlaps of the terms)."""
        return replace(self, schedule=NoiseGains(*prepared(self.schedule)))

    def step(self, state: KalmanState, now: Samples) -> tuple[KalmanState, Record]:
        """One sample: update by vectors and landmarks, then propagation by the velocities."""
        if self.leads is not None and state.last:
            ahead, last = extrapolated(now.sample, state.last, self.leads)
            now, state = now._replace(sample=ahead), state._replace(last=last)
        if self.vector_scales or self.landmark_scales:
            scaled = _scaled(now.sample, self.vector_scales, self.landmark_scales)
            now = now._replace(sample=scaled)
        noise, record, levels = self.noise, Record(), state.levels
        if self.noise_adaptation is not None and isinstance(levels, NoiseLevels):
            of = noise.angular_velocity, noise.velocity, noise.vector, noise.landmark
            after = next_levels(levels, state.estimate, now.sample, of, self.noise_adaptation)
            now = now._replace(sample=at_levels(now.sample, levels))
            state = state._replace(levels=after)
            noise = noise._replace(
                angular_velocity=safe_sqrt(levels.angular_velocity.factor) * noise.angular_velocity,
                velocity=safe_sqrt(levels.velocity.factor) * noise.velocity,
            )
        sample = now.sample
        if self.signals is not None:
            sample, noise, memory, record = self._scheduled(self.signals, noise, state, now)
            state = state._replace(memory=memory)
        updated, found = update(state, sample, noise, self.iterations)
        record = record._replace(nis=found.nis, scalars=found.scalars)
        after = propagate(updated, found.correction, sample, noise, self.reset)
        if self.schedule.unknown is not None and after.estimate.vector_biases:
            after = forgotten(after, sample.time_step, self.noise, noise.vector_walk)
        return after, record

    def estimate(self, state: KalmanState) -> FilterState:
        """Pose and biases."""
        return state.estimate

    def pose_covariance(self, state: KalmanState) -> PoseCovariance:
        """The covariance of xi."""
        return tuple(row[: ANGULAR - i] for i, row in enumerate(state.covariance[:ANGULAR]))

    def _scheduled(
        self, signals: NoiseSignals, noise: KalmanNoise, state: KalmanState, now: Samples
    ) -> tuple[Sample, KalmanNoise, KalmanMemory, Record]:
        """The sample with the weights that its residuals leave, the noises, and the memory."""
        sample, memory = now.sample, state.memory
        on_time, record = (now.time, sample.time_step), Record()
        of_noise, *beliefs = cast(Sequence[PreparedSchedule | None], self.schedule)
        if any(beliefs):
            known = state.estimate, state.covariance, sample, noise.vector, noise.landmark
            each, before = residuals(*known, of=self.belief_input), BeliefMemory(*memory[1:])
            factors, after = belief_factors(beliefs, signals.belief, before, each, *on_time)
            factors = halfway_to_the_least(factors, sample, signals.belief.largest)
            sample, memory = as_believed(sample, factors), KalmanMemory(memory.unknown, *after)
        if of_noise is not None and memory.unknown:
            error, seen = measured_error(state.estimate, sample, noise.vector, noise.landmark)
            factor, unknown, inputs = noise_factor(
                of_noise, signals.unknown, memory.unknown, error, seen, *on_time
            )
            noise = noise._replace(
                angular_velocity=factor * noise.angular_velocity,
                velocity=factor * noise.velocity,
                vector_walk=factor * noise.vector_walk,
            )
            memory = memory._replace(unknown=unknown)
            record = Record(error=inputs.error, rate=inputs.rate)
        return sample, noise, memory, record


def _scaled(sample: Sample, vectors: Sequence[float], landmarks: Sequence[float]) -> Sample:
    """A sample whose sensors have these multiples of their noise, 1 for further ones."""

    def weights(sensors: Sequence[Any], scales: Sequence[float]) -> list[Array]:
        each = [*scales, *(1.0,) * len(sensors)]
        return [one.factor / (s * s) for one, s in zip(sensors, each, strict=False)]

    seen = weights(sample.vectors.each, vectors), weights(sample.landmarks, landmarks)
    return weighted(sample, *seen)


def update(
    state: KalmanState, sample: Sample, noise: KalmanNoise, iterations: int = 1
) -> tuple[KalmanState, Found]:
    """The state after a sample's vectors and landmarks; missing measurements are skipped.

    The covariance is still in the coordinates of the last linearisation, before its correction of
    the estimate. That correction is returned too: `propagate` applies it with its own transport, in
    one product. The innovations are those of the last linearisation.

    Args:
        state: the state before the update, of the batch shape.
        sample: a sample with its vectors as measured (`KalmanFilter.prepare`).
        noise: `vector` and `landmark` are used.
        iterations: how often the measurements are linearised at most. From the second time on the
            mean of the prior is the difference of the estimate before from that found so far. Its
            covariance is not moved to the new coordinates: in our measurements that changes costs
            by less than 1 % (docs/recommended.md). More than one has no derivative in reverse mode.

    Raises:
        ArgumentError: The sample holds only Wahba's sums of its vectors.
    """
    before, covariance = state.estimate, state.covariance
    # `choose`, so that `vmap` batches it, and need not find out in the loops below that it must.
    count, zero = len(covariance), choose(True, jnp.zeros_like(before.place[0]), before.place[0])
    nothing = Found(covariance, (zero,) * count, nis=zero, scalars=zero)

    def linearised(estimate: FilterState, prior: Found) -> tuple[FilterState, Found]:
        found = _linear_update(estimate, prior, sample, noise)
        return _corrected(estimate, found.correction), found

    def again(last: tuple[FilterState, Found]) -> tuple[FilterState, Found]:
        estimate, _ = last
        return linearised(estimate, nothing._replace(correction=_difference(estimate, before)))

    def large(last: tuple[FilterState, Found]) -> Array:
        x, y, z, *_ = last[1].correction
        return x * x + y * y + z * z > LINEAR_UP_TO * LINEAR_UP_TO

    if iterations <= 1:
        estimate, found = linearised(before, nothing)
    else:  # the first correction is a large one, so that the loop has a first turn
        begin = nothing._replace(correction=(zero + 1,) * count)
        estimate, found = as_long_as(large, again, (before, begin), iterations)
    return state._replace(estimate=estimate, covariance=found.covariance), found


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
        each, residual = vector_rows(R, *vector)
        factor = vector[0].factor
        found = by_components(found, each, residual, variance_of(noise.vector, factor), factor)
        return next_vector_first(found) if learnt else found, None

    def by_landmark(found: Found, landmark: LandmarkSample) -> tuple[Found, None]:
        each, residual = landmark_rows(R, estimate.place, landmark)
        variance = variance_of(noise.landmark, landmark.factor)
        return by_components(found, each, residual, variance, landmark.factor), None

    if vectors := sample.vectors.each:
        found, _ = in_turn(by_vector, found, with_biases(vectors, estimate))
    if sample.landmarks:
        found, _ = in_turn(by_landmark, found, stacked(sample.landmarks))
    return found


def propagate(
    state: KalmanState,
    correction: Sequence[Array],
    sample: Sample,
    noise: KalmanNoise,
    reset: Reset = "off",
) -> KalmanState:
    """The state at the next sample, by the measured velocities.

    Args:
        state: the state at this sample, of the batch shape.
        correction: that of the last linearisation. The estimate has it already, the covariance has
            not; a reset uses it.
        sample: its velocities and its time step are used.
        noise: densities of the velocities' noise and random walks of the biases are used.
        reset: how the covariance is carried to the coordinates of the estimate; "off" leaves it.
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
    after = transported(state.covariance, correction, omega, v, dt, reset)
    covariance = tuple(
        (row[0] + dt * density * density, *row[1:])
        for row, density in zip(after, densities, strict=True)
    )
    moved_to = estimate._replace(attitude=attitude, place=place)
    return state._replace(estimate=moved_to, covariance=covariance)


def forgotten(state: KalmanState, time_step: Array, noise: KalmanNoise, walk: Array) -> KalmanState:
    """The state after its estimates of the vectors' biases have been forgotten in part.

    A walk that a schedule has raised from w to W alone would let these biases grow without bound,
    and explain a wrong attitude. So they return to 0 at the rate (W^2 - w^2) / (2 s^2), which makes
    what the walk has added a Gauss-Markov process with the variance s^2, that of the start.

    Args:
        state: The state, of the batch shape.
        time_step: [s].
        noise: As configured: `vector_walk` is w, `initial_vector_bias` is s.
        walk: W [1/sqrt(s)], in the vectors' unit.
    """
    initial = noise.initial_vector_bias * noise.initial_vector_bias
    more = walk * walk - noise.vector_walk * noise.vector_walk
    smallest = float(jnp.finfo(initial.dtype).tiny)
    keep = 1 / (1 + 0.5 * time_step * more / maximum(initial, smallest))
    both = keep * keep
    covariance = tuple(
        tuple(
            entry * (both if i >= VECTORS else keep) if j >= VECTORS else entry
            for j, entry in enumerate(row, start=i)
        )
        for i, row in enumerate(state.covariance)
    )
    biases = tuple(scale(keep, c) for c in state.estimate.vector_biases)
    return state._replace(
        estimate=state.estimate._replace(vector_biases=biases), covariance=covariance
    )


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
    w, x, y, z = q = estimate.attitude
    other_w, other_x, other_y, other_z = other.attitude
    apart = other_w - w, other_x - x, other_y - y, other_z - z
    # q^-1 (q + apart), so that an estimate differs from itself by exactly 0, without any rounding.
    cosine, *sine = product((w, -x, -y, -z), apart)
    turned = 1 + cosine, sine[0], sine[1], sine[2]
    theta, rho = log(turned, unrotate(rows(q), subtract(other.place, estimate.place)))
    errors = theta + rho
    for name in ("bias_angular", "bias_linear"):
        errors += subtract(getattr(other, name), getattr(estimate, name))
    for new, old in zip(estimate.vector_biases, other.vector_biases, strict=True):
        errors += subtract(old, new)
    return errors
