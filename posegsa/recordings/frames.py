"""The supported inertial frames, and gravity."""

from collections.abc import Collection
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


def known_frame(frame: object) -> Frame | None:
    """The inertial frame of this name, in capitals or not; None if there is none."""
    return next((one for one in UP if isinstance(frame, str) and frame.upper() == one), None)


def checked_frame(frame: object) -> Frame:
    """The inertial frame of this name, in capitals or not; a RecordingError if there is none."""
    if (known := known_frame(frame)) is None:
        raise RecordingError(f"frame = {frame!r}; allowed: {', '.join(UP)}")
    return known


def check_stated(frame: object, sensors: Collection[str]) -> Frame:
    """The frame; a RecordingError unless it may be stated of a recording with these signals."""
    known = checked_frame(frame)
    if "accelerometer" not in sensors:
        raise RecordingError(
            f"frame = {frame!r}; allowed: of a recording with an accelerometer (columns ax ay az "
            "of a CSV file); that of others is the frame of their references"
        )
    return known
