"""The filter: the observer, one of two Kalman filters, or a user's own."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Annotated, Literal, NamedTuple

from pydantic import ConfigDict, Field

from posegsa.config.schedule_config import DEFAULT_ALSO
from posegsa.config.tunable import AlsoTuned
from posegsa.filters.attitude import Interval
from posegsa.filters.belief import BeliefInput
from posegsa.filters.covariance import Reset
from posegsa.filters.observer import GainLaw, LandmarkUnit, Law
from posegsa.model.schedules import SCHEDULES
from posegsa.settings.choice import Choice
from posegsa.settings.fields import Flag, NonNegative, Number, Positive, Section, Tunable
from posegsa.settings.violations import Violation
from posegsa.words import toml

ScheduleKind = Literal["fuzzy", "constant", "smooth"]
"""What sets the observer's gain."""

NoiseScheduleKind = Literal["off", "fuzzy", "constant", "smooth", "ramp", "switch", "clock"]
"""The schedule that changes a noise of the Kalman filter, or a weight of the observer: none; the
controller of k1..k22; a constant; a smooth or a straight function of the error; or two constants or
a curve over the time since the start."""
_WHICH = Field(
    description='Which filter: "observer", "kalman", "imu", or "own", one that the user passes.'
)
AboveOne = Annotated[float, Field(strict=True, gt=1, allow_inf_nan=False)]

SCHEDULE_NUMBERS: Mapping[str, Mapping[str, int]] = {
    **{kind: {one.name: 1 for one in fields(made)} for kind, made in SCHEDULES.items()},
    "fuzzy": {"k": 22},
    "clock": {"log_gain": 16},
}
"""How many numbers each kind of schedule has, by name, of an observer or a Kalman filter."""

_OF_VECTOR_BIAS = Tunable("vector_bias", "estimated")
_OF_UNKNOWN, _OF_BELIEF = Tunable("unknown"), Tunable("belief")


