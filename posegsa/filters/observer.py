"""The nonlinear pose observer on SE(3), with a gain schedule.

symbol  | meaning                              | here                    | shape  | unit, frame
------- | ------------------------------------ | ----------------------- | ------ | ----------------
R, P    | attitude and position, T = (R, P)    | `signal.TruePose`       | 3x3, 3 | B to I; m, I
T_est   | their estimate (a hat in the paper)  | `FilterState`           | 4, 3   | quaternion; m, I
b_est   | estimate of the velocity's bias      | `FilterState`           | 3, 3   | rad/s, m/s, B
c_i     | estimate of a vector's bias          | `FilterState`           | 3      | as the vector; B
Y_m     | measured [Omega_m; V_m]              | `Sample`                | 3, 3   | rad/s, m/s, B
v_i     | a vector, measured in B, known in I  | `vectors`               | 3      | B and I
u_i     | v_i^B less its bias, normalised      | `vectors.Wahba`         | 3      | B
y_i     | a landmark as seen from the body     | `landmarks[i].body`     | 3      | m, B
p_i     | its known position                   | `landmarks[i].inertial` | 3      | m, I
s_i     | weight of a vector (R), landmark (L) | `FilterSettings`        | -      | 1 (R), 1/m^2 (L)
x_i     | T_est y_i                            | `seen_from_estimate`    | 3      | m, I
U       | innovation [u_1; u_2]                | `Innovation`            | 3, 3   | 1, 1/m; I
W       | correction of the body velocity      | `Correction`            | 3, 3   | as U; B
K       | gain                                 | `gain`                  | -      | 1/s
gamma   | gains of the law of b_est            | `FilterSettings`        | 2      | 1/s^2
gamma_c | gain of the vectors' bias law        | `VectorBias.gain`       | -      | 1/s
L       | curvature: K dt L < 2 is stable      | `Innovation.curvature`  | -      | 1
c       | gain limit, K <= c / (dt L)          | `gain_limit`            | -      | 1
n       | sub-steps in a sample                | `substeps`              | -      | 1

The observer (Eq. 9 of the paper, after Hua et al. 2011, "Observer design on the special Euclidean
group SE(3)", IEEE Conference on Decision and Control):
    U = 1/2 sum_i s_i^L (T_est y_i) ^ p_i + 1/2 sum_i s_i^R (R_est u_i) ^ v_i^I
    dT_est/dt = T_est [Y_m - b_est + K W]^
    law "gradient":  W = Ad(T_est^-1) U,  db_est/dt = -gamma Ad(T_est)^T U
    law "printed":   W = Ad(T_est)^T U,   db_est/dt = -gamma Ad(T_est^-1) U
The paper prints the second. The observer's Lyapunov argument holds for the first: with it the
spatial velocity error is K U - Ad(T_est) b_err, and the cost's derivative is -K |U|^2.

Coupled gains. A constant gamma is too small for a high K and rings with a low one: the pair behaves
like an oscillator of frequency sqrt(gamma L) damped by K L. So gamma can follow the gain after its
limit:
    "fixed":      gamma = g
    "linear":     gamma = g (K / 10)
    "quadratic":  gamma = g (K / 10)^2, a constant damping
with K in 1/s, so that g [1/s^2] is always gamma at K = 10/s. A bias of the angular velocity moves a
landmark in proportion to its distance |y_i|, and the residual acts on the bias with the same lever:
that oscillator has the frequency sqrt(gamma (1 + |y_i|^2) L). The explicit step is unstable at
frequencies above sqrt(K L / dt). So both laws limit gamma, with y the farthest landmark, to
    gamma dt (1 + |y|^2) <= K / 2  for the angular velocity,   gamma dt <= K / 2  for the linear.

The unit of length. The gain K corrects attitude and position, in proportions that depend on the
unit of length. For landmarks d metres from the origin the cost's curvature is d^2 times as high in
attitude as in position; with the largest K that the attitude allows, the position then converges
d^2 times as slowly. In a unit of l metres (`length`) u_2 is multiplied by l^2,
    W = [R^T u_1; R^T (l^2 u_2 - P x u_1)],  Ad(T)^T U likewise [R^T (u_1 - P x u_2); l^2 R^T u_2]
for the law "gradient"; in L, every 1 that is added to a squared length becomes l^2; and the limit
of gamma becomes gamma dt (1 + |y|^2 / l^2) <= K / 2. With l about d, attitude and position converge
equally fast. It is the same observer in another unit. With `length_growth` a the unit grows with
the distance of the farthest measured landmark, l^2 = length^2 + a max |y_i|^2. Weights of landmarks
are per square metre; with `landmark_unit` "length" they are per l^2, s_i / l^2 takes the place of
s_i, so that the same K and weights suit landmarks at any distance: position then converges at the
rate K sum s_i / 2, attitude at this rate times (d / l)^2.

Stability. Let f be the cost whose negative gradient is U. Without noise and with constant gamma, f
+ |b_err|^2 / (2 gamma) never increases. With a varying gamma that function does not increase while
gamma increases, and gamma f + |b_err|^2 / 2 does not while it decreases. Together they suffice if
log gamma has bounded variation, as it has for a gain that settles.

Bounds of the biases. While the pose is far off, the bias laws learn biases that do not exist: with
the high gain of a start at 100 degrees, b_est grows to many times any real bias, and recovers only
when the pose does. If the measurements stop before that, b_est stays wrong and the estimate runs
away. Optional bounds limit |b_est|, and |c_i| below. And with `per_bias_wait` all bias laws wait
for the pose (`bias_share`).

Biases of the vectors. They are part of the sensor model (Eq. 2); ignoring them causes nearly all of
the steady error. With c_i the estimated bias and d_i = v_i^B - c_i,
    dc_i/dt = gamma_c (d_i - R_est^T v_i^I) - leak c_i,   |c_i| <= bound,
is gradient descent on 1/2 |R_est d_i - v_i^I|^2. U uses the u_i, which are the normalised d_i
(`vectors`). Only while the body turns can c_i be distinguished from an error of R_est; at rest they
are indistinguishable along three directions. So gamma_c is multiplied by min(1, (w / w_0)^4), where
w is the length of the low-passed angular velocity: at rest the c_i stay as they are. For a rotating
body there is no Lyapunov proof, because df/dt has a term s_i / 2 r_i^T R_est [Omega]^ (b_i - c_i)
of either sign. That the pose and all biases converge without noise is shown by test
(`tests/filters/test_observer_convergence.py`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal, NamedTuple, Self, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.arguments import refuse
from posegsa.errors import ArgumentError
from posegsa.filters.base import Record, Samples, Sensors, with_vector_biases
from posegsa.filters.belief import (
    BeliefMemory,
    as_believed,
    belief_factors,
    initial_beliefs,
    over_the_least,
    residuals,
)
from posegsa.filters.noise_schedules import NoiseSignal
from posegsa.model.elementwise import choose, maximum, minimum
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, Seen, prepare, seen_from_estimate
from posegsa.model.schedules import (
    Gains,
    GainSchedule,
    all_elementwise,
    check_schedule,
    prepared,
)
from posegsa.model.se3 import (
    Vec3,
    add,
    cross,
    dot,
    move,
    rows,
    safe_sqrt,
    scale,
    subtract,
    unrotate,
)
from posegsa.model.signal import (
    Measured,
    SignalMemory,
    SignalSettings,
    initial_memory,
    measured_errors,
    pose_errors,
    scheduled_gain,
    still_unknown,
)
from posegsa.model.vectors import VectorSettings, Wahba, corrected

Law = Literal["gradient", "printed"]
LandmarkUnit = Literal["metre", "length"]
"""What the weight of a landmark is per square of: a metre, or the unit of length."""
GainLaw = Literal["fixed", "linear", "quadratic"]
"""How the gain of a bias law depends on K: constant, or in proportion to K or K^2."""

REFERENCE_GAIN = 10.0
"""The gain K [1/s] at which gamma and gamma_c have their configured values."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class VectorBias:
    """How the vectors' biases are estimated; the numbers are traced."""

    gain: Array
    """gamma_c at K = 10/s [1/s]."""
    leak: Array
    """Rate at which an estimate decays [1/s]."""
    per_bound: Array
    """1 / bound^2, where bound is the maximum length of an estimate, in the vector's unit. Without
    it a wrong c_i can compensate a wrong attitude."""
    per_turning: Array
    """1 / w_0^4, where w_0 is the angular velocity [rad/s] above which the full gain is used."""
    excitation_time: Array
    """Time constant of the low-pass filter of the angular velocity [s]."""
    law: GainLaw = field(metadata={"static": True})
    """How gamma_c depends on K."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FilterSettings:
    """Settings of a filter step. Numbers are traced, everything else is static.

    The defaults suit vectors and landmarks on any motion; they do not estimate vectors' biases.
    """

    law: Law = field(default="gradient", metadata={"static": True})
    gamma_law: GainLaw = field(default="quadratic", metadata={"static": True})
    """How gamma depends on K."""
    substeps: int = field(default=2, metadata={"static": True})
    """n, number of inner steps per sample."""
    landmark_unit: LandmarkUnit = field(default="metre", metadata={"static": True})
    """Whether weights of landmarks are in 1/m^2 or in 1/l^2."""
    gamma_angular: Array | float = 2.5
    """gamma of the angular velocity's bias at K = 10/s [1/s^2]."""
    gamma_linear: Array | float = 2.5
    """gamma of the linear velocity's bias at K = 10/s [1/s^2]."""
    gain_limit: Array | float = 1.5
    """c; infinite means no limit."""
    vectors: VectorSettings = field(default_factory=VectorSettings)
    """Weights, normalisation and cross product of the vectors."""
    landmark_weights: tuple[Array, ...] | None = None
    """s_i^L of each landmark [1/m^2, or 1/l^2]; None means 1 for all."""
    vector_bias: VectorBias | None = None
    """How the vectors' biases are estimated; None if they are not."""
    per_angular_bias_bound: Array | None = None
    """1 / bound^2 [s^2/rad^2], where bound is the maximum length of the estimated bias of the
    angular velocity; None means no bound."""
    per_linear_bias_bound: Array | None = None
    """The same for the linear velocity [s^2/m^2]."""
    length: Array | None = None
    """l, the unit of length [m] (see the top of this module); None means 1 m, as the law "printed"
    requires."""
    length_growth: Array | None = None
    """By how much l^2 grows with the square of the distance of the farthest landmark, no unit; None
    means 0."""
    per_bias_wait: Array | None = None
    """1 / w^2, where w is the error signal at which the gains of all bias laws are half; None if
    they do not depend on it."""

    def unit(self, sample: Sample) -> Array | int:
        """l^2 [m^2]."""
        unit = 1 if self.length is None else self.length * self.length
        return unit if self.length_growth is None else unit + self.length_growth * sample.reach


