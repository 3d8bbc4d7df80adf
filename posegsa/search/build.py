"""Convert the sections of a configuration to the arrays that the model and the search use."""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.random import wrap_key_data
from jax.typing import DTypeLike

from posegsa import config
from posegsa.arguments import check_dtype, check_type, fitting, refuse
from posegsa.errors import ConfigError, PosegsaWarning
from posegsa.filters.attitude import AttitudeFilter, AttitudeNumbers
from posegsa.filters.base import Filter, Sensors, check_filter, samples_of
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.noise_schedules import NoiseSignal, NoiseSignals
from posegsa.filters.observer import FilterSettings, Observer, VectorBias
from posegsa.model.cost import CostWeights
from posegsa.model.estimate import initial_state
from posegsa.model.family import (
    Displacements,
    Disturbances,
    Family,
    NoiseFactors,
    Occasions,
    Turns,
    realise,
)
from posegsa.model.first_pose import bias_at_rest, first_pose, waiting_until
from posegsa.model.fuzzy import Rules
from posegsa.model.scenario import Bursts, Jumps, NoiseJumps, Scenario, Sines
from posegsa.model.se3 import project_rotation
from posegsa.model.signal import SignalSettings
from posegsa.model.vectors import VectorSettings
from posegsa.search import memory
from posegsa.search.candidates import ScheduleSpace, SearchSpace, without_schedule
from posegsa.search.groups import in_groups, padded
from posegsa.search.keys import GENERATOR, held_out_keys, training_keys
from posegsa.search.parameters import RULES, TERM_COUNT, ParameterSpace
from posegsa.search.population import ScenarioBatch, TrackCost, check_cost
from posegsa.search.schedule_spaces import SIMPLE, NoiseSpaces, noise_space, schedule_space

T = TypeVar("T")
M = TypeVar("M")

OwnFilter = Filter | Callable[..., Filter]
"""A filter of the user's own, or what makes one: called with the numbers of [filter] by name."""


class TuningProblem(NamedTuple):
    """An experiment with its scenarios and its search space, ready to search."""

    experiment: config.Experiment
    scenario: Scenario | None
    """What scenarios are drawn from; None where nothing is simulated."""
    scenarios: ScenarioBatch | None
    """Training scenarios, then held-out ones; None where nothing is simulated."""
    training: ScenarioBatch
    """What is tuned on: scenarios, or recordings."""
    space: SearchSpace
    cost: TrackCost | None = None
    """A user's own cost of a simulation; None for the configured one."""
    beside: ScenarioBatch | None = None
    """Simulated scenarios that a search on recordings also uses, or None."""
    own: OwnFilter | None = None
    """The user's own filter, if it is one."""

    @property
    def simulated(self) -> ScenarioBatch:
        """`scenarios`, where there are some."""
        assert self.scenarios is not None
        return self.scenarios

    @property
    def held_out(self) -> ScenarioBatch:
        """The scenarios that only evaluate the result."""
        return self.simulated.select(slice(self.experiment.run.training_scenarios, None))


def tuning_problem(
    experiment: config.Experiment, cost: TrackCost | None = None, own: OwnFilter | None = None
) -> TuningProblem:
    """Build an experiment's scenarios and parameter space.

    Args:
        experiment: What is searched.
        cost: A user's own cost.
        own: The user's own filter, where the experiment has one.

    Raises:
        MemoryLimitError: It would need more memory than there is.
        ArgumentError: The user's cost does not return one number, or the filter is missing.
        ConfigError: It has a share for simulated scenarios, which only a search on recordings has;
            or its filter reads inertial sensors, which scenarios do not have.
    """
    check_type("experiment", experiment, config.Experiment)
    if experiment.objective.simulated_share:
        raise ConfigError(
            f"objective.simulated_share = {experiment.objective.simulated_share}; allowed: 0.0 "
            "without recordings"
        )
    if isinstance(experiment.filter, config.AttitudeConfig):
        raise ConfigError(
            'filter.kind = "imu" reads an accelerometer and a magnetometer, which no scenario has; '
            "allowed: recordings of inertial sensors"
        )
    memory.check([experiment])
    run, one = experiment.run, scenario(experiment)
    check_cost(cost, one.samples, len(experiment.scenario.vectors), jnp.dtype(run.dtype))
    scenarios = all_scenarios(experiment, one, filter_of(experiment, own))
    return TuningProblem(
        experiment=experiment,
        scenario=one,
        scenarios=scenarios,
        training=scenarios.select(slice(run.training_scenarios)),
        space=search_space(experiment),
        cost=cost,
        own=own,
    )