class ObserverConfig(Section):
    """[filter]: the paper's nonlinear observer, its gain set by a schedule."""

    kind: Annotated[Literal["observer"], _WHICH] = "observer"
    schedule: ScheduleKind = "fuzzy"
    """What sets the gain K: "fuzzy", the controller of k1..k22; "constant", one gain; "smooth", a
    gain K(e) = low + (high - low) e^2 / (e^2 + half^2)."""

    law: Law = "gradient"
    """Innovation and bias law: "gradient", for which the Lyapunov argument holds, or "printed" as
    in the paper, which can diverge."""
    gamma: Annotated[NonNegative | tuple[NonNegative, NonNegative], Tunable()] = 2.5
    """Gain of the bias law [1/s^2]: one for both biases, or one for b_Omega and one for b_V."""
    substeps: Annotated[int, Field(strict=True, ge=1, le=64)] = 2
    """Number of inner steps per sample, with the measurement held."""
    gamma_law: GainLaw = "quadratic"
    """How gamma depends on the gain K after its limit: constant, or proportional to K or K^2.
    `gamma` is its value at K = 10/s."""
    bias_bound: Annotated[tuple[Positive, Positive] | Literal["off"], Tunable()] = "off"
    """Maximum lengths of the estimated biases of angular and linear velocity [rad/s, m/s], such as
    from data sheets, or "off" for none. They keep the estimate from diverging if measurements
    stop before it has converged; an estimate far beyond its bound is reset to 0."""
    length: Annotated[Positive, Tunable("law", "gradient")] = 1.0
    """Unit of length [m], which weighs attitude against position in the gain. About the distance of
    the landmarks from the origin lets both converge equally fast."""
    length_growth: Annotated[NonNegative | Literal["off"], Tunable("law", "gradient")] = "off"
    """By how much the square of the unit of length grows with the square of the distance from the
    body to the farthest landmark, no unit; "off" means not at all."""
    landmark_unit: LandmarkUnit = "metre"
    """What the weight of a landmark is per square of: a "metre", or the unit of "length". With the
    latter and `length_growth` the same gains suit landmarks at any distance."""
    bias_wait: Annotated[Positive | Literal["off"], Tunable()] = "off"
    """The error signal, before it is smoothed and scaled, at which the gains of all bias laws are
    half; above it they vanish with the fourth power. While the pose is far off, they would take its
    error for a bias. "off" means that they do not depend on it."""
    gain_limit: Annotated[Positive | Literal["off"], Tunable()] = 1.5
    """Maximum step of the innovation, K L dt / substeps with L the curvature of its cost, no unit;
    steps above 2 are unstable. "off" means no limit."""
    normalise_vectors: Flag = True
    """Whether all vectors, measured (less their estimated biases) and known, are normalised to
    length one."""
    cross_vector: Flag = True
    """Whether v_1 x v_2, of the first two vectors as measured, is used as a further vector."""
    cross_vector_weight: Annotated[NonNegative, Tunable("cross_vector", True)] = 0.5
    """Weight s^R of that vector, no unit."""
    vector_bias: Literal["off", "estimated"] = "estimated"
    """Whether the constant biases of the vectors are estimated."""
    vector_bias_gain: Annotated[NonNegative, _OF_VECTOR_BIAS] = 0.2
    """Gain gamma_c of their bias law [1/s]."""
    vector_bias_law: GainLaw = "linear"
    """How gamma_c depends on the gain K after its limit; vector_bias_gain is its value at K =
    10/s."""
    vector_bias_leak: Annotated[NonNegative, _OF_VECTOR_BIAS] = 0.0
    """Rate at which an estimate decays [1/s]."""
    vector_bias_bound: Annotated[Positive, _OF_VECTOR_BIAS] = 0.5
    """Maximum length of an estimated bias, in the vector's unit."""
    excitation: Annotated[Positive, _OF_VECTOR_BIAS] = 0.3
    """Angular velocity [rad/s] above which vector_bias_gain is used in full. Below it the gain
    falls with the fourth power, because at rest a bias is indistinguishable from an attitude
    error."""
    excitation_time: Annotated[NonNegative, _OF_VECTOR_BIAS] = 1.0
    """Time constant of the low-pass filter of that angular velocity [s]."""

    belief: NoiseScheduleKind = "off"
    """The schedule that divides the weight of each vector and each landmark, compared with the one
    of its kind that agrees best; its input is that sensor's normalised squared residual. There is
    one for the vectors and one for the landmarks;
    "fuzzy" has the paper's boxes and table, whatever those of the gain are."""
    vector: Annotated[Positive, _OF_BELIEF] = 0.1
    """Noise of each component of a vector, in its unit: it normalises the residuals of belief."""
    landmark: Annotated[Positive, _OF_BELIEF] = 0.1
    """Noise of each coordinate of a landmark [m]: it normalises the residuals of belief."""
    belief_smoothing: Annotated[NonNegative, _OF_BELIEF] = 0.1
    """Time constant of the low-pass filter of that residual [s]."""
    belief_scale: Annotated[AboveOne, _OF_BELIEF] = 1e6
    """The input before scaling at which the schedule's input is 1, no unit; it is logarithmic."""
    belief_rate_scale: Annotated[NonNegative, _OF_BELIEF] = 0.1
    """Factor on the change of the schedule's input [s]."""
    belief_largest: Annotated[AboveOne, _OF_BELIEF] = 1e6
    """Largest divisor of a weight, no unit; the divisor is logarithmic in the output."""

    @property
    def roles(self) -> dict[str, NoiseScheduleKind]:
        """The kinds of the schedules of belief, by the role of each (`ObserverGains`)."""
        return {} if self.belief == "off" else dict.fromkeys(("vectors", "landmarks"), self.belief)

    def _conflicts(self) -> Iterator[Violation]:
        for name, needed in (("length", 1.0), ("length_growth", "off")):
            if self.law == "printed" and getattr(self, name) != needed:
                reason = f'allowed: {toml(needed)}, because law = "printed"'
                yield Violation(name, reason, getattr(self, name))


Scales = Annotated[tuple[Positive, ...], Field(max_length=64)]


