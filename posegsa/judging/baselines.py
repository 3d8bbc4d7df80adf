"""Baselines for a tuned filter: other schedules, tuned on its training scenarios at its budget.

Each schedule is searched with the run's optimiser and its number of evaluations. Differential
evolution replaces an optimiser that uses gradients or can't be compiled. Whatever was tuned beside
k1..k22 is tuned for each baseline too, so it has the filter, signal and weights that suit it.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa import config
from posegsa.judging.evaluation import (
    CONSTANT,
    OPEN_LOOP,
    RANDOM,
    REPLAYED,
    SCHEDULES,
    SMOOTH,
    SWITCH,
    Description,
    Kind,
)
from posegsa.judging.metrics import error_tracks
from posegsa.model.fuzzy import Rules
from posegsa.model.schedules import (
    ConstantGain,
    FuzzyGain,
    GainSchedule,
    KnotGain,
    SmoothGain,
    SwitchGain,
)
from posegsa.optimisers import Optimiser
from posegsa.search.build import TuningProblem, parameter_space, rule_table, search_space
from posegsa.search.candidates import Candidate, SimpleSpace
from posegsa.search.keys import keys
from posegsa.search.parameters import RULES, TERM_COUNT, ParameterSpace
from posegsa.search.population import ScenarioBatch, costs_by_scenario, over_scenarios
from posegsa.search.run import first_search, run_search, tell_share
from posegsa.words import text_table

CONSTANT_GAINS = 201
"""Number of gains that `best_constant` tries, evenly spaced over the controller's gain range."""
GAINS = (0.5, 200.0)
"""Range of a baseline's gain [1/s]; it is extended to the controller's maximum."""
LEAST_GAIN = 1e-3
"""Lowest gain of a baseline [1/s] if the controller's range starts at 0."""
KNOTS = 16
"""Number of knots of the open-loop gains."""
REPLAYED_KNOTS = 300
"""Maximum number of knots of the replayed gains."""


def describe(candidate: Candidate, space: ParameterSpace, evaluations: int) -> Description:
    """The description of a candidate, as it is stored."""
    schedule = candidate.schedule
    kinds: dict[type, Kind] = {type_: kind for kind, type_ in SCHEDULES.items()}
    kind = kinds.get(type(schedule), "fuzzy")
    arrays: dict[str, Any] = vars(schedule)
    if isinstance(schedule, FuzzyGain):
        arrays = {"k": space.vector(schedule.controller)[: len(config.PARAMETERS)]}
        if space.rules is None:
            arrays["rules"] = np.asarray(schedule.controller.rules)
    numbers = {name: np.ravel(np.asarray(a, np.float64)).tolist() for name, a in arrays.items()}
    return Description(kind, numbers, candidate.values_by_key(), evaluations)


def candidate_of(found: Description, space: ParameterSpace) -> Candidate:
    """The candidate of a stored description; not for a Kalman filter.

    Raises:
        ValueError: Its rule table is invalid, or was not searched in this space.
    """
    dtype = space.lower.dtype
    if found.kind == "fuzzy":
        space = replace(space, rules=_rules_of(found, space))
    numbers = {name: jnp.asarray(values, dtype) for name, values in found.numbers.items()}
    if found.kind == "fuzzy":
        schedule: GainSchedule = space.schedule(numbers["k"])
    elif found.kind == "open loop":
        schedule = KnotGain(**numbers)
    else:
        schedule = SCHEDULES[found.kind](**{name: a[0] for name, a in numbers.items()})
    values = tuple(jnp.asarray(value, dtype) for value in found.also.values())
    return Candidate(schedule, values, tuple(found.also))


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


def tuned_experiment(experiment: config.Experiment, found: Description) -> config.Experiment:
    """An experiment with the numbers and the rule table that were tuned beside k1..k22.

    Raises:
        ValueError: The rule table is invalid.
    """
    tuned = config.with_tuned(experiment, found.also)
    if found.kind == "fuzzy" and tuned.fuzzy.rules == config.SEARCHED:
        with jax.enable_x64(experiment.run.dtype == "float64"):
            rules = rule_table(_rules_of(found, parameter_space(experiment)))
        tuned = tuned.replace(**{"fuzzy.rules": rules})
    return tuned


def rules_text(rules: Rules) -> str:
    """The rule table that a search found, as text."""
    table = zip(reversed(config.TERMS), rule_table(rules), strict=True)
    rows = [[name, *row] for name, row in table]
    heads = ["Rules found: rate by rows, error by columns", *reversed(config.TERMS)]
    return text_table([heads, *rows])


def best_constant(problem: TuningProblem) -> Candidate:
    """The constant gain of lowest cost, on a grid of CONSTANT_GAINS over the controller's range.

    There is one number to find and the cost is flat near its minimum: a finer grid gains nothing.
    """
    low, high = problem.experiment.parameters.gain_range
    training = problem.training
    offset = problem.experiment.fuzzy.offset
    gains = jnp.linspace(offset + low, offset + high, CONSTANT_GAINS, dtype=training.dtype)
    by_scenario = costs_by_scenario(Candidate(ConstantGain(gains)), training, None, problem.cost)
    costs = np.asarray(over_scenarios(by_scenario, problem.experiment.objective))
    return Candidate(
        ConstantGain(gains[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))])
    )


def _constant(vector: Array) -> GainSchedule:
    return ConstantGain(jnp.exp(vector[0]))