def all_scenarios(
    experiment: config.Experiment, one: Scenario, filter: Filter | None = None
) -> ScenarioBatch:
    """The training scenarios of an experiment, then the held-out ones."""
    run = experiment.run
    return scenario_batch(
        experiment,
        one,
        jnp.concatenate(
            [
                training_keys(run.seed, run.training_scenarios),
                held_out_keys(run.seed, run.held_out_scenarios),
            ]
        ),
        filter,
    )


def scenario_batch(
    experiment: config.Experiment, one: Scenario, keys: Array, filter: Filter | None = None
) -> ScenarioBatch:
    """S scenarios of an experiment's family, one for each key of keys (S,), ready to simulate.

    The arrays are on the host, where selecting scenarios compiles nothing. They are prepared for
    `filter`, by default the experiment's own.

    Raises:
        ArgumentError: There are no keys, or they belong to another generator.

    Warns:
        PosegsaWarning: The start waits for a pose that no sample of a scenario fixes.
    """
    dtype = jnp.dtype(experiment.run.dtype)
    filter, drawn_from = filter or filter_of(experiment), family(experiment, dtype)
    words, count = np.asarray(jax.random.key_data(keys)), len(keys)
    if words.shape != (count, 2) or not count:
        refuse(f"keys of shape {words.shape}", f"at least one, of the generator {GENERATOR}")
    samples = one.samples
    longer = replace(one, samples=padded(samples))

    start = experiment.scenario.start

    def some(index: np.ndarray) -> dict[str, Any]:
        made = _drawn(longer, drawn_from, filter, words[index], np.int32(samples - 1), start)
        return made | {"samples": jax.tree.map(lambda a: a[:, :samples], made["samples"])}

    drawn = in_groups(some, count, longer.samples)
    if experiment.family.duration == "off":
        drawn["end"] = None
    if start == "given":
        drawn["begin"] = None
    elif never := int(np.sum(drawn["begin"] > (samples - 0.5) * experiment.scenario.sampling_time)):
        warnings.warn(
            f"scenario.start = {start!r}: in {never} of {count} scenarios no sample fixes a pose; "
            "nothing is estimated there and nothing counts",
            PosegsaWarning,
            stacklevel=2,
        )
    return ScenarioBatch(
        **drawn, weights=cost_weights(experiment.cost, samples, dtype), filter=filter
    )


@partial(jax.jit, static_argnames="start")
def _drawn(
    scenario: Scenario, family: Family, filter: Filter, keys: Array, last: Array, start: str
) -> dict[str, Any]:
    """Fields of a `ScenarioBatch` for key data (S, 2); the bias is that of sample `last`."""

    def draw(key: Array) -> dict[str, Any]:
        drawn, truth, sensed = realise(scenario, family, wrap_key_data(key, impl=GENERATOR))
        measured, begin = sensed.measurements, truth.time[0]
        pose = drawn.rotation_estimate, drawn.position_estimate
        bias = drawn.bias_estimate
        if start != "given":
            found = first_pose(measured)
            if start == "rest":
                bias = bias_at_rest(measured, found.sample)
            measured = waiting_until(measured, found.sample)
            pose = found.rotation, found.position
            begin = found.sample.astype(begin.dtype) * scenario.time_step
        samples = samples_of(filter, measured, truth.rotation, truth.position, truth.time)
        initial = initial_state(*pose, bias)
        return {
            "samples": samples,
            "initial": initial,
            "bias": sensed.bias[last],
            "vector_bias": drawn.vector_bias,
            "begin": begin,
            "end": drawn.end,
        }

    return jax.vmap(draw)(keys)


def _array(values: Any, dtype: DTypeLike) -> Array:
    """Numbers of a configuration; `jnp.asarray` would compile a program for each shape."""
    return jax.device_put(np.asarray(values, dtype))


