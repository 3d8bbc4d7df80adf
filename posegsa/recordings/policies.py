"""What may be done where a recording does not go on."""

from typing import Literal

Policy = Literal["refuse", "hold", "interpolate"]
"""Nothing; the last velocities held; or velocities interpolated (`recordings.bridging`)."""
LONGEST_GAP = 1.0
"""Time up to which anything is bridged, unless another is given [s]."""
