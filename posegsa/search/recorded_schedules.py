"""The schedules that can be tuned on recordings."""

from typing import Literal

RecordedSchedule = Literal["fuzzy", "constant", "smooth"]
"""Schedules for a search on recordings: k1 to k22, one gain, or K(e) with three numbers."""
