"""[family]: what differs from scenario to scenario, beside the noise."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from posegsa.settings.fields import Flag, NonNegative, Section
from posegsa.settings.violations import Violation

Angle = Annotated[float, Field(strict=True, ge=0, le=180)]
Range = tuple[NonNegative, NonNegative]
"""Smallest and largest value; drawn uniformly between them."""
Off = Literal["off"]


class FamilyConfig(Section):
    """[family]: the distribution that scenarios are drawn from; by default only the noise differs.

    Training and held-out scenarios are drawn from the same family with other keys.
    """

    attitude_error: tuple[Angle, Angle] | Off = "off"
    """Angle of the initial attitude error about a random axis [deg], smallest and largest; "off"
    starts every scenario from scenario.initial_rotation_estimate."""
    position_error: Range | Off = "off"
    """Length of the initial position error P_est - R_err P in a random direction [m], smallest
    and largest; "off" starts every scenario from scenario.initial_position_estimate."""
    bias_scale: Range | Off = "off"
    """Factor on the biases of both velocities, no unit, smallest and largest."""
    noise_scale: Range | Off = "off"
    """Factor on the noise of all sensors, no unit, smallest and largest."""
    landmark_spread: NonNegative = 0.0
    """Each coordinate of each landmark is moved by up to this much, inertial frame [m]."""
    motion_scale: Range | Off = "off"
    """Factor on the amplitudes of both velocities' sines, no unit, smallest and largest."""
    random_phase: Flag = False
    """Whether the phase of each sine of both velocities is drawn anew, uniformly."""

    def _conflicts(self) -> Iterator[Violation]:
        for key in (
            "attitude_error",
            "position_error",
            "bias_scale",
            "noise_scale",
            "motion_scale",
        ):
            ends = getattr(self, key)
            if ends != "off" and ends[0] > ends[1]:
                yield Violation(
                    key, "allowed: a smallest value that is not above the largest", ends
                )