def scenario(experiment: config.Experiment) -> Scenario:
    """The scenario that an experiment configures, at its dtype.

    The initial attitude estimate is projected onto SO(3), with a warning if that changes it: the
    matrix that the paper prints has determinant 0.943.
    """
    c = experiment.scenario
    dtype = jnp.dtype(experiment.run.dtype)

    def array(values: object, *shape: int) -> Array:
        return _array(np.asarray(values, dtype).reshape(shape), dtype)

    def sines(axes: tuple[tuple[config.Sine, ...], ...]) -> Sines:
        length = max(1, *(len(axis) for axis in axes))
        table = np.zeros((3, 3, length))
        for i, axis in enumerate(axes):
            for j, sine in enumerate(axis):
                table[:, i, j] = sine.amplitude, sine.frequency, sine.phase
        return Sines(*(array(t, 3, length) for t in table))

    n, m = len(c.vectors), len(c.landmarks)
    drift = [c.angular_velocity_drift] * 3 + [c.velocity_drift] * 3
    return Scenario(
        samples=c.samples,
        time_step=array(c.sampling_time),
        angular_velocity=sines(c.angular_velocity),
        velocity=sines(c.velocity),
        rest=array(c.rest, len(c.rest), 2),
        bias=array([*c.angular_velocity_bias, *c.velocity_bias], 6),
        bias_drift=array(drift, 6),
        angular_noise=array(c.angular_velocity_noise),
        linear_noise=array(c.velocity_noise),
        vectors=array([v.direction for v in c.vectors], n, 3),
        vector_bias=array([v.bias for v in c.vectors], n, 3),
        vector_noise=array([v.noise for v in c.vectors], n),
        vector_outages=array([], 0, 2),
        vector_period=_array([v.period for v in c.vectors], np.int32),
        vector_begin=_array([_samples(v.begin, c.sampling_time) for v in c.vectors], np.int32),
        bursts=Bursts(array([], n, 0, 2), array([], n, 0, 3)),
        landmarks=array([p.position for p in c.landmarks], m, 3),
        landmark_bias=array([p.bias for p in c.landmarks], m, 3),
        landmark_noise=array([p.noise for p in c.landmarks], m),
        landmark_outages=array([], 0, 2),
        landmark_period=_array(c.landmark_period, np.int32),
        landmark_turns=array([], 0),
        landmark_bursts=Bursts(array([], m, 0, 2), array([], m, 0, 3)),
        noise_jumps=NoiseJumps(array([], 2 + n + m, 0), array([], 2 + n + m, 0)),
        jumps=Jumps(array([], 0), array([], 0, 6)),
        rotation=array(c.initial_rotation, 3, 3),
        position=array(c.initial_position, 3),
        rotation_estimate=array(_projected_estimate(c), 3, 3),
        position_estimate=array(c.initial_position_estimate, 3),
        bias_estimate=array(c.initial_bias_estimate, 6),
        end=array(math.inf),
    )


def _samples(time: float, step: float) -> int:
    """Index of the first sample at a time or after it; at most the largest of 32 bits."""
    return min(math.ceil(time / step - 1e-6), np.iinfo(np.int32).max)


DEFAULT_ESTIMATE = config.ScenarioConfig().initial_rotation_estimate


def _projected_estimate(c: config.ScenarioConfig) -> np.ndarray:
    printed = np.array(c.initial_rotation_estimate)
    projected = project_rotation(printed)
    moved = np.abs(projected - printed).max()
    # No warning for the default, the paper's matrix: the configuration and the README mention it.
    if moved > 1e-6 and c.initial_rotation_estimate != DEFAULT_ESTIMATE:
        warnings.warn(
            "scenario.initial_rotation_estimate is not a rotation (determinant "
            f"{np.linalg.det(printed):.3f}); it was projected onto SO(3), which moved its entries "
            f"by up to {moved:.2g}",
            PosegsaWarning,
            stacklevel=3,
        )
    return projected