class ObserverGains(NamedTuple):
    """The schedules of an observer with belief; None for sensors that are always believed."""

    gain: GainSchedule
    """Sets the gain K."""
    vectors: GainSchedule | None = None
    """Belief in each vector: the divisor of its weight."""
    landmarks: GainSchedule | None = None
    """Belief in each landmark: the divisor of its weight."""


class BeliefSettings(NamedTuple):
    """How an observer judges its sensors; all traced."""

    signal: NoiseSignal
    """The input signal of the schedules of belief."""
    vector: Array
    """Standard deviation of the noise of each component of a vector, in its unit."""
    landmark: Array
    """Standard deviation of the noise of each coordinate of a landmark [m]."""


class Innovation(NamedTuple):
    """U = [u_1; u_2] and the curvature bound L of the cost whose gradient it is."""

    angular: Vec3
    linear: Vec3
    curvature: Array


class Correction(NamedTuple):
    """W, and db_est/dt divided by -gamma, both in the body frame."""

    angular: Vec3
    linear: Vec3
    bias_angular: Vec3
    bias_linear: Vec3


def see(state: FilterState, sample: Sample, settings: FilterSettings) -> Seen:
    """The sample with the estimated biases removed from its vectors, and with its weights."""
    if isinstance(sample.vectors, Wahba):
        wahba, freed = sample.vectors, ()
    else:
        wahba, freed = corrected(sample.vectors, state.vector_biases, settings.vectors)
    factors = [landmark.factor for landmark in sample.landmarks]
    weights = settings.landmark_weights or [jnp.ones_like(f) for f in factors]
    return Seen(wahba, freed, tuple(s * f for s, f in zip(weights, factors, strict=True)))


