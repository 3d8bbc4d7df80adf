"""Policies for missing samples."""

from typing import Literal

Policy = Literal["refuse", "hold", "interpolate"]
"""Bridge nothing, hold the last velocities, or interpolate (`recordings.bridging`)."""
LONGEST_GAP = 1.0
"""Default of the longest time that is bridged [s]."""
