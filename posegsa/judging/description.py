"""The stored form of a filter, its kind and its numbers; conversion to it and back."""

import reprlib
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import AfterValidator, Field

from posegsa import config
from posegsa.arguments import refuse
from posegsa.config import PARAMETERS, SEARCHED, Experiment
from posegsa.filters.base import Filter, Sensors
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.filters.observer import Observer, ObserverGains
from posegsa.model.fuzzy import Rules
from posegsa.model.schedules import SCHEDULES, FuzzyGain, GainSchedule, KnotGain
from posegsa.search.candidates import Candidate, Schedule
from posegsa.search.configured_filters import OwnFilter, filter_of
from posegsa.search.parameters import RULES, TERM_COUNT, ParameterSpace
from posegsa.search.schedule_spaces import knot_times
from posegsa.search.search_spaces import parameter_space, role_controllers, rule_table
from posegsa.settings.fields import Number
from posegsa.words import text_table

TITLES = {kind: one.title for kind, one in config.FILTERS.items() if kind != "observer"}
"""Titles of the filters that are not an observer, by kind."""
KINDS = (*SCHEDULES, *TITLES)
"""The observer by its gain schedule, another filter of posegsa, or a user's own."""


def _kind(given: str) -> str:
    if given not in KINDS:
        raise ValueError(f"allowed: {', '.join(KINDS)}")
    return given


def check_kind(experiment: Experiment, job: str) -> None:
    """Refuse an experiment of a user's own filter, for a job that accepts no such filter."""
    if experiment.filter.kind == "own":
        refuse('filter.kind = "own"', f"a filter of posegsa, as `{job}` takes no filter")


class Description(NamedTuple):
    """A filter as it is stored, by its own numbers."""

    kind: Annotated[str, AfterValidator(_kind)]
    """One of `KINDS`."""
    numbers: dict[str, list[Number]]
    """Numbers of the schedule, by name; a single number is a list of one. Empty without a
    schedule."""
    also: dict[str, Number]
    """Other tuned numbers, by key of the configuration, such as the noises of a Kalman filter."""
    evaluations: Annotated[int, Field(ge=0)]
    """Evaluations of the search that found it; 0 without a search."""

    @property
    def title(self) -> str:
        """The filter's title for use in a sentence."""
        return title_of(self.kind)


def title_of(kind: str) -> str:
    """The title of a kind of filter, for use in a sentence."""
    return TITLES.get(kind, f"{kind} gain")


def kind_of(experiment: Experiment) -> str:
    """The kind of the filter that an experiment searches."""
    section = experiment.filter
    is_observer = isinstance(section, config.ObserverConfig)
    return section.schedule if is_observer else section.kind


def _of_its_kind(found: Description) -> Description:
    """A description that was read, after a check that it has the numbers of its kind."""
    lengths = {name: len(values) for name, values in found.numbers.items()}
    if found.kind in SCHEDULES:  # numbers of belief are checked where its kind is known
        lengths = {name: length for name, length in lengths.items() if "." not in name}
    match found.kind:
        case "fuzzy":
            # A rule table is checked where it is known whether it was searched (`candidate_of`).
            own = {name: length for name, length in lengths.items() if name != "rules"}
            fits, allowed = own == {"k": len(PARAMETERS)}, f"k, of length {len(PARAMETERS)}"
        case "open loop":
            time = found.numbers.get("time", [])
            same = lengths == dict.fromkeys(("time", "log_gain"), max(1, len(time)))
            fits, allowed = same and bool(np.all(np.diff(time) > 0)), "ascending time, and log_gain"
        case "kalman":
            roles = {name.partition(".")[0] for name in lengths}
            fits = roles <= {*NoiseGains._fields}
            allowed = "those of its schedules, by role, such as unknown.k"
        case kind if kind in TITLES:
            fits, allowed = not lengths, "none, they are among those of `also`"
        case kind:
            names = [field.name for field in fields(SCHEDULES[kind])]
            fits, allowed = lengths == dict.fromkeys(names, 1), f"{', '.join(names)}, one each"
    if not fits:
        raise ValueError(f"its numbers are {reprlib.repr(lengths)} by length; allowed: {allowed}")
    return found


StoredFilter = Annotated[Description, AfterValidator(_of_its_kind)]
"""A description with the numbers of its kind."""


