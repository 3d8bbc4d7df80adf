"""Settings of the attitude filter for inertial sensors; `ImuConfig()` is the shipped filter."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import ValidationError

from posegsa.config.experiment import ONE_OPTIMISER
from posegsa.config.reading import read_toml
from posegsa.config.tunable import AlsoTuned, also_conflicts, tunable, with_effect, with_numbers
from posegsa.optimisers import DifferentialEvolution, Optimiser
from posegsa.settings.fields import NonNegative, Positive, Section, Tunable
from posegsa.settings.violations import Violation, config_error

SHIPPED = "imu"
"""The name of the shipped filter, used in place of a file."""


class ImuVectorsConfig(Section):
    """[vectors]: how the filter's vectors are computed from accelerometer and magnetometer."""

    low_pass: Annotated[NonNegative, Tunable()] = 2.5
    """Time constant of the low-pass filter of the acceleration in an almost inertial frame [s]; 0
    means none."""
    field_tolerance: Annotated[Positive | Literal["off"], Tunable()] = 0.02
    """Distance of the magnetic field from its reference, as a share of the reference's length, at
    which east has half its weight; "off" always gives full weight."""
    field_recovery: Annotated[NonNegative, Tunable()] = 0.0
    """Time constant with which the weight recovers after a disturbance of the field [s]; 0 means
    at once."""
    outlier: Annotated[Positive, Tunable()] = 10.0
    """An acceleration or a field more than this many times as long as its reference is ignored."""
    gyroscope_interval: Literal["before", "after"] = "before"
    """Whether an angular velocity is the mean over the interval before its time stamp, since the
    last sample, or after it, until the next sample."""


class ImuObserverConfig(Section):
    """[observer]: the gains of the filter, which are constant."""

    gain: Annotated[Positive, Tunable()] = 4.0
    """K [1/s]; an error of the inclination decays at the rate K / 2."""
    east_weight: Annotated[NonNegative, Tunable()] = 0.075
    """Weight s of east, no unit; that of up is 1. In an undisturbed field an error of the heading
    decays at the rate K s / 2."""
    gamma: Annotated[NonNegative, Tunable()] = 2.0
    """Gain of the gyroscope's bias law at K = 10/s [1/s^2]; it is proportional to K^2."""
    gain_limit: Annotated[Positive, Tunable()] = 1.5
    """Maximum step of the innovation, like gain_limit in [filter]."""


class ImuParametersConfig(Section):
    """[parameters]: which numbers a search on recordings tunes."""

    also: tuple[AlsoTuned, ...] = (
        AlsoTuned(key="vectors.low_pass", lower=0.5, upper=8.0, scale="logarithmic"),
        AlsoTuned(key="vectors.field_tolerance", lower=0.02, upper=0.32, scale="logarithmic"),
        AlsoTuned(key="observer.gain", lower=0.5, upper=16.0, scale="logarithmic"),
        AlsoTuned(key="observer.east_weight", lower=0.01, upper=1.0, scale="logarithmic"),
        AlsoTuned(key="observer.gamma", lower=0.1, upper=10.0, scale="logarithmic"),
    )
    """Numbers of [vectors] and [observer], each with its bounds."""


class ImuConfig(Section):
    """The whole filter, and the search of `tune_imu`."""

    vectors: ImuVectorsConfig = ImuVectorsConfig()
    observer: ImuObserverConfig = ImuObserverConfig()
    parameters: ImuParametersConfig = ImuParametersConfig()
    search: Annotated[Optimiser, ONE_OPTIMISER] = DifferentialEvolution(
        agents=12, iterations=20, strategy="best/1/bin", factor=0.6
    )
    """The optimiser, selected by `search.optimiser`, with its settings."""

    def _conflicts(self) -> Iterator[Violation]:
        # By default, a number that is "off" is not tuned.
        needless = ImuParametersConfig().also
        yield from also_conflicts(tunable(self), self.parameters.also, needless=needless)

    @property
    def also(self) -> tuple[AlsoTuned, ...]:
        """The numbers that are tuned."""
        return with_effect(tunable(self), self.parameters.also, needless=ImuParametersConfig().also)

    def with_numbers(self, values: Mapping[str, float]) -> Self:
        """The filter with some numbers replaced, by keys such as "vectors.low_pass".

        Raises:
            ConfigError: A number is not allowed.
        """
        data: dict[str, Any] = with_numbers(self.model_dump(mode="json"), values)
        try:
            return type(self).model_validate(data)
        except ValidationError as error:
            title = "not a valid attitude filter with these numbers"
            raise config_error(title, error, type(self)) from None

    def to_toml(self) -> str:
        """The filter as TOML with all values; `load_imu` reads it back."""
        return tomli_w.dumps(self.model_dump(mode="json"))


def is_imu(data: Mapping[str, Any]) -> bool:
    """Whether the data of a TOML file are an attitude filter, not an experiment."""
    return bool(data.keys() & {"vectors", "observer"})


def names_imu(name: str | Path | None) -> bool:
    """Whether a CONFIG argument is an attitude filter: "imu", or a file with one.

    Raises:
        ConfigError: The file cannot be read or is not TOML.
    """
    if name is None or not str(name).endswith(".toml"):
        return name == SHIPPED
    return is_imu(read_toml(name))


def load_imu(path: str | Path = SHIPPED) -> ImuConfig:
    """The attitude filter of a TOML file; keys that the file leaves out keep the shipped values.

    Args:
        path: the file, or "imu" for the shipped filter.

    Raises:
        ConfigError: the file cannot be read, is not TOML or is not an attitude filter.
    """
    if path == SHIPPED:
        return ImuConfig()
    data = read_toml(path)
    try:
        return ImuConfig.model_validate(data)
    except ValidationError as error:
        title = f"{path} is not a valid attitude filter for inertial sensors"
        raise config_error(title, error, ImuConfig) from None
