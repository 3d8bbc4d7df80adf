"""The attitude filter for inertial sensors: the observer with constant gains."""

import jax
import jax.numpy as jnp
import numpy as np

from posegsa.arguments import check_type
from posegsa.config.imu import ImuConfig, ImuObserverConfig
from posegsa.errors import RecordingError
from posegsa.model.filter import FilterSettings
from posegsa.model.rollout import Estimates
from posegsa.model.schedules import ConstantGain
from posegsa.model.vectors import VectorSettings
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter


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


def run_imu(recording: Recording, config: ImuConfig | None = None) -> Estimates:
    """Estimate the attitude of a recording of an inertial sensor.

    Args:
        recording: from `posegsa.imu` or `posegsa.as_imu`.
        config: the filter's numbers, of which [observer] is used here; by default the shipped ones.

    Raises:
        RecordingError: the recording is another one.
    """
    check_type("recording", recording, Recording)
    config = ImuConfig() if config is None else config
    check_type("config", config, ImuConfig)
    if not is_prepared(recording):
        raise RecordingError(
            f"{recording.name}: its vectors are not those of an inertial sensor; allowed: a "
            "recording of posegsa.imu, or posegsa.as_imu(recording)"
        )
    vectors = np.shape(recording.measurements.vectors)[1]
    with jax.enable_x64(True):
        settings = imu_settings(config.observer, vectors)
        gain = ConstantGain(jnp.asarray(config.observer.gain, float))
        return run_filter(gain, recording, settings=settings)


def is_prepared(recording: Recording) -> bool:
    """Whether a recording's vectors are those of `imu` or `as_imu`, which keep the gyroscope."""
    return "gyroscope" in recording.sensors