class KalmanConfig(Section):
    """[filter]: the invariant extended Kalman filter.

    The numbers are the noises that it assumes of its sensors and its start: standard deviations,
    and densities of white noise. A noise of standard deviation s in each sample of length dt has
    the density s sqrt(dt). By default they are those of the default scenario's sensors.
    """

    kind: Annotated[Literal["kalman"], _WHICH] = "kalman"
    vector_bias: Literal["off", "estimated"] = "estimated"
    """Whether the constant biases of the vectors are estimated, as states."""
    angular_velocity: Annotated[Positive, Tunable()] = 0.02
    """Density of the angular velocity's noise [rad/sqrt(s)]."""
    velocity: Annotated[Positive, Tunable()] = 0.01
    """Density of the velocity's noise [m/sqrt(s)]."""
    angular_walk: Annotated[Positive, Tunable()] = 0.0001
    """Random walk of the angular velocity's bias [rad/s/sqrt(s)]."""
    linear_walk: Annotated[Positive, Tunable()] = 0.0001
    """Random walk of the velocity's bias [m/s/sqrt(s)]."""
    vector_walk: Annotated[Positive, _OF_VECTOR_BIAS] = 0.0001
    """Random walk of the vectors' biases, in their unit [1/sqrt(s)]."""
    vector: Annotated[Positive, Tunable()] = 0.1
    """Noise of each component of a vector, in its unit."""
    landmark: Annotated[Positive, Tunable()] = 0.1
    """Noise of each coordinate of a landmark [m]."""
    vector_scales: Scales = ()
    """Noise of each vector, in order, as a multiple of `vector`; 1 for those not listed."""
    landmark_scales: Scales = ()
    """The same for landmarks, as a multiple of `landmark`."""
    initial_attitude: Annotated[Positive, Tunable()] = 1.0
    """Initial attitude error about each axis [rad]."""
    initial_position: Annotated[Positive, Tunable()] = 3.0
    """Initial position error along each axis [m]."""
    initial_angular_bias: Annotated[Positive, Tunable()] = 0.1
    """Initial error of each component of the angular velocity's bias [rad/s]."""
    initial_linear_bias: Annotated[Positive, Tunable()] = 0.3
    """Initial error of each component of the velocity's bias [m/s]."""
    initial_vector_bias: Annotated[Positive, _OF_VECTOR_BIAS] = 0.1
    """Initial error of each component of the vectors' biases, in their unit."""
    angular_lead: Annotated[float, Field(strict=True, ge=0, le=100), Tunable()] = 0.0
    """By how many time steps the angular velocity is extrapolated: 0 if it is the mean over the
    step after its time stamp, 0.5 if it was measured at the stamp, 1 if it is the mean over the
    step before; a delay of L seconds adds L over the time step."""
    linear_lead: Annotated[float, Field(strict=True, ge=0, le=100), Tunable()] = 0.0
    """The same for the linear velocity."""
    noise_adaptation: Annotated[Positive | Literal["off"], Tunable()] = "off"
    """Memory with which the noise of each sensor is estimated from how far its successive samples
    differ, in its samples, such as 100; "off" leaves the noises as stated."""
    iterations: Annotated[int, Field(strict=True, ge=1, le=10)] = 1
    """How many times the measurements of a sample are linearised at most, each time at the new
    estimate, until its attitude hardly changes. With 10 a wrong start does little harm where the
    sensors of a sample show the pose."""
    reset: Reset = "off"
    """How the covariance is carried to the coordinates of the new estimate after an update: "off"
    leaves it as it is; with "two frames" the right error of pose and biases as one group keeps its
    covariance, which is better after a wrong start with one linearisation and noises that are
    not tuned for it."""

    unknown: NoiseScheduleKind = "off"
    """The schedule that multiplies the densities of the velocities' noise and the walk of the
    vectors' biases. Its input is the filter's measured error: the residuals in standard deviations
    of the sensors' noise."""
    unknown_smoothing: Annotated[NonNegative, _OF_UNKNOWN] = 0.02
    """Time constant of the low-pass filter of that error [s]."""
    unknown_scale: Annotated[AboveOne, _OF_UNKNOWN] = 100.0
    """The error at which the schedule's input is 1, no unit; the input is logarithmic."""
    unknown_rate_scale: Annotated[NonNegative, _OF_UNKNOWN] = 0.1
    """Factor on the change of the schedule's input [s]."""
    unknown_largest: Annotated[AboveOne, _OF_UNKNOWN] = 1000.0
    """Largest factor on the densities, no unit; the factor is logarithmic in the output."""
    belief: NoiseScheduleKind = "off"
    """The schedule that multiplies the variance of each vector and each landmark; its input is that
    sensor's normalised squared residual. There is one for the vectors and one for the landmarks."""
    belief_input: BeliefInput = "residual"
    """The input of that schedule: the normalised squared "residual"; the "variance" that it
    implies, as a multiple of the sensor's own variance (the estimate of Sage and Husa), both
    low-passed; or the normalised square of the residual's low-passed "mean", which shows a sensor
    that is off by a constant long before single residuals do."""
    belief_smoothing: Annotated[NonNegative, _OF_BELIEF] = 0.1
    """Time constant of that low-pass filter [s]."""
    belief_scale: Annotated[AboveOne, _OF_BELIEF] = 1e6
    """The input before scaling at which the schedule's input is 1, no unit; it is logarithmic."""
    belief_rate_scale: Annotated[NonNegative, _OF_BELIEF] = 0.1
    """Factor on the change of the schedule's input [s]."""
    belief_largest: Annotated[AboveOne, _OF_BELIEF] = 1e6
    """Largest factor on a variance, no unit; the factor is logarithmic in the output."""

    @property
    def roles(self) -> dict[str, NoiseScheduleKind]:
        """The kinds of the schedules that are on, by the role of each (`NoiseGains`)."""
        kinds: dict[str, NoiseScheduleKind] = {
            "unknown": self.unknown,
            "vectors": self.belief,
            "landmarks": self.belief,
        }
        return {role: kind for role, kind in kinds.items() if kind != "off"}