def innovation(state: FilterState, sample: Sample, seen: Seen, unit: Array | int = 1) -> Innovation:
    """U (Eq. 9) and L, with l^2 = `unit` [m^2].

    The vectors' part of u_1 is the antisymmetric part of R_est B, because (R u) x v belongs to the
    antisymmetric part of (R u) v^T. U is the negative gradient of
        f = 1/4 sum s_i^L |x_i - p_i|^2 + 1/4 sum s_i^R |R_est u_i - v_i^I|^2,
    and L bounds its Hessian:
        L = 1/2 sum s_i^R |u_i||v_i^I|
          + 1/4 sum s_i^L [l^2 + |x_i||p_i| + sqrt((l^2 + |x_i|^2)(l^2 + |p_i|^2))].
    """
    R = rows(state.attitude)
    columns = tuple(zip(*seen.wahba.profile, strict=True))
    # (R B)_ij is row i of R times column j of B; only the six off-diagonal entries are needed.
    u1: Vec3 = (
        dot(R[1], columns[2]) - dot(R[2], columns[1]),
        dot(R[2], columns[0]) - dot(R[0], columns[2]),
        dot(R[0], columns[1]) - dot(R[1], columns[0]),
    )
    zero = jnp.zeros_like(state.place[0])
    u2: Vec3 = (zero, zero, zero)
    curvature = seen.wahba.curvature
    points = seen_from_estimate(state, R, sample)
    for x, landmark, s in zip(points, sample.landmarks, seen.landmark_weights, strict=True):
        p = landmark.inertial
        u1 = add(u1, scale(s, cross(x, p)))
        u2 = add(u2, scale(s, subtract(p, x)))
        x2, p2 = dot(x, x), dot(p, p)
        product = safe_sqrt(x2 * p2) + jnp.sqrt((unit + x2) * (unit + p2))
        curvature = curvature + 0.25 * s * (unit + product)
    return Innovation(scale(0.5, u1), scale(0.5, u2), curvature)


