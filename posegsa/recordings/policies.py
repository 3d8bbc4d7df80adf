"""Policies for missing samples."""

from typing import Literal

Policy = Literal["refuse", "keep", "hold", "interpolate"]
"""What to do about missing samples (`recordings.bridging`)."""
LONGEST_GAP = 1.0
"""Default of the longest time that is filled [s]."""
