"""Baselines for a tuned filter: other filters, tuned on its training scenarios at its budget.

Each schedule is searched with the run's optimiser and its number of evaluations. Differential
evolution replaces an optimiser that uses gradients. All numbers tuned in addition to k1..k22 are
tuned for each baseline too, so it has the filter, signal and weights that suit it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa import config, steps
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.filters.observer import Observer, ObserverGains
from posegsa.judging.description import (
    TITLES,
    Description,
    candidate_of,
    configured_filter,
    describe,
)
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CONSTANT,
    OPEN_LOOP,
    RANDOM,
    REPLAYED,
    SMOOTH,
    SWITCH,
    UNTUNED,
)
from posegsa.judging.metrics import error_tracks, estimates_on
from posegsa.judging.tuned_kalman import VARIANTS, kalman_experiment, tune_kalman
from posegsa.judging.untuned import untuned_kalman
from posegsa.model.schedules import ConstantGain, KnotGain, ScheduleInputs
from posegsa.optimisers import Optimiser
from posegsa.search.candidates import Candidate, Schedule
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import keys, training_keys
from posegsa.search.population import ScenarioBatch, costs_by_scenario, over_scenarios
from posegsa.search.problem import TuningProblem
from posegsa.search.run_search import first_search, run_search, tell_share
from posegsa.search.schedule_spaces import schedule_space
from posegsa.search.search_spaces import observer_space, search_space

CONSTANT_GAINS = 201
"""Number of gains that `best_constant` tries, evenly spaced over the controller's gain range."""
REPLAYED_KNOTS = 300
"""Of replayed gains: how many knots are even in time, and again even in its logarithm."""


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


def search_baseline(problem: TuningProblem, kind: str) -> Candidate:
    """Search a kind of gain schedule, and what is tuned with it, on the training scenarios."""
    experiment = searchable(problem.experiment)
    one = problem._replace(
        experiment=experiment,
        space=search_space(
            experiment, observer_space(schedule_space(kind, experiment), experiment)
        ),
    )
    begin = first_search(one, keys(experiment.run.seed).baselines)
    found = run_search(one, tell_share, search=begin)
    return one.space.candidate(found.search.best_position)