def correction(state: FilterState, U: Innovation, law: Law, unit: Array | int = 1) -> Correction:
    """W, and the bias law without its gains (Eq. 9, top of this module); l^2 = `unit` [m^2]."""
    R = rows(state.attitude)
    # Ad(T^-1) U = [R^T u_1; R^T (u_2 - P x u_1)],  Ad(T)^T U = [R^T (u_1 - P x u_2); R^T u_2], and
    # R^T (a x b) = (R^T a) x (R^T b), so each inertial vector is rotated only once.
    P, angular, linear = (unrotate(R, a) for a in (state.place, U.angular, U.linear))
    pull = linear if isinstance(unit, int) else scale(unit, linear)
    inverse = angular, subtract(pull, cross(P, angular))
    transpose = subtract(angular, cross(P, linear)), pull
    W, bias = (inverse, transpose) if law == "gradient" else (transpose, inverse)
    return Correction(*W, *bias)


def bias_gains(
    used: Array, sample: Sample, settings: FilterSettings
) -> tuple[Array | float, Array | float]:
    """Both gammas [1/s^2] for the gain K of a sub-step."""
    gammas = settings.gamma_angular, settings.gamma_linear
    if settings.gamma_law == "fixed":
        return gammas
    follow = _following(settings.gamma_law, used)
    linear = 0.5 / sample.time_step
    unit = settings.unit(sample)
    reach = sample.reach if isinstance(unit, int) else sample.reach / unit
    angular = linear / (1 + reach)
    largest = used * angular, used * linear
    angular, linear = (minimum(g * follow, most) for g, most in zip(gammas, largest, strict=True))
    return angular, linear


def _following(law: GainLaw, used: Array) -> Array | float:
    """The factor on the gain of a bias law at the gain K = `used` [1/s]."""
    relative = used * (1 / REFERENCE_GAIN)
    return {"fixed": 1.0, "linear": relative, "quadratic": relative * relative}[law]


