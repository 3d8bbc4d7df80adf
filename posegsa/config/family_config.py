"""[family]: what differs from scenario to scenario, besides the noise."""

from typing import Annotated, Literal

from pydantic import Field

from posegsa.settings.fields import Ascending, Flag, NonNegative, Section

Angle = Annotated[float, Field(strict=True, ge=0, le=180)]
Angles = Annotated[tuple[Angle, Angle], Ascending]
Range = Annotated[tuple[NonNegative, NonNegative], Ascending]
"""Minimum and maximum; drawn uniformly between them."""
Off = Literal["off"]


class Occasions(Section):
    """Events that recur in each scenario."""

    rate: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.05
    """How often one starts while none is going on [1/s], at most once a second."""
    duration: Range = (1.0, 5.0)
    """How long one lasts [s], minimum and maximum."""


class Outages(Occasions):
    """Times without measurements."""

    sensors: Literal["all", "vectors", "landmarks"] = "all"
    """Which measurements are missing."""


class BurstsConfig(Occasions):
    """Times during which one of the vectors is disturbed by a constant in a random direction."""

    size: NonNegative = 0.5
    """Length of the disturbance, in the vector's unit."""


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
    """Factor on the biases of both velocities, no unit, minimum and maximum."""
    noise_scale: Range | Off = "off"
    """Factor on the noise of all sensors, no unit, minimum and maximum."""
    landmark_spread: NonNegative = 0.0
    """Each coordinate of each landmark is moved by up to this much, inertial frame [m]."""
    motion_scale: Range | Off = "off"
    """Factor on the amplitudes of both velocities' sines, no unit, minimum and maximum."""
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
    """Times during which one of the vectors is disturbed."""
    landmark_interval: Range | Off = "off"
    """Time from one measurement of the landmarks to the next [s]."""
    rest: Range | Off = "off"
    """Time at rest at the start [s], in scenarios that start at rest."""
    rest_share: Annotated[float, Field(strict=True, ge=0, le=1)] = 1.0
    """Share of the scenarios that start at rest, no unit."""
    duration: Range | Off = "off"
    """Time after which a scenario no longer counts [s]."""
    random_phase: Flag = True
    """Whether the phase of each sine of both velocities is drawn anew, uniformly."""
