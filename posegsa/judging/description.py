"""A filter as it is stored: its kind and its numbers. From there and back to the filter."""

import reprlib
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Annotated, Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import AfterValidator, Field

from posegsa import config
from posegsa.arguments import refuse
from posegsa.config import PARAMETERS, SEARCHED, Experiment
from posegsa.filters.base import Filter
from posegsa.filters.observer import Observer
from posegsa.model.fuzzy import Rules
from posegsa.model.schedules import (
    ConstantGain,
    FuzzyGain,
    GainSchedule,
    KnotGain,
    SmoothGain,
    SwitchGain,
)
from posegsa.search.build import OwnFilter, Sensors, filter_of, parameter_space, rule_table
from posegsa.search.candidates import Candidate
from posegsa.search.parameters import RULES, TERM_COUNT, ParameterSpace
from posegsa.settings.fields import Number
from posegsa.words import text_table

Kind = Literal["fuzzy", "constant", "switch", "smooth", "open loop", "kalman", "imu", "own"]
"""The observer by its gain schedule, another filter of posegsa, or a user's own."""
SCHEDULES: dict[Kind, type] = {
    "constant": ConstantGain,
    "switch": SwitchGain,
    "smooth": SmoothGain,
    "open loop": KnotGain,
}
"""The types of schedules without a controller, by the kind of their `Description`."""
TITLES: Mapping[Kind, str] = {
    "kalman": "Kalman filter",
    "imu": "filter for inertial sensors",
    "own": "filter of the user's own",
}
"""Kinds that are not called a gain."""


class Description(NamedTuple):
    """A filter as it is stored, by its own numbers."""

    kind: Kind
    numbers: dict[str, list[Number]]
    """Of the schedule, by name; one number is a list of one. Empty where there is no schedule."""
    also: dict[str, Number]
    """What else was tuned, by key of the configuration; the noises of a Kalman filter."""
    evaluations: Annotated[int, Field(ge=0)]
    """Evaluations of the search that found it; 0 where none was needed."""

    @property
    def title(self) -> str:
        """What it is called in a sentence."""
        return TITLES.get(self.kind, f"{self.kind} gain")


def _of_its_kind(found: Description) -> Description:
    """A description that was read, if it has the numbers that filters of its kind have."""
    lengths = {name: len(values) for name, values in found.numbers.items()}
    match found.kind:
        case "fuzzy":
            # A rule table is looked at where one sees whether it was searched (`candidate_of`).
            own = {name: length for name, length in lengths.items() if name != "rules"}
            fits, allowed = own == {"k": len(PARAMETERS)}, f"k, of length {len(PARAMETERS)}"
        case "open loop":
            time = found.numbers.get("time", [])
            same = lengths == dict.fromkeys(("time", "log_gain"), max(1, len(time)))
            fits, allowed = same and bool(np.all(np.diff(time) > 0)), "ascending time, and log_gain"
        case "kalman" | "imu" | "own":
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
    schedule, also = candidate.schedule, candidate.values_by_key()
    if schedule is None:
        kind = cast(Kind, experiment.filter.kind)
        return Description(kind, {}, also, evaluations)
    kinds: dict[type, Kind] = {type_: kind for kind, type_ in SCHEDULES.items()}
    kind = kinds.get(type(schedule), "fuzzy")
    arrays: dict[str, Any] = vars(schedule)
    if isinstance(schedule, FuzzyGain):
        space = parameter_space(experiment)
        arrays = {"k": space.vector(schedule.controller)[: len(PARAMETERS)]}
        if space.rules is None:
            arrays["rules"] = np.asarray(schedule.controller.rules)
    numbers = {name: np.ravel(np.asarray(a, np.float64)).tolist() for name, a in arrays.items()}
    return Description(kind, numbers, also, evaluations)


