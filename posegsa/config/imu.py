"""The attitude filter for inertial sensors: its numbers; `ImuConfig()` is the shipped one."""

from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from posegsa.config.reading import read_toml
from posegsa.settings.fields import NonNegative, Positive, Section
from posegsa.settings.violations import config_error

SHIPPED = "imu"
"""What the shipped filter is called instead of a file."""


class ImuVectorsConfig(Section):
    """[vectors]: what is made of accelerometer and magnetometer before the filter sees it."""

    low_pass: NonNegative = 2.5
    """Time constant of the low-pass filter that the acceleration passes in an almost inertial frame
    [s]; 0 is none."""
    field_tolerance: Positive | Literal["off"] = 0.02
    """Distance of the magnetic field from its reference, as a share of the reference's length, at
    which east has half its weight; "off" never takes any away."""
    field_recovery: NonNegative = 0.0
    """Time constant with which a disturbance of the field is forgotten [s]; 0 at once."""
    outlier: Positive = 10.0
    """An acceleration or a field so many times as long as its reference is passed over."""
    gyroscope_interval: Literal["before", "after"] = "before"
    """Which time an angular velocity is about: that before its stamp, since the last sample, or
    that after it, until the next."""


class ImuObserverConfig(Section):
    """[observer]: the gains of the filter, which are constant."""

    gain: Positive = 4.0
    """K [1/s]; an error of the inclination decays at K / 2."""
    east_weight: NonNegative = 0.075
    """Weight s of east beside that of up, which is 1, no unit; where the field is undisturbed, an
    error of the heading decays at K s / 2."""
    gamma: NonNegative = 2.0
    """Gain of the gyroscope's bias law at K = 10/s [1/s^2]; that at K is (K / 10)^2 times it."""
    gain_limit: Positive = 1.5
    """Maximum step of the innovation, as [filter] gain_limit."""


class ImuConfig(Section):
    """The whole filter."""

    vectors: ImuVectorsConfig = ImuVectorsConfig()
    observer: ImuObserverConfig = ImuObserverConfig()


def load_imu(path: str | Path = SHIPPED) -> ImuConfig:
    """The attitude filter of a TOML file; what the file leaves out keeps its shipped number.

    Args:
        path: the file, or "imu" for the shipped filter.

    Raises:
        ConfigError: the file cannot be read, is not TOML or is not such a filter.
    """
    if path == SHIPPED:
        return ImuConfig()
    data = read_toml(path)
    try:
        return ImuConfig.model_validate(data)
    except ValidationError as error:
        title = f"{path} is not a valid attitude filter for inertial sensors"
        raise config_error(title, error, ImuConfig) from None
