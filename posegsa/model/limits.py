"""Limits of the input of a filter that runs on-line, the same in Python and in C.

No sensor measures beyond these limits. Within them nothing that the filter computes overflows, even
in float32, so one wild number can't spoil the estimate for all later samples. The wide limits leave
room for coordinates with a distant origin and for vectors in small units. The estimate itself only
has to be finite: with a limit, a filter that has diverged could never recover.
"""

from typing import NamedTuple

import numpy as np

from posegsa.errors import MeasurementError


class Limit(NamedTuple):
    """The range that each number of a quantity must lie in."""

    low: float
    high: float
    unit: str = ""

    def checked(self, name: str, value: np.ndarray) -> np.ndarray:
        """The value, if all its numbers are within the limits.

        Raises:
            MeasurementError: A number is NaN or beyond the limits; the message names it.
        """
        within = (value >= self.low) & (value <= self.high)
        if not within.all():
            wrong = value[~within][0]
            raise MeasurementError(
                f"{name} = {wrong:g}; allowed: {self.low:g} to {self.high:g} {self.unit}".rstrip()
            )
        return value


TIME_STEP = Limit(1e-9, 60.0, "s")
"""From the resolution of clocks to the longest time that a velocity may be held."""
ANGULAR_VELOCITY = Limit(-1e3, 1e3, "rad/s")
"""Of the measurement. Gyroscopes measure up to 350 rad/s."""
VELOCITY = Limit(-1e4, 1e4, "m/s")
"""Of the measurement; satellites move at 8000 m/s."""
VECTOR = Limit(-1e6, 1e6)
"""Of the measurement and its reference, in the unit of the sensor: a magnetic field is
up to 65000 nT."""
LANDMARK = Limit(-1e6, 1e6, "m")
"""Of the measurement, as seen from the body."""
POSITION = Limit(-1e9, 1e9, "m")
"""Of the initial estimate and of the landmarks' references; the Earth's radius is 6.4e6 m."""
WEIGHT = Limit(0.0, 1e6)
"""Factors on the weights."""
UNIT_TOLERANCE = 1e-5
"""Maximum deviation of the squared length of an estimate's quaternion from 1."""
