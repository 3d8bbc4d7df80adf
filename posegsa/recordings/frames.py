"""The supported inertial frames, and gravity."""

from typing import Literal

from posegsa.errors import RecordingError

Frame = Literal["ENU", "NED", "NWU"]
"""The axes x, y, z of the inertial frame: east, north, up; north, east, down; north, west, up.
North is magnetic north."""

UP: dict[Frame, tuple[float, float, float]] = {
    "ENU": (0, 0, 1),
    "NED": (0, 0, -1),
    "NWU": (0, 0, 1),
}
"""The direction up in each frame."""
NORTH: dict[Frame, tuple[float, float, float]] = {
    "ENU": (0, 1, 0),
    "NED": (1, 0, 0),
    "NWU": (1, 0, 0),
}
"""The direction of magnetic north in each frame."""

GRAVITY = 9.81
"""Length of the specific force at rest [m/s^2]."""


def check_frame(frame: object) -> None:
    """Raise a RecordingError unless this is one of the inertial frames."""
    if frame not in tuple(UP):
        raise RecordingError(f"frame = {frame!r}; allowed: {', '.join(UP)}")