def describe(candidate: Candidate, experiment: Experiment, evaluations: int) -> Description:
    """The description of a candidate of an experiment, as it is stored."""
    schedule, gain, also = candidate.schedule, candidate.gain, candidate.values_by_key()
    kind, numbers = experiment.filter.kind, dict[str, list[float]]()
    if gain is not None:
        kind = next(kind for kind, made in SCHEDULES.items() if isinstance(gain, made))
        numbers = _numbers_of(gain, experiment)
    if isinstance(schedule, NoiseGains | ObserverGains):
        there = role_controllers(experiment)
        for role, one in schedule._asdict().items():
            if one is not None and role != "gain":
                own = _numbers_of(one, there).items()
                numbers |= {f"{role}.{name}": values for name, values in own}
    return Description(kind, numbers, also, evaluations)


def _numbers_of(schedule: GainSchedule, experiment: Experiment) -> dict[str, list[float]]:
    """The numbers of a schedule by name."""
    arrays: dict[str, Any] = vars(schedule)
    if isinstance(schedule, FuzzyGain):
        space = parameter_space(experiment)
        arrays = {"k": space.vector(schedule.controller)[: len(PARAMETERS)]}
        if space.rules is None:
            arrays["rules"] = np.asarray(schedule.controller.rules)
    return {name: np.ravel(np.asarray(a, np.float64)).tolist() for name, a in arrays.items()}


def candidate_of(found: Description, experiment: Experiment) -> Candidate:
    """The candidate of a stored description, at an experiment's precision.

    Raises:
        ValueError: Its rule table is invalid, or was not searched in this experiment.
    """
    dtype = jnp.dtype(experiment.run.dtype)
    with jax.enable_x64(dtype == jnp.float64):
        of_roles = {name: values for name, values in found.numbers.items() if "." in name}
        schedule: Schedule | None = None
        roles = _of_roles(of_roles, experiment) if of_roles else {}
        if found.kind == "kalman" and roles:
            schedule = NoiseGains(**roles)
        elif found.kind not in TITLES:
            own = {name: values for name, values in found.numbers.items() if name not in of_roles}
            schedule = _schedule(found.kind, own, experiment)
            schedule = ObserverGains(schedule, **roles) if roles else schedule
        values = tuple(jnp.asarray(value, dtype) for value in found.also.values())
        return Candidate(schedule, values, tuple(found.also))


def _schedule(
    kind: str, numbers: Mapping[str, list[float]], experiment: Experiment
) -> GainSchedule:
    """A schedule from its numbers.

    Raises:
        ValueError: Its rule table is invalid, or was not searched in this experiment.
    """
    dtype = jnp.dtype(experiment.run.dtype)
    arrays = {name: jnp.asarray(values, dtype) for name, values in numbers.items()}
    if kind == "fuzzy":
        space = parameter_space(experiment)
        space = replace(space, rules=_rules_of(numbers, space))
        return space.schedule(arrays["k"])
    made: Any = KnotGain if kind == "clock" else SCHEDULES[kind]
    return made(**arrays if made is KnotGain else {name: a[0] for name, a in arrays.items()})


def _of_roles(
    numbers: Mapping[str, list[float]], experiment: Experiment
) -> dict[str, GainSchedule]:
    """The schedules of a Kalman filter's noises, or of an observer's belief, by role.

    Raises:
        ValueError: They are not those of the experiment.
    """
    section, by_role = experiment.filter, dict[str, dict[str, list[float]]]()
    for name, values in numbers.items():
        role, _, own = name.partition(".")
        by_role.setdefault(role, {})[own] = values
    kinds: Mapping[str, str] = getattr(section, "roles", {})
    if by_role.keys() != kinds.keys():
        allowed = ", ".join(kinds) or "none"
        raise ValueError(f"its schedules are {', '.join(by_role)}; allowed: {allowed}")
    for role, kind in kinds.items():
        lengths = {name: len(values) for name, values in by_role[role].items()}
        needed: dict[str, Any] = dict(config.SCHEDULE_NUMBERS[kind])
        if kind == "clock":  # a replayed schedule has more knots than one that is searched
            time = by_role[role].get("time", [])
            needed = dict.fromkeys(("time", *needed), max(1, len(time)))
            if not np.all(np.diff(time) > 0):
                raise ValueError(f"the times of {role} do not ascend; allowed: ascending times")
        if lengths != needed:
            raise ValueError(f"the numbers of {role} are {lengths} by length; allowed: {needed}")
    there = role_controllers(experiment)
    return {role: _schedule(kind, by_role[role], there) for role, kind in kinds.items()}


