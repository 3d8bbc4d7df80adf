"""[family]: what differs from scenario to scenario, beside the noise."""

from typing import Annotated, Literal

from pydantic import Field

from posegsa.settings.fields import Ascending, Flag, NonNegative, Section

Angle = Annotated[float, Field(strict=True, ge=0, le=180)]
Angles = Annotated[tuple[Angle, Angle], Ascending]
Range = Annotated[tuple[NonNegative, NonNegative], Ascending]
"""Minimum and maximum; drawn uniformly between them."""
Off = Literal["off"]


class FamilyConfig(Section):
    """[family]: the distribution that scenarios are drawn from; by default only the noise differs.

    Training and held-out scenarios are drawn from the same family with other keys.
    """

    attitude_error: Angles | Off = "off"
    """Angle of the initial attitude error about a random axis [deg], minimum and maximum; "off"
    starts every scenario from scenario.initial_rotation_estimate."""
    position_error: Range | Off = "off"
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
    random_phase: Flag = False
    """Whether the phase of each sine of both velocities is drawn anew, uniformly."""