def _switch(vector: Array) -> GainSchedule:
    before, after, time = jnp.exp(vector[:3])
    return SwitchGain(before, after, time, learning_time=vector[3])


def _smooth(vector: Array) -> GainSchedule:
    low, high, half = jnp.exp(vector)
    return SmoothGain(low, high, half)


def _open_loop(end: float, log_gain: Array) -> GainSchedule:
    return KnotGain(jnp.asarray(knot_times(end), log_gain.dtype), log_gain)


def knot_times(end: float) -> np.ndarray:
    """Times (KNOTS,) of the open-loop gains' knots [s]: dense in the transient, then even."""
    dense, turn = KNOTS // 2, min(2.0, 0.5 * end)
    early = np.geomspace(0.03 * turn, turn, dense)
    return np.concatenate([[0.0], early, np.linspace(turn, end, KNOTS - dense)[1:]])


Ends = tuple[float, float]


def schedule_space(kind: str, experiment: config.Experiment) -> SimpleSpace:
    """The search space of one kind of schedule for an experiment.

    Gains are searched by their logarithm, over GAINS and the controller's range. Times of a switch
    go up to half of a scenario. The scaled error at half gain goes from 0.003 to 1.
    """
    end = experiment.scenario.duration
    offset, (low, high) = experiment.fuzzy.offset, experiment.parameters.gain_range
    least = min(GAINS[0], max(offset + low, LEAST_GAIN))
    gain = (math.log(least), math.log(max(GAINS[1], offset + high)))
    half = (math.log(0.003), 0.0)
    switch = (math.log(0.05), math.log(max(0.5 * end, 0.05)))
    # Without estimated biases there is nothing to switch on later.
    learning = (0.0, 0.5 * end if experiment.filter.vector_bias == "estimated" else 0.0)
    boxes: dict[str, tuple[list[Ends], Callable[[Array], GainSchedule]]] = {
        "constant": ([gain], _constant),
        "switch": ([gain, gain, switch, learning], _switch),
        "smooth": ([gain, gain, half], _smooth),
        "open loop": ([gain] * KNOTS, _at(end)),
    }
    bounds, make = boxes[kind]
    lower, upper = (jnp.asarray(ends, experiment.run.dtype) for ends in zip(*bounds, strict=True))
    return SimpleSpace(lower, upper, make)


_AT: dict[float, Callable[[Array], GainSchedule]] = {}


def _at(end: float) -> Callable[[Array], GainSchedule]:
    """`_open_loop` up to a time; always the same function, so that JAX reuses its program."""
    return _AT.setdefault(end, partial(_open_loop, end))


def search_baseline(problem: TuningProblem, kind: str) -> Candidate:
    """Search a kind of schedule, with whatever is tuned beside it, on the training scenarios."""
    experiment = searchable(problem.experiment)
    one = problem._replace(
        experiment=experiment,
        space=search_space(experiment, schedule_space(kind, experiment)),
    )
    begin = first_search(one, keys(experiment.run.seed).baselines)
    found = run_search(one, tell_share, search=begin)
    return one.space.candidate(found.search.best_position)


def searchable(experiment: config.Experiment) -> config.Experiment:
    """The experiment, with an optimiser that can search any schedule in a compiled loop."""
    own: Optimiser = experiment.search
    if own.on_host or any(phase.wants_gradients for phase in own.phases):
        agents = max(own.agents, 4)  # differential evolution needs 4
        iterations = max(1, own.evaluations // agents)
        size = [f"search.agents={agents}", f"search.iterations={iterations}"]
        return config.override(experiment, ["search.optimiser=de", *size])
    return experiment


def replayed(problem: TuningProblem, tuned: Candidate) -> Candidate:
    """The tuned filter's gains over time, replayed without feedback.

    They are the geometric mean over the training scenarios. The tuned schedule's advantage over
    this baseline is the benefit of feedback from the error.
    """
    training: ScenarioBatch = problem.training
    gain = np.asarray(error_tracks(tuned, training).gain, np.float64)
    time = np.asarray(training.samples.time[0], np.float64)
    kept = np.unique(np.linspace(0, len(time) - 1, REPLAYED_KNOTS).round().astype(int))
    with np.errstate(divide="ignore", invalid="ignore"):
        log_gain = np.mean(np.log(np.maximum(gain[:, kept], 1e-3)), axis=0)
    schedule = KnotGain(*(jnp.asarray(a, training.dtype) for a in (time[kept], log_gain)))
    return Candidate(schedule, tuned.values, tuned.keys)


def random_search(problem: TuningProblem) -> Candidate:
    """The best controller that random search finds with the run's number of evaluations."""
    # An override by name: the library of the run's own optimiser may not be installed here.
    experiment = config.override(problem.experiment, ["search.optimiser=random_search"])
    one = problem._replace(experiment=experiment)
    return one.space.candidate(run_search(one, tell_share).search.best_position)


def schedule_baselines(
    problem: TuningProblem, tuned: Candidate
) -> dict[str, Callable[[], Candidate]]:
    """Functions that find each baseline that is a gain schedule, by name."""
    found: dict[str, Callable[[], Candidate]] = {
        name: partial(search_baseline, problem, kind)
        for name, kind in (
            (CONSTANT, "constant"),
            (SWITCH, "switch"),
            (SMOOTH, "smooth"),
            (OPEN_LOOP, "open loop"),
        )
    }
    return found | {
        REPLAYED: partial(replayed, problem, tuned),
        RANDOM: partial(random_search, problem),
    }