def family(experiment: config.Experiment, dtype: DTypeLike) -> Family:
    """The family of a configuration's [family] section, at a dtype."""
    section, duration = experiment.family, experiment.scenario.duration

    def ends(values: tuple[float, float] | str, unit: float = 1.0) -> Array | None:
        return None if isinstance(values, str) else _array([unit * v for v in values], dtype)

    def number(value: float | str) -> Array | None:
        return None if isinstance(value, str) else _array(value, dtype)

    def array(values: tuple[float, ...]) -> Array:
        return _array(values, dtype)

    # Outages and bursts have the same number of windows, on which what is drawn depends.
    both = [o for o in (section.outages, section.bursts) if not isinstance(o, str)]
    most = max((_most_windows(o.rate * duration) for o in both), default=0)

    def lasting(one: config.Occasions, most: int | None = None) -> Occasions:
        expected = one.rate * duration
        most = _most_windows(expected) if most is None else most
        return Occasions(_array(one.rate, dtype), array(one.duration), most)

    def sudden(one: config.NoiseJumpsConfig | config.JumpsConfig) -> Occasions:
        most = _most_windows(one.rate * duration)
        return Occasions(_array(one.rate, dtype), array((0.0, 0.0)), most)

    def disturbances(one: config.BurstsConfig, most: int | None = None) -> Disturbances:
        size = one.size if isinstance(one.size, tuple) else (one.size, one.size)
        return Disturbances(lasting(one, most), array(size), one.each)

    def turns(one: config.InTurn) -> Turns:
        low, high = one.duration
        count = min(math.ceil(duration / low) + 1, _most_windows(2 * duration / (low + high)))
        return Turns(array(one.duration), _array(one.begin, dtype), count)

    def displacements(one: config.JumpsConfig) -> Displacements:
        low, high = (math.radians(angle) for angle in one.angle)
        return Displacements(sudden(one), array((low, high)), array(one.distance))

    return Family(
        attitude_error=ends(section.attitude_error, math.pi / 180),
        position_error=ends(section.position_error),
        bias_scale=ends(section.bias_scale),
        noise_scale=ends(section.noise_scale),
        landmark_spread=_array(section.landmark_spread, dtype),
        motion_scale=ends(section.motion_scale),
        angular_bias=number(section.angular_velocity_bias),
        linear_bias=number(section.velocity_bias),
        vector_bias=number(section.vector_bias),
        landmark_bias=number(section.landmark_bias),
        angular_drift=ends(section.angular_velocity_drift),
        linear_drift=ends(section.velocity_drift),
        outages=_made(section.outages, lambda one: lasting(one, most)),
        bursts=_made(section.bursts, lambda one: disturbances(one, most)),
        landmark_bursts=_made(section.landmark_bursts, disturbances),
        noise_jumps=_made(
            section.noise_jumps, lambda one: NoiseFactors(sudden(one), array(one.factor))
        ),
        landmark_turns=_made(section.landmarks_in_turn, turns),
        jumps=_made(section.jumps, displacements),
        landmark_interval=ends(section.landmark_interval),
        rest=ends(section.rest),
        rest_share=_array(section.rest_share, dtype),
        duration=ends(section.duration),
        random_phase=section.random_phase,
        outage_of="all" if isinstance(section.outages, str) else section.outages.sensors,
    )


def _most_windows(expected: float) -> int:
    """A number of windows that is almost never exceeded; powers of two limit recompilation."""
    return 2 ** math.ceil(math.log2(expected + 6 * math.sqrt(expected) + 4))