def candidate_of(found: Description, experiment: Experiment) -> Candidate:
    """The candidate of a stored description, at an experiment's precision.

    Raises:
        ValueError: Its rule table is invalid, or was not searched in this experiment.
    """
    dtype = jnp.dtype(experiment.run.dtype)
    with jax.enable_x64(dtype == jnp.float64):
        numbers = {name: jnp.asarray(values, dtype) for name, values in found.numbers.items()}
        schedule: GainSchedule | None = None
        if found.kind == "fuzzy":
            space = parameter_space(experiment)
            space = replace(space, rules=_rules_of(found, space))
            schedule = space.schedule(numbers["k"])
        elif found.kind == "open loop":
            schedule = KnotGain(**numbers)
        elif found.kind in SCHEDULES:
            schedule = SCHEDULES[found.kind](**{name: a[0] for name, a in numbers.items()})
        values = tuple(jnp.asarray(value, dtype) for value in found.also.values())
        return Candidate(schedule, values, tuple(found.also))


def described_filter(
    found: Description,
    experiment: Experiment,
    own: OwnFilter | None = None,
    sensors: Sensors | None = None,
) -> Filter:
    """The filter of a description.

    Args:
        found: Its numbers.
        experiment: The experiment that it is of, whatever its numbers.
        own: The user's own filter, where it is one.
        sensors: How many vectors and landmarks it reads; by default those of the scenario.
    """
    schedule = candidate_of(found, experiment).schedule
    with jax.enable_x64(experiment.run.dtype == "float64"):
        filter = filter_of(config.with_tuned(experiment, found.also), own, sensors)
        if isinstance(filter, Observer) and schedule is not None:  # one's own brings its own
            return replace(filter, schedule=schedule)
        return filter


def configured_filter(experiment: Experiment) -> Description:
    """The filter that an experiment has without any search.

    Raises:
        ArgumentError: Its schedule has no numbers.
    """
    section, also = experiment.filter, dict(experiment.tuned.also)
    numbers = list(experiment.tuned.numbers)
    if not isinstance(section, config.ObserverConfig):
        return Description(cast(Kind, section.kind), {}, also, 0)
    if not numbers or experiment.fuzzy.rules == SEARCHED:
        refuse(
            f"tuned.numbers: none of a {section.schedule} gain, or rules that are searched",
            "a configuration with the numbers of a tuning, or the folder of a run",
        )
    if section.schedule == "fuzzy":
        with jax.enable_x64(experiment.run.dtype == "float64"):
            space = parameter_space(experiment)
            k = np.asarray(space.checked(np.array(numbers)), np.float64)
        return Description("fuzzy", {"k": k.tolist()}, also, 0)
    names = (field.name for field in fields(SCHEDULES[section.schedule]))
    pairs = zip(names, numbers, strict=True)
    return Description(section.schedule, {name: [value] for name, value in pairs}, also, 0)


def tuned_experiment(experiment: Experiment, found: Description) -> Experiment:
    """An experiment with all numbers, and the rule table, that were tuned.

    Raises:
        ValueError: The rule table is invalid.
    """
    tuned = config.with_tuned(experiment, found.also)
    if found.kind == "fuzzy" and tuned.fuzzy.rules == SEARCHED:
        with jax.enable_x64(experiment.run.dtype == "float64"):
            rules = rule_table(_rules_of(found, parameter_space(experiment)))
        tuned = tuned.replace(**{"fuzzy.rules": rules})
    section = tuned.filter
    if isinstance(section, config.ObserverConfig) and section.schedule == found.kind:
        own = [value for name, each in found.numbers.items() if name != "rules" for value in each]
        return tuned.model_copy(update={"tuned": config.TunedConfig(numbers=tuple(own))})
    return tuned.model_copy(update={"tuned": config.TunedConfig()})


def _rules_of(found: Description, space: ParameterSpace) -> Rules:
    """The rule table of a stored controller: its own if the table was searched."""
    numbers = found.numbers.get("rules", [])
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