def searchable(experiment: config.Experiment) -> config.Experiment:
    """The experiment, with an optimiser that can search any schedule: one without gradients."""
    optimiser: Optimiser = experiment.search
    if any(phase.wants_gradients for phase in optimiser.phases):
        agents = max(optimiser.agents, 4)  # differential evolution needs 4
        iterations = max(1, optimiser.evaluations // agents)
        size = [f"search.agents={agents}", f"search.iterations={iterations}"]
        return config.override(experiment, ["search.optimiser=de", *size])
    return experiment


def replayed(problem: TuningProblem, tuned: Candidate) -> Candidate:
    """The tuned filter's gains over time, replayed without feedback.

    They are means over the training scenarios: of an observer's gains the geometric mean, of the
    outputs of a Kalman filter's schedule `unknown` the arithmetic mean, as these are logarithms of
    a factor. Belief stays as it is. The tuned schedule's advantage over this baseline is the
    benefit of feedback from the error.
    """
    training: ScenarioBatch = problem.training
    schedule, time = tuned.schedule, np.asarray(training.samples.time[0], np.float64)
    even = np.linspace(0, len(time) - 1, REPLAYED_KNOTS)
    dense = np.geomspace(1, len(time), REPLAYED_KNOTS) - 1  # close together in the transient
    kept = np.unique(np.concatenate([even, dense]).round().astype(int))
    if isinstance(schedule, NoiseGains):
        log_gain = np.log(_mean_output(tuned, training)[kept])
    else:
        gain = np.asarray(error_tracks(tuned, training).gain, np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            log_gain = np.mean(np.log(np.maximum(gain[:, kept], 1e-3)), axis=0)
    knots = KnotGain(*(jnp.asarray(a, training.dtype) for a in (time[kept], log_gain)))
    made: Schedule = knots
    if isinstance(schedule, NoiseGains):
        made = schedule._replace(unknown=knots)
    elif isinstance(schedule, ObserverGains):
        made = schedule._replace(gain=knots)
    return replace(tuned, schedule=made)


def _mean_output(tuned: Candidate, training: ScenarioBatch) -> np.ndarray:
    """(N,) outputs of the schedule `unknown`, mean over the scenarios that have started."""
    schedule, time = cast(Any, tuned.schedule).unknown, np.asarray(training.samples.time)

    @jax.jit
    def output(error: Array, rate: Array, time: Array) -> Array:
        # A controller with gaps between its terms holds its last output where no rule fires. Here
        # it is the middle one, as samples are not run one after another.
        last = jnp.broadcast_to(schedule.initial_gain(), error.shape)
        return schedule.prepare()(ScheduleInputs(error, rate, time, last)).gain

    total = count = np.zeros(time.shape[1])
    begin = np.zeros(len(time)) if training.begin is None else np.asarray(training.begin)
    for i in range(len(time)):
        one, started = estimates_on(tuned, training, i), time[i] >= begin[i]
        total = total + np.where(started, output(one.error, one.rate, time[i]), 0.0)
        count = count + started
    return np.where(count > 0, total / np.maximum(count, 1), 1.0)  # 1 changes no noise


def random_search(problem: TuningProblem) -> Description:
    """The best controller that random search finds with the run's number of evaluations."""
    own = problem.experiment
    # An override by name: the library of the run's own optimiser may not be installed here.
    one = problem._replace(experiment=config.override(own, ["search.optimiser=random_search"]))
    found = run_search(one, tell_share).search.best_position
    return describe(one.space.candidate(found), own, own.search.evaluations)


class Baseline(NamedTuple):
    """A filter that can be compared with a tuned one on the same scenarios."""

    experiment: config.Experiment
    """The experiment that describes the filter."""
    search: Callable[[TuningProblem], Description] | None
    """Finds the filter on the training scenarios, in the form of its experiment; None for a filter
    that is taken as configured."""


def baselines(experiment: config.Experiment, tuned: Description) -> dict[str, Baseline]:
    """The filters that can be compared with a tuned one, by name.

    Those that follow from the tuned filter (its numbers before the tuning, its gains replayed, a
    random search for it), gain schedules of the observer, and Kalman filters. The observer is that
    of the experiment, or the default one where the experiment has another filter.
    """
    found, observer = dict[str, Baseline](), observer_experiment(experiment)
    if tuned.kind in TITLES:
        found[AS_CONFIGURED] = Baseline(experiment, _as_configured)
    for name, kind in _SCHEDULES.items():
        if kind != tuned.kind:
            found[name] = Baseline(observer, partial(_schedule, kind=kind))
    if tuned.kind in ("fuzzy", "smooth"):
        found[REPLAYED] = Baseline(experiment, partial(_replayed, tuned=tuned, of=experiment))
    section = experiment.filter
    if isinstance(section, config.KalmanConfig) and section.unknown in ("fuzzy", "smooth", "ramp"):
        clock = experiment.replace(**{"filter.unknown": "clock", "tuned": config.TunedConfig()})
        found[REPLAYED] = Baseline(clock, partial(_replayed, tuned=tuned, of=experiment))
    found[RANDOM] = Baseline(experiment, random_search)
    for name in VARIANTS:
        found[name] = Baseline(kalman_experiment(experiment, name), tune_kalman)
    found[UNTUNED] = Baseline(untuned_kalman(experiment), None)
    return found


_SCHEDULES = {CONSTANT: "constant", SWITCH: "switch", SMOOTH: "smooth", OPEN_LOOP: "open loop"}


def _as_configured(problem: TuningProblem) -> Description:
    return describe(Candidate(), problem.experiment, 0)


def _schedule(problem: TuningProblem, kind: str) -> Description:
    experiment = problem.experiment
    return describe(search_baseline(problem, kind), experiment, experiment.search.evaluations)


def _replayed(problem: TuningProblem, tuned: Description, of: config.Experiment) -> Description:
    return describe(replayed(problem, candidate_of(tuned, of)), problem.experiment, 0)


def search_baselines(
    problem: TuningProblem, some: Mapping[str, Baseline]
) -> dict[str, Description]:
    """The filters of baselines, each searched on a problem's training scenarios."""
    problems, found = [problem], {}
    for name in steps.each("searching", list(some), str):
        experiment, search = some[name]
        if search is None:
            found[name] = configured_filter(experiment)
            continue
        there = next((one for one in problems if one.experiment == experiment), None)
        if there is None:
            there = variant_of(problem, experiment)
            problems.append(there)
        found[name] = search(there)
    return found


def observer_experiment(experiment: config.Experiment) -> config.Experiment:
    """The experiment with an observer: its own, or the default one in place of another filter."""
    if experiment.filter.kind == "observer":
        return experiment
    return config.override(experiment, ["filter.kind=observer"])


def variant_of(problem: TuningProblem, experiment: config.Experiment) -> TuningProblem:
    """A problem's training scenarios for the filter of another experiment."""
    run = experiment.run
    training_of = training_keys(run.seed, run.training_scenarios)
    training = batch_for(problem.training, problem.experiment, experiment, training_of)
    space = search_space(experiment)
    return problem._replace(experiment=experiment, training=training, space=space, own=None)


def batch_for(
    batch: ScenarioBatch,
    before: config.Experiment,
    experiment: config.Experiment,
    scenario_keys: Array,
) -> ScenarioBatch:
    """Scenarios of a batch, which are those of the experiment `before`, for another experiment.

    Only filter and start may differ. A Kalman filter reads the samples that were made for another,
    or for an observer that learns the vectors' biases. For any other filter, and for another start,
    they are drawn again, by their keys.
    """
    filter, made_for = filter_of(experiment), batch.filter
    if experiment.scenario.start != before.scenario.start:
        return scenario_batch(experiment, scenario_keys, filter)
    one_by_one = isinstance(made_for, Observer) and made_for.settings.vector_bias is not None
    if isinstance(filter, KalmanFilter) and (one_by_one or isinstance(made_for, KalmanFilter)):
        return batch._replace(filter=filter)
    return scenario_batch(experiment, scenario_keys, filter)
