"""Search spaces: from a vector to the schedule and numbers that a configuration tunes."""

import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa import config
from posegsa.arguments import check_type
from posegsa.filters.observer import ObserverGains
from posegsa.model.fuzzy import Rules
from posegsa.search.candidates import ScheduleSpace, SearchSpace, without_schedule
from posegsa.search.host_arrays import host_array
from posegsa.search.parameters import RULES, TERM_COUNT, ParameterSpace
from posegsa.search.schedule_spaces import NoiseSpaces, noise_space, schedule_space


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
        lower=host_array(lower, dtype),
        upper=host_array(upper, dtype),
        overlap=host_array(fuzzy.overlap, dtype),
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
        lowest: Lowest gain [1/s] of a constant or smooth schedule, if it is not to be the default.
    """
    section = experiment.filter
    if isinstance(section, config.KalmanConfig) and section.roles:
        return NoiseSpaces(
            tuple(role_space(kind, experiment) for kind in section.roles.values()),
            tuple(section.roles),
        )
    if not isinstance(section, config.ObserverConfig):
        return without_schedule(experiment.run.dtype)
    if section.schedule == "fuzzy":
        return observer_space(parameter_space(experiment), experiment)
    return observer_space(schedule_space(section.schedule, experiment, lowest), experiment)


def observer_space(gain: ScheduleSpace, experiment: config.Experiment) -> ScheduleSpace:
    """The space of a gain schedule together with those of the experiment's belief, if it has any.

    Args:
        gain: The space of the gain schedule.
        experiment: One of an observer.
    """
    section = experiment.filter
    if not (isinstance(section, config.ObserverConfig) and section.roles):
        return gain
    beliefs = (role_space(kind, experiment) for kind in section.roles.values())
    return NoiseSpaces((gain, *beliefs), ("gain", *section.roles), ObserverGains)


def role_space(kind: str, experiment: config.Experiment) -> ScheduleSpace:
    """The space of one schedule of a Kalman filter's noises, or of an observer's belief."""
    if kind != "fuzzy":
        return noise_space(kind, experiment)
    return parameter_space(role_controllers(experiment))


def role_controllers(experiment: config.Experiment) -> config.Experiment:
    """The experiment with [fuzzy] and [parameters] of the controllers of a role.

    A Kalman filter's are the configured ones. An observer's belief has the paper's boxes, range and
    table, because those in the configuration are of its gain [1/s].
    """
    if not isinstance(experiment.filter, config.ObserverConfig):
        return experiment
    paper = {"rules": config.FuzzyConfig().rules, "offset": 1.0}
    return experiment.model_copy(
        update={
            "fuzzy": experiment.fuzzy.model_copy(update=paper),
            "parameters": config.ParametersConfig(),
        }
    )


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
        return host_array(searched, dtype)

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
