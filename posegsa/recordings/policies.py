"""Policies for missing samples."""

from typing import Literal

Policy = Literal["refuse", "hold", "interpolate"]
"""Bridge nothing, hold the last velocities, or interpolate (`recordings.bridging`)."""
