"""What a filter that runs on-line takes: the same in Python and in C.

No sensor measures beyond these limits. Within them nothing that the filter computes overflows, in
float32 neither, so that one wild number can't spoil the estimate for all samples that follow. The
wide ones leave room for coordinates whose origin is far away and for vectors in small units. The
estimate only has to be finite: with a limit, a filter that has gone astray could never return.
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
        """The value.

        Raises:
            MeasurementError: One of its numbers is NaN or beyond the limits; names it.
        """
        within = (value >= self.low) & (value <= self.high)
        if not within.all():
            wrong = value[~within][0]
            raise MeasurementError(
                f"{name} = {wrong:g}; allowed: {self.low:g} to {self.high:g} {self.unit}".rstrip()
            )
        return value


TIME_STEP = Limit(1e-9, 60.0, "s")
"""From what clocks resolve to how long a velocity may be held."""
ANGULAR_VELOCITY = Limit(-1e3, 1e3, "rad/s")
"""Of the measurement. Gyroscopes end at 350 rad/s or below."""
VELOCITY = Limit(-1e4, 1e4, "m/s")
"""Of the measurement; satellites have 8000 m/s."""
VECTOR = Limit(-1e6, 1e6)
"""Of the measurement and its reference, in the unit of the sensor: a magnetic field in
nanotesla comes to 65000."""
LANDMARK = Limit(-1e6, 1e6, "m")
"""Of the measurement, as seen from the body."""
POSITION = Limit(-1e9, 1e9, "m")
"""Of the initial estimate and of the landmarks' references; the Earth's radius is 6.4e6 m."""
WEIGHT = Limit(0.0, 1e6)
"""Factors on the weights."""
UNIT_TOLERANCE = 1e-5
"""How far the squared length of an estimate's quaternion may be from 1."""