class AttitudeConfig(Section):
    """[filter]: the attitude filter for gyroscope, accelerometer and magnetometer.

    It reads recordings of inertial sensors, not drawn scenarios (`posegsa.filters.attitude`).
    """

    kind: Annotated[Literal["imu"], _WHICH] = "imu"
    gyroscope_interval: Interval = "before"
    """Whether an angular velocity is the mean over the interval before its time stamp, since the
    last sample, or after it, until the next sample."""
    velocity: Annotated[Positive, Tunable()] = 0.098
    """Noise density of "the velocity is 0", from which the inclination follows [m/s sqrt(s)]."""
    angular_velocity: Annotated[Positive, Tunable()] = 0.0011
    """Density of the gyroscope's noise [rad/sqrt(s)]."""
    turning: Annotated[NonNegative, Tunable()] = 0.001
    """Additional gyroscope noise, in proportion to the angular velocity [sqrt(s)]."""
    turning_heading: Annotated[NonNegative, Tunable()] = 0.0017
    """Additional noise of the heading alone, in proportion to the angular velocity [sqrt(s)]."""
    angular_walk: Annotated[Positive, Tunable()] = 0.00012
    """Random walk of the gyroscope's bias [rad/s/sqrt(s)]."""
    heading: Annotated[Positive, Tunable()] = 0.058
    """Noise density of the field's heading [rad sqrt(s)]."""
    inclination_in_heading: Annotated[NonNegative, Tunable()] = 3.0
    """Share of the inclination's variance that makes the field's heading uncertain, no unit."""
    field_time: Annotated[NonNegative, Tunable()] = 0.42
    """Time constant of the field's mean in the almost inertial frame [s]."""
    field_tolerance: Annotated[Positive, Tunable()] = 0.062
    """Distance of the field from its mean, as a share of it, at which it is half believed."""
    field_memory: Annotated[Positive, Tunable()] = 3.6
    """Time over which its horizontal and vertical part are averaged, while the body turns [s]."""
    disbelieved: Annotated[Positive, Tunable()] = 0.042
    """Share of their normal rate at which the means follow a field that is not believed, no
    unit."""
    iron_time: Annotated[Positive, Tunable()] = 22.0
    """Time constant with which iron that turns with the body is learnt [s]."""
    magnetometer_delay: Annotated[NonNegative, Tunable()] = 0.011
    """Delay of the magnetometer behind the gyroscope [s]."""
    rest_bias: Annotated[Positive, Tunable()] = 0.0011
    """Noise density of the gyroscope at rest, as a measurement of its bias [rad/s sqrt(s)]."""
    initial_bias: Annotated[Positive, Tunable()] = 0.0038
    """Standard deviation of each component of the gyroscope's bias at the start [rad/s]."""
    outlier: Annotated[Positive, Tunable()] = 10.0
    """An acceleration or a field more than this many times as long as its reference is ignored."""