def limited_correction(
    state: FilterState,
    sample: Sample,
    seen: Seen,
    gain: Array,
    h: Array,
    settings: FilterSettings,
) -> tuple[Correction, Array]:
    """W at an estimate, and the limited gain K [1/s] for a sub-step of h [s]."""
    unit = settings.unit(sample)
    if settings.landmark_unit == "length":
        per_unit = 1 / unit
        weights = tuple(s * per_unit for s in seen.landmark_weights)
        seen = seen._replace(landmark_weights=weights)
    U = innovation(state, sample, seen, unit)
    W = correction(state, U, settings.law, unit)
    # K h L <= c < 2: a gradient step that does not overshoot. If L is 0 (no measurements) or c is
    # infinite (no limit), neither value nor derivative may depend on them.
    length = h * U.curvature
    limited = (length > 0) & jnp.isfinite(settings.gain_limit)
    limit = choose(limited, settings.gain_limit, 1.0) / choose(limited, length, 1.0)
    return W, choose(limited, minimum(limit, gain), gain)


def displacement(
    state: FilterState, sample: Sample, W: Correction, used: Array, h: Array, moving: Array | None
) -> tuple[Vec3, Vec3]:
    """How a sub-step moves the estimate, [rad] and [m] in the body frame.

    Args:
        state: estimate.
        sample: measurements.
        W: correction.
        used: gain K [1/s] after the limit.
        h: length of the sub-step [s].
        moving: time [s] for which the measured velocity acts; None if it does not act.
    """
    omega, v = scale(used * h, W.angular), scale(used * h, W.linear)
    if moving is not None:
        omega = add(omega, scale(moving, subtract(sample.angular_velocity, state.bias_angular)))
        v = add(v, scale(moving, subtract(sample.velocity, state.bias_linear)))
    return omega, v


def learnt_biases(
    state: FilterState,
    sample: Sample,
    W: Correction,
    used: Array,
    h: Array,
    settings: FilterSettings,
    share: Array | None = None,
) -> tuple[Vec3, Vec3]:
    """Estimates of the velocities' biases [rad/s] and [m/s] after a sub-step of h [s].

    `share` is a factor on both gammas.
    """
    gamma_angular, gamma_linear = bias_gains(used, sample, settings)
    h = h if share is None else share * h
    angular = add(state.bias_angular, scale(h, scale(-gamma_angular, W.bias_angular)))
    linear = add(state.bias_linear, scale(h, scale(-gamma_linear, W.bias_linear)))
    return (
        bounded(angular, settings.per_angular_bias_bound),
        bounded(linear, settings.per_linear_bias_bound),
    )


def bounded(c: Vec3, per_bound: Array | None) -> Vec3:
    """A vector, shortened to its bound if it is longer; `per_bound` is 1 / bound^2.

    One Newton step, without square root or division: with x = |c| / bound, the new length is
    x (3 - x^2) / 2 <= 1 times the bound.
    """
    if per_bound is None:
        return c
    excess = per_bound * dot(c, c)
    return scale(choose(excess > 1, maximum(1.5 - 0.5 * excess, 0.0), 1.0), c)


def observe(
    state: FilterState,
    sample: Sample,
    seen: Seen,
    gains: Gains,
    settings: FilterSettings,
    share: Array | None = None,
    believed: Sequence[Array] = (),
) -> tuple[FilterState, Array]:
    """One sample, by components: n sub-steps with the measurement held (pure).

    Correction and bias law act for dt/n in each sub-step. The measured velocity acts for the whole
    dt in the last one: moved earlier, the estimate would be compared with a measurement of another
    time, which biases it (1.1 cm with n = 2 on the paper's scenario). The vectors' biases take one
    step of dt.

    Args:
        state: estimate at the sample.
        sample: measurements at the sample.
        seen: from `see`.
        gains: K [1/s], of the batch shape, and the factors on the gains of the bias laws.
        settings: laws, sub-steps, gains, gain limit.
        share: Factor on the gains of all bias laws (`bias_share`).
        believed: By how much each vector is believed less, at least 1; () if all are believed.

    Returns:
        The estimate at the next sample, and the mean gain used in the sub-steps after the limit.
    """
    n, dt = settings.substeps, sample.time_step
    h = dt / n
    # An invalid gain, negative or NaN, makes the estimate NaN, so that it cannot go unnoticed.
    gain = choose(gains.gain >= 0, gains.gain, jnp.nan)
    used_total = jnp.zeros_like(gain)
    before = state
    for j in range(n):
        W, used = limited_correction(state, sample, seen, gain, h, settings)
        used_total = used_total + used
        omega, v = displacement(state, sample, W, used, h, dt if j == n - 1 else None)
        attitude, place = move(state.attitude, state.place, omega, v)
        bias_angular, bias_linear = learnt_biases(state, sample, W, used, h, settings, share)
        state = state._replace(
            attitude=attitude, place=place, bias_angular=bias_angular, bias_linear=bias_linear
        )
    used = used_total / n
    vector_biases, turning = learnt_vector_biases(
        before, sample, seen, gains.learning, used, settings, share, believed
    )
    return state._replace(vector_biases=vector_biases, turning=turning), used