def _made(given: T | Literal["off"], make: Callable[[T], M]) -> M | None:
    """What is made of a setting; None if it is off."""
    return None if isinstance(given, str) else make(given)


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
        return _array(value, dtype)

    def per_square(value: float) -> Array:
        of_dtype = np.asarray(value, dtype)
        return _array(1 / (of_dtype * of_dtype), dtype)

    angular, linear = section.gamma if isinstance(section.gamma, tuple) else (section.gamma,) * 2
    learnt = section.vector_bias == "estimated"
    bounds = None if section.bias_bound == "off" else section.bias_bound
    return FilterSettings(
        law=section.law,
        gamma_law=section.gamma_law,
        substeps=section.substeps,
        gamma_angular=number(angular),
        gamma_linear=number(linear),
        gain_limit=number(math.inf if section.gain_limit == "off" else section.gain_limit),
        vectors=VectorSettings(
            weights=tuple(number(v.weight) for v in scenario.vectors),
            cross_weight=number(section.cross_vector_weight),
            normalise=section.normalise_vectors,
            cross=section.cross_vector,
            # Candidates with their own weights also combine the vectors differently.
            each_agent=learnt or any("vector" in one.key for one in experiment.also),
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
    )


def filter_of(
    experiment: config.Experiment, own: OwnFilter | None = None, sensors: Sensors | None = None
) -> Filter:
    """The filter that an experiment configures; an observer without the schedule that is searched.

    Args:
        experiment: Its [filter] says which, and with which numbers.
        own: The user's own filter, where the experiment has one.
        sensors: How many it reads, by default those of the scenario. An observer's weights go in
            order: the first vector has that of the experiment's first, and so on; further ones have
            1, and so have landmarks. So a sensor more or less changes no other's weight.

    Raises:
        ArgumentError: `own` is missing, is no filter, or lacks a number of [filter].
    """
    section, dtype = experiment.filter, jnp.dtype(experiment.run.dtype)
    if isinstance(section, config.OwnConfig):
        numbers = {name: _array(value, dtype) for name, value in section.numbers.items()}
        return _own_filter(own, numbers, dtype)
    if own is not None:
        refuse(f"filter, with filter.kind = {section.kind!r}", 'none, or with filter.kind = "own"')
    if isinstance(section, config.KalmanConfig):
        noise = {name: _array(getattr(section, name), dtype) for name in KalmanNoise._fields}
        return KalmanFilter(
            KalmanNoise(**noise),
            section.vector_bias == "estimated",
            signals=_noise_signals(section, dtype) if section.roles else None,
            iterations=section.iterations,
            moves_covariance=section.moves_covariance,
        )
    if isinstance(section, config.AttitudeConfig):
        each = {name: _array(getattr(section, name), dtype) for name in AttitudeNumbers._fields}
        return AttitudeFilter(AttitudeNumbers(**each), section.gyroscope_interval)
    settings = filter_settings(experiment)
    if sensors is not None:
        settings = _for_sensors(settings, *sensors)
    return Observer(
        schedule=None, settings=settings, signal=signal_settings(experiment.gain, dtype)
    )


def _noise_signals(section: config.KalmanConfig, dtype: DTypeLike) -> NoiseSignals:
    """What the schedules of a Kalman filter's noises see."""

    def signal(role: str) -> NoiseSignal:
        names = NoiseSignal._fields
        return NoiseSignal(*(_array(getattr(section, f"{role}_{name}"), dtype) for name in names))

    return NoiseSignals(*map(signal, NoiseSignals._fields))


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
    return jax.tree.map(lambda leaf: _array(leaf, dtype), made)


def _for_sensors(settings: FilterSettings, vectors: int, landmarks: int) -> FilterSettings:
    """Settings with weights for so many sensors."""

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
        position_weight=_array(section.position_weight, dtype),
        smoothing=_array(section.smoothing, dtype),
        error_scale=_array(section.error_scale, dtype),
        rate_scale=_array(section.rate_scale, dtype),
    )


def cost_weights(cost: config.CostConfig, samples: int, dtype: jnp.dtype) -> CostWeights:
    """Weights of the configured cost for N = `samples` samples; windows include both ends."""
    k = np.arange(samples)

    def inside(ends: tuple[int, int]) -> np.ndarray:
        return (k >= ends[0]) & (k <= ends[1])

    transient, steady = inside(cost.transient_window), inside(cost.steady_window)
    return CostWeights(
        transient=_array(np.where(transient, cost.transient_weight, 0.0), dtype),
        steady=_array(np.where(steady, cost.steady_weight, 0.0), dtype),
        window=_array(steady, bool),
        position=_array(cost.position_weight, dtype),
    )


def rule_indices(table: tuple[tuple[str, ...], ...]) -> Rules:
    """Convert a table of term names, rows and columns from VL to VS, to indices from VS to VL."""
    return tuple(
        tuple(config.TERMS.index(name) for name in reversed(row)) for row in reversed(table)
    )


