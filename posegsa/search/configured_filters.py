"""Filters as a configuration's [filter] section describes them, with their numbers as arrays."""

import math
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from posegsa import config
from posegsa.arguments import check_dtype, check_type, fitting, refuse
from posegsa.filters.attitude import AttitudeFilter, AttitudeNumbers
from posegsa.filters.base import Filter, Sensors, check_filter
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.leads import LEAD_KEYS, Leads
from posegsa.filters.noise_schedules import NoiseSignal, NoiseSignals
from posegsa.filters.observer import BeliefSettings, FilterSettings, Observer, VectorBias
from posegsa.model.signal import SignalSettings, Unknown
from posegsa.model.vectors import VectorSettings
from posegsa.search.host_arrays import host_array

OwnFilter = Filter | Callable[..., Filter]
"""A filter of the user's own, or what makes one: called with the numbers of [filter] by name."""


def filter_settings(experiment: config.Experiment) -> FilterSettings:
    """The filter that an experiment configures, at its dtype.

    Raises:
        ArgumentError: not an experiment, or not one of the observer.
    """
    check_type("experiment", experiment, config.Experiment)
    section, scenario = experiment.filter, experiment.scenario
    if not isinstance(section, config.ObserverConfig):
        refuse(f"filter.kind = {section.kind}", "observer")
    dtype = jnp.dtype(experiment.run.dtype)

    def number(value: float) -> Array:
        return host_array(value, dtype)

    def per_square(value: float) -> Array:
        of_dtype = np.asarray(value, dtype)
        return host_array(1 / (of_dtype * of_dtype), dtype)

    angular, linear = section.gamma if isinstance(section.gamma, tuple) else (section.gamma,) * 2
    learnt = section.vector_bias == "estimated"
    bounds = None if section.bias_bound == "off" else section.bias_bound
    return FilterSettings(
        law=section.law,
        gamma_law=section.gamma_law,
        substeps=section.substeps,
        landmark_unit=section.landmark_unit,
        gamma_angular=number(angular),
        gamma_linear=number(linear),
        gain_limit=number(math.inf if section.gain_limit == "off" else section.gain_limit),
        vectors=VectorSettings(
            weights=tuple(number(v.weight) for v in scenario.vectors),
            cross_weight=number(section.cross_vector_weight),
            normalise=section.normalise_vectors,
            cross=section.cross_vector,
            # A candidate with its own weights sums the vectors with them, in each step.
            each_agent=learnt
            or bool(section.roles)
            or any("vector" in one.key for one in experiment.also),
        ),
        landmark_weights=tuple(number(p.weight) for p in scenario.landmarks),
        vector_bias=VectorBias(
            gain=number(section.vector_bias_gain),
            leak=number(section.vector_bias_leak),
            per_bound=per_square(section.vector_bias_bound),
            per_turning=per_square(section.excitation**2),
            excitation_time=number(section.excitation_time),
            law=section.vector_bias_law,
        )
        if learnt
        else None,
        per_angular_bias_bound=None if bounds is None else per_square(bounds[0]),
        per_linear_bias_bound=None if bounds is None else per_square(bounds[1]),
        # A length of 1 m has no effect; without it the program multiplies less.
        length=number(section.length)
        if section.length != 1.0 or any(one.key == "filter.length" for one in experiment.also)
        else None,
        length_growth=None if section.length_growth == "off" else number(section.length_growth),
        per_bias_wait=None if section.bias_wait == "off" else per_square(section.bias_wait),
    )


