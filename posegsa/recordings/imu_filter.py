"""The attitude filter for inertial sensors: the observer with constant gains."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from posegsa.arguments import check_type
from posegsa.config.imu import ImuConfig, ImuObserverConfig
from posegsa.filters.observer import FilterSettings, Observer
from posegsa.filters.rollout import Estimates
from posegsa.model.schedules import ConstantGain, GainSchedule, SettlingGain
from posegsa.model.vectors import VectorSettings
from posegsa.recordings.imu import STARTUP, ImuRecording, with_known_bias
from posegsa.recordings.running import run_filter
from posegsa.recordings.start import Start

PASSES = 4
"""Number of runs over a recording that begins in motion."""


def imu_settings(observer: ImuObserverConfig, vectors: int = 2) -> FilterSettings:
    """The filter's settings, for recordings with one vector (up) or two (up and east).

    Vectors are neither normalised nor is their cross product used, and their biases are not
    estimated, because acceleration is not a constant bias.
    """
    weights = (1.0, observer.east_weight)[:vectors]
    return FilterSettings(
        law="gradient",
        gamma_law="quadratic",
        substeps=1,
        gamma_angular=jnp.asarray(observer.gamma, float),
        gamma_linear=jnp.zeros((), float),
        gain_limit=jnp.asarray(observer.gain_limit, float),
        vectors=VectorSettings(
            weights=tuple(jnp.asarray(weight, float) for weight in weights),
            cross_weight=jnp.zeros((), float),
            normalise=False,
            cross=False,
            each_agent=False,
        ),
        landmark_weights=None,
        vector_bias=None,
    )


def run_imu(recording: ImuRecording, config: ImuConfig | None = None) -> Estimates:
    """Estimate the attitude in a recording of an inertial sensor.

    If the recording begins in motion, the filter runs more than once (`in_passes`).

    Args:
        recording: from `posegsa.imu` or `posegsa.as_imu`.
        config: of the filter; only [observer] is used. By default the shipped one.

    Raises:
        ArgumentError: an argument has the wrong type.
    """
    words = "a recording of posegsa.imu, or posegsa.as_imu(recording)"
    check_type("recording", recording, ImuRecording, allowed=words)
    config = ImuConfig() if config is None else config
    check_type("config", config, ImuConfig)
    vectors = np.shape(recording.measurements.vectors)[1]
    with jax.enable_x64(True):
        observer = Observer(
            imu_schedule(config.observer, recording), imu_settings(config.observer, vectors)
        )
        return in_passes(recording, lambda each: run_filter(observer, each))


def imu_schedule(observer: ImuObserverConfig, recording: ImuRecording) -> GainSchedule:
    """The constant gain; with a growing gamma if the recording begins in motion.

    There the first samples of the field get full weight without a reference, which is too uncertain
    to estimate a bias from.
    """
    gain = jnp.asarray(observer.gain, float)
    if recording.resting:
        return ConstantGain(gain)
    return SettlingGain(gain, jnp.asarray(STARTUP, float))


def in_passes(recording: ImuRecording, run: Callable[[ImuRecording], Estimates]) -> Estimates:
    """The estimates of a recording, in several passes if it begins in motion.

    In that case the gyroscope's bias is unknown in the first pass. The almost inertial frame then
    turns with the bias, and hides it. Each further pass corrects the frame by the bias that the
    pass before had estimated up to each sample, so every estimate still depends only on earlier
    measurements.

    Args:
        recording: of an inertial sensor.
        run: estimates the attitude and the gyroscope's bias.
    """
    whole = isinstance(recording.start, Start)  # not a window that begins later
    found = run(recording)
    for _ in range(PASSES - 1 if whole and not recording.resting else 0):
        found = run(with_known_bias(recording, np.asarray(found.bias)[:, :3]))
    return found
