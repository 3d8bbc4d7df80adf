"""[family]: what differs from scenario to scenario, besides the noise."""

from typing import Annotated, Literal

from pydantic import Field

from posegsa.settings.fields import (
    MAX_NUMBER,
    Ascending,
    Flag,
    NonNegative,
    Positive,
    Section,
)

Angle = Annotated[float, Field(strict=True, ge=0, le=180)]
Angles = Annotated[tuple[Angle, Angle], Ascending]
Range = Annotated[tuple[NonNegative, NonNegative], Ascending]
"""Minimum and maximum; drawn uniformly between them."""
Rate = Annotated[float, Field(strict=True, ge=0, le=1)]
Turn = Annotated[float, Field(strict=True, ge=0.1, le=MAX_NUMBER)]
Off = Literal["off"]


class Occasions(Section):
    """Events that recur in each scenario."""

    rate: Rate = 0.05
    """Rate at which events start while none is active [1/s], at most once a second."""
    duration: Range = (1.0, 5.0)
    """Duration of an event [s], minimum and maximum."""


class Outages(Occasions):
    """Times without measurements."""

    sensors: Literal["all", "vectors", "landmarks"] = "all"
    """Which measurements are missing."""


class BurstsConfig(Occasions):
    """Times during which sensors are disturbed by a constant in a random direction of the body."""

    size: NonNegative | Range = 0.5
    """Length of the disturbance, in the sensor's unit; a range is its minimum and maximum."""
    each: Flag = False
    """Whether each sensor has bursts of its own; else each burst disturbs one sensor, at random."""


class NoiseJumpsConfig(Section):
    """A factor on the noise of each sensor: 1 at the start, then one that jumps."""

    rate: Rate = 0.05
    """Rate of the jumps of each sensor's factor [1/s], at most once a second."""
    factor: Annotated[tuple[Positive, Positive], Ascending] = (0.5, 4.0)
    """Minimum and maximum of the factor, drawn log-uniformly, no unit."""


class InTurn(Section):
    """Landmarks that are in sight one at a time: the first, the second, ..., the first again."""

    duration: Annotated[tuple[Turn, Turn], Ascending] = (1.0, 3.0)
    """Time that a landmark is in sight [s], minimum and maximum."""
    begin: NonNegative = 0.0
    """Time at which the first landmark comes into sight [s]."""


class JumpsConfig(Section):
    """Displacements of the body between two samples, which the velocities do not measure."""

    rate: Rate = 0.01
    """Rate of the jumps [1/s], at most once a second."""
    angle: Angles = (0.0, 90.0)
    """Angle about a random axis [deg], minimum and maximum."""
    distance: Range = (0.0, 3.0)
    """Distance in a random direction [m], minimum and maximum."""


class FamilyConfig(Section):
    """[family]: the distribution of scenarios; by default any start and random phases.

    Training and held-out scenarios are drawn from the same family with other keys.
    """

    attitude_error: Angles | Off = (0.0, 180.0)
    """Angle of the initial attitude error about a random axis [deg], minimum and maximum; "off"
    starts every scenario from scenario.initial_rotation_estimate."""
    position_error: Range | Off = (0.0, 10.0)
    """Length of the initial position error P_est - R_err P in a random direction [m], minimum and
    maximum; "off" starts every scenario from scenario.initial_position_estimate."""
    bias_scale: Range | Off = "off"
    """Factor on the biases of both velocities, also on the drawn biases below, no unit, minimum and
    maximum."""
    noise_scale: Range | Off = "off"
    """Factor on the noise of all sensors, no unit, minimum and maximum."""
    landmark_spread: NonNegative = 0.0
    """Maximum shift of each coordinate of each landmark, drawn uniformly, inertial frame [m]."""
    motion_scale: Range | Off = "off"
    """Factor on the amplitudes of both velocities' sines, no unit, minimum and maximum."""
    angular_velocity_bias: NonNegative | Off = "off"
    """Standard deviation of each component of the angular velocity's bias, body frame [rad/s]; its
    mean is 0, and it replaces the bias of the scenario."""
    velocity_bias: NonNegative | Off = "off"
    """The same for the linear velocity [m/s]."""
    vector_bias: NonNegative | Off = "off"
    """Standard deviation of each component of the vectors' biases, in their unit; they replace the
    biases of the scenario."""
    landmark_bias: NonNegative | Off = "off"
    """The same for the landmarks [m]."""
    angular_velocity_drift: Range | Off = "off"
    """Intensity of the random walk of the angular velocity's bias [rad/s/sqrt(s)]."""
    velocity_drift: Range | Off = "off"
    """Intensity of the random walk of the linear velocity's bias [m/s/sqrt(s)]."""
    outages: Outages | Off = "off"
    """Times without measurements of vectors, landmarks or both."""
    bursts: BurstsConfig | Off = "off"
    """Times during which vectors are disturbed."""
    landmark_bursts: BurstsConfig | Off = "off"
    """The same for landmarks [m]."""
    noise_jumps: NoiseJumpsConfig | Off = "off"
    """Jumps of the noise of each vector, each landmark and both velocities."""
    landmarks_in_turn: InTurn | Off = "off"
    """Landmarks that are in sight one at a time."""
    jumps: JumpsConfig | Off = "off"
    """Jumps of the body between two samples."""
    landmark_interval: Range | Off = "off"
    """Time from one measurement of the landmarks to the next [s]."""
    rest: Range | Off = "off"
    """Time at rest at the start [s], in scenarios that start at rest."""
    rest_share: Annotated[float, Field(strict=True, ge=0, le=1)] = 1.0
    """Share of the scenarios that start at rest, no unit."""
    duration: Range | Off = "off"
    """Time after which a scenario no longer counts [s]."""
    random_phase: Flag = True
    """Whether the phase of each sine of both velocities is drawn uniformly for each scenario."""
