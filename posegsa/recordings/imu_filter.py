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
"""Runs over a recording that begins in motion."""


def imu_settings(observer: ImuObserverConfig, vectors: int = 2) -> FilterSettings:
    """The filter's settings, for recordings with one vector (up) or two (up and east).

    Vectors are neither normalised nor crossed, and their biases are not learnt: acceleration is no
    constant bias.
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
    """Estimate the attitude of a recording of an inertial sensor.

    One that begins in motion is run more than once (`in_passes`).

    Args:
        recording: from `posegsa.imu` or `posegsa.as_imu`.
        config: the filter's numbers, of which [observer] is used here; by default the shipped ones.

    Raises:
        ArgumentError: an argument is of another type.
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
    """The constant gain; in a recording that begins in motion, with a gamma that grows.

    At first the field is believed as it is there; what it says then is nothing to learn a bias of.
    """
    gain = jnp.asarray(observer.gain, float)
    if recording.resting:
        return ConstantGain(gain)
    return SettlingGain(gain, jnp.asarray(STARTUP, float))


def in_passes(recording: ImuRecording, run: Callable[[ImuRecording], Estimates]) -> Estimates:
    """The estimates of a recording whose start may not tell the gyroscope's bias.

    One that begins in motion is run PASSES times. In the first pass nothing is known of the bias in
    the almost inertial frame, which then turns with it, and hides it; in each that follows, the
    bias there is the one that the pass before has learnt up to each sample. So every estimate is
    still made of what was measured before it.

    Args:
        recording: of an inertial sensor.
        run: what estimates its attitude and the gyroscope's bias.
    """
    whole = isinstance(recording.start, Start)  # not a window from the middle of one
    found = run(recording)
    for _ in range(PASSES - 1 if whole and not recording.resting else 0):
        found = run(with_known_bias(recording, np.asarray(found.bias)[:, :3]))
    return found