def rule_table(rules: Rules) -> list[list[str]]:
    """The inverse of `rule_indices`: the table as a configuration states it."""
    return [[config.TERMS[index] for index in reversed(row)] for row in reversed(rules)]


def parameter_space(experiment: config.Experiment) -> ParameterSpace:
    """The space that an experiment configures, at its dtype.

    Raises:
        ArgumentError: The argument is not an experiment.
    """
    check_type("experiment", experiment, config.Experiment)
    fuzzy, parameters = experiment.fuzzy, experiment.parameters
    dtype = jnp.dtype(experiment.run.dtype)
    lower, upper, rules = parameters.lower, parameters.upper, None
    if fuzzy.rules == config.SEARCHED:
        lower, upper = (*lower, *(0.0,) * RULES), (*upper, *(float(TERM_COUNT),) * RULES)
    else:
        rules = rule_indices(fuzzy.rules)
    return ParameterSpace(
        lower=_array(lower, dtype),
        upper=_array(upper, dtype),
        overlap=_array(fuzzy.overlap, dtype),
        ordering=fuzzy.ordering,
        coverage=fuzzy.coverage,
        rules=rules,
        gain_range=parameters.gain_range,
        centroid=fuzzy.centroid,
        sampled_points=fuzzy.sampled_points,
        sampled_rule=fuzzy.sampled_rule,
        no_rule=fuzzy.no_rule,
        reach=_reach(parameters),
        offset=fuzzy.offset,
    )


def own_space(experiment: config.Experiment, lowest: float | None = None) -> ScheduleSpace:
    """The space of the schedule that an experiment configures.

    Args:
        experiment: Its [filter] says which.
        lowest: Least gain [1/s] of a constant or smooth one, where it is to be another one.
    """
    section = experiment.filter
    if isinstance(section, config.KalmanConfig) and section.roles:
        return NoiseSpaces(
            tuple(role_space(kind, experiment) for kind in section.roles.values()),
            tuple(section.roles),
        )
    if not isinstance(section, config.ObserverConfig):
        return without_schedule(experiment.run.dtype)
    if section.schedule in SIMPLE:
        return schedule_space(section.schedule, experiment, lowest)
    return parameter_space(experiment)


def role_space(kind: str, experiment: config.Experiment) -> ScheduleSpace:
    """The space of one schedule of a Kalman filter's noises."""
    return parameter_space(experiment) if kind == "fuzzy" else noise_space(kind, experiment)


def search_space(
    experiment: config.Experiment, schedules: ScheduleSpace | None = None
) -> SearchSpace:
    """Where an experiment searches: the numbers of a schedule, and those that are tuned too.

    Args:
        experiment: What is searched.
        schedules: The space of the schedule, by default that of the experiment's own.
    """
    schedules = own_space(experiment) if schedules is None else schedules
    also, dtype = experiment.also, jnp.dtype(experiment.run.dtype)
    logarithmic = tuple(one.scale == "logarithmic" for one in also)

    def bounds(values: list[float]) -> Array:
        searched = [
            math.log(value) if by_logarithm else value
            for value, by_logarithm in zip(values, logarithmic, strict=True)
        ]
        return _array(searched, dtype)

    return SearchSpace(
        schedules=schedules,
        also_lower=bounds([one.lower for one in also]),
        also_upper=bounds([one.upper for one in also]),
        keys=tuple(one.key for one in also),
        logarithmic=logarithmic,
    )


def _reach(parameters: config.ParametersConfig) -> int:
    """Largest distance in order of two output terms that can overlap: 2 in the paper's boxes.

    Sorted numbers stay between their sorted lower and sorted upper bounds.
    """
    half = len(config.PARAMETERS) // 2
    lower, upper = (
        np.sort(
            np.sort(config.triangles(tuple(bounds[half:]), *parameters.gain_range), axis=1), axis=0
        )
        for bounds in (parameters.lower, parameters.upper)
    )
    last_feet, first_feet = upper[:, 2], lower[:, 0]
    return max(int(np.sum(first_feet < foot)) - 1 - i for i, foot in enumerate(last_feet))