def filter_of(
    experiment: config.Experiment, own: OwnFilter | None = None, sensors: Sensors | None = None
) -> Filter:
    """The filter that an experiment configures; an observer without the schedule that is searched.

    Args:
        experiment: Its [filter] says which, and with which numbers.
        own: The user's own filter, where the experiment has one.
        sensors: How many sensors it reads, by default those of the scenario. An observer's weights
            go in order: the first vector has the weight of the experiment's first, and so on;
            further ones have 1, and so do landmarks. So adding or removing a sensor changes no
            other sensor's weight.

    Raises:
        ArgumentError: `own` is missing, is no filter, or lacks a number of [filter].
    """
    section, dtype = experiment.filter, jnp.dtype(experiment.run.dtype)
    if isinstance(section, config.OwnConfig):
        numbers = {name: host_array(value, dtype) for name, value in section.numbers.items()}
        return _own_filter(own, numbers, dtype)
    if own is not None:
        refuse(f"filter, with filter.kind = {section.kind!r}", 'none, or with filter.kind = "own"')
    if isinstance(section, config.KalmanConfig):
        noise = {name: host_array(getattr(section, name), dtype) for name in KalmanNoise._fields}
        return KalmanFilter(
            KalmanNoise(**noise),
            section.vector_bias == "estimated",
            signals=_noise_signals(section, dtype) if section.roles else None,
            belief_input=section.belief_input,
            iterations=section.iterations,
            reset=section.reset,
            leads=_leads(experiment, section, dtype),
            noise_adaptation=None
            if section.noise_adaptation == "off"
            else host_array(section.noise_adaptation, dtype),
            vector_scales=section.vector_scales,
            landmark_scales=section.landmark_scales,
        )
    if isinstance(section, config.AttitudeConfig):
        each = {name: host_array(getattr(section, name), dtype) for name in AttitudeNumbers._fields}
        return AttitudeFilter(AttitudeNumbers(**each), section.gyroscope_interval)
    settings = filter_settings(experiment)
    if sensors is not None:
        settings = _for_sensors(settings, *sensors)
    belief = None
    if section.roles:
        deviations = (host_array(one, dtype) for one in (section.vector, section.landmark))
        belief = BeliefSettings(_noise_signal(section, "belief", dtype), *deviations)
    return Observer(
        schedule=None,
        settings=settings,
        signal=signal_settings(experiment.gain, dtype),
        belief=belief,
    )


def _leads(
    experiment: config.Experiment, section: config.KalmanConfig, dtype: DTypeLike
) -> Leads | None:
    """How far velocities are extrapolated; None if they never are."""
    values = [getattr(section, key) for key in LEAD_KEYS]
    tuned = {f"filter.{key}" for key in LEAD_KEYS} & {one.key for one in experiment.also}
    return Leads(*(host_array(value, dtype) for value in values)) if any(values) or tuned else None


def _noise_signals(section: config.KalmanConfig, dtype: DTypeLike) -> NoiseSignals:
    """The input signals of a Kalman filter's noise schedules."""
    return NoiseSignals(*(_noise_signal(section, role, dtype) for role in NoiseSignals._fields))


def _noise_signal(
    section: config.KalmanConfig | config.ObserverConfig, role: str, dtype: DTypeLike
) -> NoiseSignal:
    """The input signal of one role."""
    names = NoiseSignal._fields
    return NoiseSignal(*(host_array(getattr(section, f"{role}_{name}"), dtype) for name in names))


def _own_filter(own: OwnFilter | None, numbers: dict[str, Array], dtype: DTypeLike) -> Filter:
    """A user's own filter with the numbers of [filter], all its numbers at a dtype."""
    if own is None:
        refuse(
            'filter: none with filter.kind = "own"',
            "the filter, or its class (filter=..., --filter module:Class)",
        )
    if isinstance(own, Filter) and not isinstance(own, type):
        made = own.with_values(numbers)
    else:
        with fitting("filter"):
            made = own(**numbers)
    check_filter("filter", made)
    return jax.tree.map(lambda leaf: host_array(leaf, dtype), made)


def _for_sensors(settings: FilterSettings, vectors: int, landmarks: int) -> FilterSettings:
    """Settings with weights for this number of sensors."""

    def first(weights: tuple[Array, ...] | None, count: int) -> tuple[Array, ...]:
        given = weights or ()
        one = jnp.ones((), jnp.asarray(settings.gamma_angular).dtype)
        return (*given[:count], *(one,) * (count - len(given)))

    return replace(
        settings,
        vectors=replace(settings.vectors, weights=first(settings.vectors.weights, vectors)),
        landmark_weights=first(settings.landmark_weights, landmarks),
    )


def signal_settings(section: config.GainConfig, dtype: DTypeLike) -> SignalSettings:
    """The error signal of a configuration's [gain] section, at a dtype.

    Raises:
        ArgumentError: Not a [gain] section, or not a floating dtype.
    """
    check_type("section", section, config.GainConfig)
    check_dtype("dtype", dtype)
    return SignalSettings(
        signal=section.signal,
        rate=section.rate,
        position_weight=host_array(section.position_weight, dtype),
        smoothing=host_array(section.smoothing, dtype),
        error_scale=host_array(section.error_scale, dtype),
        rate_scale=host_array(section.rate_scale, dtype),
        unknown=None
        if section.unknown == "off"
        else Unknown(
            start=host_array(section.unknown, dtype),
            fall=host_array(section.unknown_fall, dtype),
            rise=host_array(section.unknown_rise, dtype),
        ),
    )
