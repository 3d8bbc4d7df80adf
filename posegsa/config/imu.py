"""What is made of an inertial sensor's signals before the filter sees them."""

from typing import Literal

from posegsa.settings.fields import NonNegative, Positive, Section


class ImuConfig(Section):
    """[imu]: how a recording of gyroscope, accelerometer and magnetometer is prepared."""

    low_pass: NonNegative = 3.0
    """Time constant of the low-pass filter that the acceleration passes in an almost inertial frame
    [s]; 0 is none."""
    field_tolerance: Positive | Literal["off"] = 0.01
    """Distance of the magnetic field from its reference, as a share of the reference's length, at
    which east has half its weight; "off" never takes any away."""
    field_recovery: NonNegative = 0.0
    """Time constant with which a disturbance of the field is forgotten [s]; 0 at once."""
    outlier: Positive = 10.0
    """An acceleration or a field so many times as long as its reference is passed over."""
    gyroscope_interval: Literal["before", "after"] = "before"
    """Which time an angular velocity is about: that before its stamp, since the last sample, or
    that after it, until the next."""