def described_filter(
    found: Description,
    experiment: Experiment,
    own: OwnFilter | None = None,
    sensors: Sensors | None = None,
) -> Filter:
    """The filter of a description.

    Args:
        found: The description.
        experiment: The experiment that it belongs to; its own numbers do not matter.
        own: The user's own filter, if the description is of one.
        sensors: How many vectors and landmarks it reads; by default those of the scenario.
    """
    schedule = candidate_of(found, experiment).schedule
    with jax.enable_x64(experiment.run.dtype == "float64"):
        filter = filter_of(config.with_tuned(experiment, found.also), own, sensors)
        own_schedule = isinstance(
            filter, Observer | KalmanFilter
        )  # a user's own filter has its own
        if own_schedule and schedule is not None:
            return replace(filter, schedule=schedule)
        return filter


def configured_filter(experiment: Experiment) -> Description:
    """The filter that an experiment has without any search.

    Raises:
        ArgumentError: Its schedule has no numbers.
    """
    section, values = experiment.filter, list(experiment.tuned.numbers)
    kinds: Mapping[str, str] = getattr(section, "roles", {})
    if isinstance(section, config.ObserverConfig):
        kinds = {"": section.schedule, **kinds}
    if kinds and (not values or experiment.fuzzy.rules == SEARCHED):
        needed = [
            ("" if length == 1 else f"{length} of ") + (f"{role}.{name}" if role else name)
            for role, kind in kinds.items()
            for name, length in config.SCHEDULE_NUMBERS[kind].items()
        ]
        refuse(
            f"tuned.numbers: none of a {title_of(kind_of(experiment))}, or rules that are searched",
            f"[tuned] numbers = [{', '.join(needed)}], or the folder of a run",
        )
    numbers: dict[str, list[float]] = {}
    for role, kind in kinds.items():
        before = f"{role}." if role else ""
        if kind == "clock":
            numbers[f"{before}time"] = knot_times(experiment.scenario.duration).tolist()
        for name, length in config.SCHEDULE_NUMBERS[kind].items():
            own, values = values[:length], values[length:]
            if kind == "fuzzy":
                with jax.enable_x64(experiment.run.dtype == "float64"):
                    space = parameter_space(role_controllers(experiment) if role else experiment)
                    k = space.checked(np.array(own))
                    own = np.asarray(k, np.float64).tolist()
            numbers[before + name] = own
    return Description(kind_of(experiment), numbers, dict(experiment.tuned.also), 0)


def tuned_experiment(experiment: Experiment, found: Description) -> Experiment:
    """An experiment with all numbers, and the rule table, that were tuned.

    Raises:
        ValueError: The rule table is invalid.
    """
    tuned = config.with_tuned(experiment, found.also)
    if found.kind == "fuzzy" and tuned.fuzzy.rules == SEARCHED:
        with jax.enable_x64(experiment.run.dtype == "float64"):
            rules = rule_table(_rules_of(found.numbers, parameter_space(experiment)))
        tuned = tuned.replace(**{"fuzzy.rules": rules})
    section = tuned.filter
    # Neither is a searched number: the table is in [fuzzy], the times of a clock are fixed.
    left = {"rules", *(f"{role}.time" for role in NoiseGains._fields)}
    scheduled = isinstance(section, config.ObserverConfig) and section.schedule == found.kind
    if scheduled or (found.kind == "kalman" and found.numbers):
        own = [value for name, each in found.numbers.items() if name not in left for value in each]
        return tuned.model_copy(update={"tuned": config.TunedConfig(numbers=tuple(own))})
    return tuned.model_copy(update={"tuned": config.TunedConfig()})


def _rules_of(stored: Mapping[str, list[float]], space: ParameterSpace) -> Rules:
    """The rule table of a stored controller: its own if the table was searched."""
    numbers = stored.get("rules", [])
    if space.rules is not None:
        if numbers:
            raise ValueError(f"rules = {numbers}; allowed: none, as the table was not searched")
        return space.rules
    if len(numbers) != RULES or not all(n in range(TERM_COUNT) for n in numbers):
        raise ValueError(
            f"rules = {numbers}; allowed: {RULES} whole numbers up to {TERM_COUNT - 1}"
        )
    whole = [int(n) for n in numbers]
    return tuple(tuple(whole[i : i + TERM_COUNT]) for i in range(0, RULES, TERM_COUNT))


def rules_text(rules: Rules) -> str:
    """The rule table that a search found, as text."""
    table = zip(reversed(config.TERMS), rule_table(rules), strict=True)
    rows = [[name, *row] for name, row in table]
    heads = ["Rules found: rate by rows, error by columns", *reversed(config.TERMS)]
    return text_table([heads, *rows])