def bias_share(
    memory: SignalMemory, settings: FilterSettings, signal: SignalSettings
) -> Array | None:
    """The factor on the gains of all bias laws, 1 / (1 + (z / w)^4).

    z is the error signal of this sample, neither smoothed nor scaled.
    """
    if settings.per_bias_wait is None:
        return None
    z = memory.attitude + signal.position_weight * memory.position
    x = settings.per_bias_wait * z * z
    return 1 / (1 + x * x)


def learning_time(sample: Sample, used: Array, share: Array | None) -> Array:
    """K dt of a sample, times the factor on the gains of all bias laws, no unit."""
    passed = used * sample.time_step
    return passed if share is None else share * passed


def learnt_vector_biases(
    state: FilterState,
    sample: Sample,
    seen: Seen,
    learning: Array | float,
    used: Array,
    settings: FilterSettings,
    share: Array | None = None,
    believed: Sequence[Array] = (),
) -> tuple[tuple[Vec3, ...], Vec3 | tuple[()]]:
    """Estimates c_i after a step of the vectors' bias law, and the low-passed angular velocity.

    `learning` and `share` are factors on its gain, and those in `believed` divide that of each
    vector.
    """
    law, turning = settings.vector_bias, state.turning
    if law is None or isinstance(sample.vectors, Wahba) or not turning:
        return state.vector_biases, turning
    dt, R = sample.time_step, rows(state.attitude)
    new = dt / (law.excitation_time + dt)
    turning = add(turning, scale(new, subtract(sample.angular_velocity, turning)))
    w = subtract(turning, state.bias_angular)
    w2 = dot(w, w)
    gain = law.gain * _following(law.law, used)
    gain = gain if share is None else share * gain
    step = minimum(learning * dt * gain * minimum(law.per_turning * w2 * w2, 1.0), 1.0)
    kept = 1 - dt * law.leak
    biases = []
    steps = tuple(step / by for by in believed) or (step,) * len(seen.freed)
    sensors = zip(state.vector_biases, seen.freed, sample.vectors.each, steps, strict=True)
    for c, d, vector, step in sensors:
        residual = subtract(d, unrotate(R, vector.known))
        # While a vector is missing its bias estimate neither changes nor decays.
        measured = vector.factor > 0
        now = choose(measured, step, jnp.zeros_like(step))
        c = add(scale(choose(measured, kept, 1.0), c), scale(now, residual))
        biases.append(bounded(c, law.per_bound))
    return tuple(biases), turning


