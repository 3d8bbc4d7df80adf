"""The untuned Kalman filter, for comparison: noises and start are those of its sensors.

A user has it without a search: standard deviations as a data sheet states them, and the
first pose that the sensors show.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from posegsa import config
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.noise_schedules import NoiseSignals
from posegsa.search.population import ScenarioBatch
from posegsa.search.problem import TuningProblem

SMALLEST_NOISE = 1e-3
"""Smallest standard deviation of a sensor and of a bias that it assumes, in their units."""


class BiasSpread(NamedTuple):
    """Root mean squares over scenarios of each component of the biases."""

    angular: float
    """Bias of the angular velocity [rad/s]."""
    linear: float
    """Bias of the velocity [m/s]."""
    vector: float
    """Biases of the vectors, in their unit."""


def bias_spread(experiment: config.Experiment) -> BiasSpread:
    """The spread of the biases in an experiment's scenarios."""
    c, f, scale = experiment.scenario, experiment.family, 1.0
    if not isinstance(f.bias_scale, str):
        low, high = f.bias_scale
        scale = math.sqrt((low * low + low * high + high * high) / 3)
    angular, linear = (
        scale * (_rms(fixed) if isinstance(drawn, str) else drawn)
        for drawn, fixed in (
            (f.angular_velocity_bias, c.angular_velocity_bias),
            (f.velocity_bias, c.velocity_bias),
        )
    )
    fixed = [component for vector in c.vectors for component in vector.bias]
    vector = _rms(fixed) if isinstance(f.vector_bias, str) else f.vector_bias
    return BiasSpread(angular, linear, vector)


def untuned_kalman(experiment: config.Experiment) -> config.Experiment:
    """An experiment with the untuned Kalman filter in place of its own.

    Its noises are those that the scenario's sensors have before a family changes them. Its pose
    starts with wide deviations, so that the first sample gives it its covariance. It has as many
    iterations as the experiment's filter, so that both share a compiled program; from the sensors
    they hardly change its cost (docs/recommended.md).
    """
    c, spread = experiment.scenario, bias_spread(experiment)
    root = math.sqrt(c.sampling_time)
    numbers = {
        "angular_velocity": c.angular_velocity_noise * root,
        "velocity": c.velocity_noise * root,
        "vector": _rms([vector.noise for vector in c.vectors]),
        "landmark": _rms([landmark.noise for landmark in c.landmarks]),
        "initial_attitude": 1.0,
        "initial_position": 3.0,
        "initial_angular_bias": spread.angular,
        "initial_linear_bias": spread.linear,
        "initial_vector_bias": spread.vector,
    }
    least = {"angular_velocity": SMALLEST_NOISE * root, "velocity": SMALLEST_NOISE * root}
    noises: dict[str, Any] = {
        name: max(value, least.get(name, SMALLEST_NOISE)) for name, value in numbers.items()
    }
    own = experiment.filter
    iterations = own.iterations if isinstance(own, config.KalmanConfig) else 1
    plain = with_kalman(experiment, config.KalmanConfig(**noises, iterations=iterations))
    return plain.replace(**{"scenario.start": "sensors"})


def with_kalman(experiment: config.Experiment, filter: config.KalmanConfig) -> config.Experiment:
    """An experiment with a Kalman filter in place of its own filter; all its noises are tuned.

    The filter has no controller, so [fuzzy] is the default: with rules that are searched no Kalman
    filter with schedules would be valid.
    """
    plain = {"tuned": config.TunedConfig(), "fuzzy": config.FuzzyConfig()}
    return experiment.replace(filter=filter, **plain, **{"parameters.also": config.KALMAN_ALSO})


def with_idle_schedules(batch: ScenarioBatch, problem: TuningProblem) -> ScenarioBatch:
    """Scenarios whose Kalman filter has no schedules, with schedules that change nothing.

    It computes the same, with the program that judges the filter which a problem tunes. To compile
    a program of its own would take longer than all its runs. Any other filter stays as it is.
    """
    plain, scheduled = batch.filter, problem.simulated.filter
    if not isinstance(plain, KalmanFilter) or not isinstance(scheduled, KalmanFilter):
        return batch
    any_schedule = problem.space.candidate(problem.space.box.lower).schedule
    if scheduled.signals is None or any_schedule is None:  # none, or a user's own
        return batch
    signals = NoiseSignals(
        *(each._replace(largest=np.ones_like(each.largest)) for each in scheduled.signals)
    )
    changes: dict[str, Any] = {"schedule": any_schedule, "signals": signals}
    scheduled = replace(scheduled, **changes)
    idle = replace(plain, **changes, belief_input=scheduled.belief_input)
    if jax.tree.structure(idle) != jax.tree.structure(scheduled):
        return batch
    return batch._replace(filter=idle)


def always_starts(batch: ScenarioBatch) -> bool:
    """Whether the sensors fix a pose in every scenario of a batch."""
    if batch.begin is None:
        return True
    time = np.asarray(batch.samples.time)
    return bool(np.all(np.asarray(batch.begin) <= time[:, -1]))


def _rms(values: Sequence[float]) -> float:
    """Root mean square of numbers; 0 of none."""
    return math.sqrt(sum(value * value for value in values) / max(1, len(values)))
