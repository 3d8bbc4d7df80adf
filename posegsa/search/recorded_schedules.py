"""The schedules that can be tuned on recordings."""

from typing import Literal

RecordedSchedule = Literal["fuzzy", "constant", "smooth"]
"""What a search on recordings may look for: k1 to k22, one gain, or K(e) of three numbers."""