class ObserverState(NamedTuple):
    """State of the observer between two samples."""

    estimate: FilterState
    """The estimate at the next sample."""
    memory: SignalMemory
    """Memory of the error signal and the schedule."""
    beliefs: BeliefMemory = BeliefMemory()
    """Memory of belief in each sensor."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Observer:
    """The observer with its gain schedule: the paper's filter (`filters.base.Filter`)."""

    schedule: GainSchedule | ObserverGains | None
    """Sets the gain K at each sample, with or without belief; None until a search has chosen it."""
    settings: FilterSettings = field(default_factory=FilterSettings)
    """Settings of a step."""
    signal: SignalSettings = field(default_factory=SignalSettings)
    """Settings of the error signal, the input of the schedule."""
    belief: BeliefSettings | None = None
    """How it judges its sensors; None if it believes all of them."""

    @property
    def elementwise(self) -> bool:
        """Whether its step works on components of any shape, as all do but users' schedules."""
        given = self.schedule
        return all_elementwise(given if isinstance(given, ObserverGains) else (given,))

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same with some numbers replaced, by their keys in a configuration without `filter.`.

        A number of the schedule goes by the name of its field.

        Raises:
            ArgumentError: The observer has no number with this key.
        """
        settings, signal, schedule = self.settings, self.signal, self.schedule
        belief = self.belief
        for key, value in values.items():
            if belief is not None and key in ("vector", "landmark"):
                belief = belief._replace(**{key: value})
            elif belief is not None and key.startswith("belief_"):
                belief = belief._replace(signal=belief.signal.with_value(key, value))
            elif is_dataclass(schedule) and key in (each.name for each in fields(schedule)):
                schedule = replace(cast(Any, schedule), **{key: value})
            else:
                settings, signal = _with_value(settings, signal, key, value)
        return replace(self, schedule=schedule, settings=settings, signal=signal, belief=belief)

    def prepare(self, measurements: Measurements) -> Sample:
        """Landmarks, and vectors normalised, crossed and summed as the settings say.

        Raises:
            ArgumentError: A gamma is not one number, `each_agent` is False though vector biases are
                estimated, or the settings have weights of another number of sensors.
        """
        settings = self.settings
        for name in ("gamma_angular", "gamma_linear"):
            if shape := np.shape(getattr(settings, name)):
                refuse(f"settings.{name}: of the shape {shape}", "one number")
        for needs, why in (
            (settings.vector_bias, "vector_bias is estimated"),
            (self.belief, "there is belief"),
        ):
            if needs is not None and not settings.vectors.each_agent:
                refuse("settings.vectors.each_agent: False", f"True where {why}")
        for name, weights, factors in (
            ("vectors.weights", settings.vectors.weights, measurements.vector_weights),
            ("landmark_weights", settings.landmark_weights, measurements.landmark_weights),
        ):
            count = np.shape(factors)[-1]
            if weights is not None and len(weights) != count:
                refuse(f"settings.{name}: {len(weights)} of them", f"{count}, as measured, or None")
        return prepare(measurements, settings.vectors)

    def start(self, initial: FilterState, sensors: Sensors) -> ObserverState:
        """The state before the first sample; the schedule starts at its initial gain.

        Raises:
            ArgumentError: `initial` has biases of another number of vectors, the schedule is
                missing, its initial gain is negative, or it has belief and the observer has not.
        """
        gain, *beliefs = self._chosen
        check_schedule(gain)
        if any(beliefs) and self.belief is None:
            refuse("belief: None", "BeliefSettings, as the schedule has belief")
        if self.settings.vector_bias is not None and sensors.vectors:
            initial = with_vector_biases(initial, sensors.vectors)
            if not initial.turning:
                zero = jnp.zeros_like(initial.place[0])
                initial = initial._replace(turning=(zero, zero, zero))
        like = initial.place[0]
        memory = initial_memory(gain, like, self.signal.unknown)
        return ObserverState(initial, memory, initial_beliefs(beliefs, sensors, like))

    def ready(self) -> Self:
        """The observer for `step`, its schedules prepared (slopes and overlaps of the terms)."""
        return replace(self, schedule=ObserverGains(*prepared(self._chosen)))

    def step(self, state: ObserverState, now: Samples) -> tuple[ObserverState, Record]:
        """One sample: belief, error signal, gains, and the step of pose and biases."""
        gain, *of_beliefs = cast(Sequence[Any], self._chosen)
        beliefs, believed = state.beliefs, ()
        if self.belief is not None and any(of_beliefs):
            vector, landmark = self.belief.vector, self.belief.landmark
            each = residuals(state.estimate, None, now.sample, vector, landmark)
            factors, beliefs = belief_factors(
                *(of_beliefs, self.belief.signal, beliefs, each),
                *(now.time, now.sample.time_step),
            )
            factors = over_the_least(factors, now.sample, self.belief.signal.largest)
            now = now._replace(sample=as_believed(now.sample, factors))
            believed = factors.vectors or ()
        seen = see(state.estimate, now.sample, self.settings)
        if self.signal.signal == "pose":
            errors = Measured(*pose_errors(state.estimate, now.truth), True, True)
        else:
            errors = measured_errors(state.estimate, now.sample, seen)
        gains, inputs, memory = scheduled_gain(
            gain, state.memory, errors, now.time, now.sample.time_step, self.signal
        )
        share = bias_share(memory, self.settings, self.signal)
        estimate, used = observe(
            state.estimate, now.sample, seen, gains, self.settings, share, believed
        )
        memory = still_unknown(memory, seen, learning_time(now.sample, used, share), self.signal)
        return ObserverState(estimate, memory, beliefs), Record(
            gain=gains.gain, gain_used=used, error=inputs.error, rate=inputs.rate
        )

    def estimate(self, state: ObserverState) -> FilterState:
        """Pose and biases."""
        return state.estimate

    @property
    def _chosen(self) -> ObserverGains:
        if self.schedule is None:
            raise ArgumentError("schedule: None; allowed: a gain schedule, to run the observer")
        if isinstance(self.schedule, ObserverGains):
            return self.schedule
        return ObserverGains(self.schedule)


def _with_value(
    settings: FilterSettings, signal: SignalSettings, key: str, value: Array
) -> tuple[FilterSettings, SignalSettings]:
    """Settings with the number of one key of the configuration replaced."""
    match key.split("."):
        case ["gain", "position_weight" | "smoothing" | "error_scale" | "rate_scale" as name]:
            return settings, replace(signal, **{name: value})
        case ["gain", name] if signal.unknown is not None and name in _OF_UNKNOWN:
            unknown = replace(signal.unknown, **{_OF_UNKNOWN[name]: value})
            return settings, replace(signal, unknown=unknown)
        case ["bias_wait"]:
            return replace(settings, per_bias_wait=1 / value**2), signal
        case ["length" | "length_growth" | "gain_limit" as name]:
            return replace(settings, **{name: value}), signal
        case ["gamma"]:
            return replace(settings, gamma_angular=value, gamma_linear=value), signal
        case ["gamma", "0"]:
            return replace(settings, gamma_angular=value), signal
        case ["gamma", "1"]:
            return replace(settings, gamma_linear=value), signal
        case ["bias_bound", "0"]:
            return replace(settings, per_angular_bias_bound=1 / value**2), signal
        case ["bias_bound", "1"]:
            return replace(settings, per_linear_bias_bound=1 / value**2), signal
        case ["cross_vector_weight"]:
            return replace(settings, vectors=replace(settings.vectors, cross_weight=value)), signal
        case ["scenario", "vectors", index, "weight"]:
            weights = _with_weight(key, settings.vectors.weights, index, value)
            return replace(settings, vectors=replace(settings.vectors, weights=weights)), signal
        case ["scenario", "landmarks", index, "weight"]:
            weights = _with_weight(key, settings.landmark_weights, index, value)
            return replace(settings, landmark_weights=weights), signal
        case [name] if settings.vector_bias is not None and name in _OF_VECTOR_BIAS:
            number, made = _OF_VECTOR_BIAS[name]
            learning = replace(settings.vector_bias, **{number: made(value)})
            return replace(settings, vector_bias=learning), signal
    refuse(
        f"{key}: not a number of this filter",
        "a key of [filter] without `filter.`, or of [gain], that can be tuned, or a weight",
    )


_OF_UNKNOWN = {"unknown": "start", "unknown_fall": "fall", "unknown_rise": "rise"}
"""For each key of [gain]: the field of `Unknown` that it sets."""
_OF_VECTOR_BIAS: dict[str, tuple[str, Callable[[Array], Array]]] = {
    "vector_bias_gain": ("gain", lambda gain: gain),
    "vector_bias_leak": ("leak", lambda leak: leak),
    "vector_bias_bound": ("per_bound", lambda bound: 1 / bound**2),
    "excitation": ("per_turning", lambda turning: 1 / turning**4),
    "excitation_time": ("excitation_time", lambda time: time),
}
"""For each key of [filter]: the field of `VectorBias` that it sets, and the conversion to it."""


def _with_weight(
    key: str, weights: tuple[Array, ...] | None, index: str, value: Array
) -> tuple[Array, ...] | None:
    count = len(weights or ())
    if weights is None or not (index.isdecimal() and int(index) < count):
        refuse(f"{key}: the settings have {count} such weights", "one that they have")
    return tuple(value if i == int(index) else weight for i, weight in enumerate(weights))