class OwnConfig(Section):
    """[filter]: a filter of the user's own, with its numbers by name.

    The class is passed by the caller (`tune(..., filter=MyFilter)`, `--filter module:MyFilter`). It
    is never imported because a file names it.
    """

    model_config = ConfigDict(extra="allow")

    kind: Annotated[Literal["own"], _WHICH] = "own"
    __pydantic_extra__: dict[str, Annotated[Number, Tunable()]] = Field(init=False)
    """The numbers; each can be tuned."""

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers by name."""
        return dict(self.__pydantic_extra__ or {})


KALMAN_ALSO = tuple(
    AlsoTuned(key=f"filter.{name}", lower=lower, upper=upper, scale="logarithmic")
    for name, lower, upper in (
        ("angular_velocity", 0.002, 5.0),
        ("velocity", 0.001, 2.0),
        ("angular_walk", 1e-5, 1.0),
        ("linear_walk", 1e-5, 1.0),
        ("vector_walk", 1e-6, 0.3),
        ("vector", 0.03, 3.0),
        ("landmark", 0.03, 3.0),
        ("initial_attitude", 0.003, 10.0),
        ("initial_position", 0.02, 50.0),
        ("initial_angular_bias", 0.003, 3.0),
        ("initial_linear_bias", 0.01, 5.0),
        ("initial_vector_bias", 0.001, 1.0),
    )
)
"""The noises of a Kalman filter, which are tuned by default."""
SIGNAL_ALSO = tuple(
    AlsoTuned(key=f"filter.{role}_smoothing", lower=0.005, upper=2.0, scale="logarithmic")
    for role in ("unknown", "belief")
)
"""The numbers that are tuned by default in addition to the noises if these are scheduled."""
BELIEF_ALSO = SIGNAL_ALSO[1:]
"""The number that is tuned by default in addition to an observer's own if it has belief."""
IMU_ALSO = tuple(
    AlsoTuned(key=f"filter.{name}", lower=lower, upper=upper, scale="logarithmic")
    for name, lower, upper in (
        ("velocity", 0.03, 1.0),
        ("angular_velocity", 0.0005, 0.02),
        ("turning_heading", 0.0003, 0.02),
        ("angular_walk", 1e-6, 0.001),
        ("heading", 0.02, 1.0),
        ("field_tolerance", 0.02, 0.5),
        ("iron_time", 5.0, 500.0),
        ("magnetometer_delay", 0.001, 0.05),
        ("initial_bias", 0.001, 0.05),
    )
)
"""The numbers of the attitude filter that are tuned by default."""


class FilterKind(NamedTuple):
    """A filter that [filter] can select."""

    section: type[Section]
    """Its section, with its kind as the default of `kind`."""
    title: str
    """What it is called in a sentence."""
    also: tuple[AlsoTuned, ...] = ()
    """The numbers that are tuned by default."""


FilterConfig = ObserverConfig | KalmanConfig | AttitudeConfig | OwnConfig
FILTERS: Mapping[str, FilterKind] = {
    "observer": FilterKind(ObserverConfig, "observer", DEFAULT_ALSO),
    "kalman": FilterKind(KalmanConfig, "Kalman filter", (*KALMAN_ALSO, *SIGNAL_ALSO)),
    "imu": FilterKind(AttitudeConfig, "filter for inertial sensors", IMU_ALSO),
    "own": FilterKind(OwnConfig, "filter of the user's own"),
}
"""The filters by kind."""
ONE_FILTER = Choice("kind", {kind: one.section for kind, one in FILTERS.items()})
"""The section of one of them."""
