"""Baselines on recordings: constant gains, a Kalman filter, filters that are not searched.

Those that are searched are tuned on the same data as the filter: recordings, or the scenarios of a
run. The others are what a user has without a search, and filters of other libraries.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import jax

from posegsa import config, steps
from posegsa.judging.baselines import baselines, search_baselines
from posegsa.judging.description import configured_filter, describe
from posegsa.judging.evaluation import (
    CONSTANT,
    EKF,
    IMU_AS_IT_COMES,
    KALMAN_AS_IT_COMES,
    NOISES_FOUND,
)
from posegsa.judging.known_sensors import of_recordings
from posegsa.judging.on_recordings import OnRecordings, RecordingScore, score, scored
from posegsa.judging.other_filters import OTHER_FILTERS, installed, other_filter, readable
from posegsa.judging.result import Result
from posegsa.judging.tuned_kalman import kalman_experiment, tune_kalman
from posegsa.recordings.recording import Recording
from posegsa.search.population import TrackCost
from posegsa.search.problem import tuning_problem
from posegsa.search.recorded import DEGREES_PER_METRE, default_experiment, recorded_problem
from posegsa.search.run_search import run_search, tell_share
from posegsa.settings.fields import Section

Scores = dict[str, list[RecordingScore]]
"""Scores on each recording, by name of the filter."""


def judged_beside_baselines(
    result: Result,
    recordings: Sequence[Recording],
    training: Sequence[Recording],
    others: bool | None,
    cost: TrackCost | None = None,
) -> Result:
    """Judge a result and its baselines on the same recordings.

    Args:
        result: The filter to judge.
        recordings: Recordings to judge it on.
        training: Recordings to tune constant gains and the Kalman filter on. If empty, they are
            tuned on the scenarios of a result that was tuned on scenarios, else left out.
        others: Whether to run the `OTHER_FILTERS`; None where they can run.
        cost: The user's own cost, if the result was tuned with one.
    """
    before = result.on_recordings
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        its_own = scored(result.filter, result.experiment, recordings, result.own)
        if result.filter.kind == "imu":  # no other filter of posegsa reads these sensors
            baselines = {}
        elif training:
            baselines = _tuned_on(result, recordings, training)
        elif result.on_scenarios is not None and not (before and before.training):
            baselines = _tuned_on_scenarios(result, recordings, cost)
        else:
            baselines = {}
        baselines |= _others(others, recordings)
    judged = before
    if judged is None:
        known = of_recordings(recordings) if result.filter.kind == "imu" else None
        judged = OnRecordings(training=[], held_out=[], sensors=known)
    if [one.fingerprint for one in judged.held_out] == [one.fingerprint for one in its_own]:
        baselines = judged.baselines | baselines
    judged = replace(judged, held_out=its_own, baselines=baselines)
    return replace(result, on_recordings=judged)


def _tuned_on(
    result: Result, recordings: Sequence[Recording], training: Sequence[Recording]
) -> Scores:
    """Scores of constant gains and of a Kalman filter, both tuned on recordings."""
    experiment, found = result.experiment, {}
    weight = DEGREES_PER_METRE if result.search is None else result.search.position_weight
    weight = weight or DEGREES_PER_METRE
    if result.filter.kind != "constant":
        steps.begin("searching", about=CONSTANT)
        constant = config.override(
            _observer_on_recordings(experiment), ["filter.schedule=constant"]
        )
        problem = recorded_problem(constant, training, weight, strict=False)
        candidate = problem.space.candidate(run_search(problem, tell_share).search.best_position)
        description = describe(candidate, problem.experiment, constant.search.evaluations)
        found[CONSTANT] = scored(description, problem.experiment, recordings)
    steps.begin("searching", about=EKF)
    kalman = kalman_experiment(experiment, EKF)
    kalman = kalman.replace(**{"objective.simulated_share": 0.0})
    problem = recorded_problem(kalman, training, weight, strict=False)
    found[EKF] = scored(tune_kalman(problem), problem.experiment, recordings)
    return found


def _observer_on_recordings(experiment: config.Experiment) -> config.Experiment:
    """The experiment with an observer: its own, or that of `landmarks` for another filter."""
    if experiment.filter.kind == "observer":
        return experiment
    observer = config.load("landmarks")
    names = ("run", "scenario", "cost", "objective", "search")
    return observer.model_copy(update={name: getattr(experiment, name) for name in names})


def _tuned_on_scenarios(
    result: Result, recordings: Sequence[Recording], cost: TrackCost | None
) -> Scores:
    """Scores of constant gains and of a Kalman filter, both tuned on a result's scenarios."""
    assert result.on_scenarios is not None
    contenders = result.on_scenarios.evaluation.contenders
    known = {name: each.filter for name, each in contenders.items()}
    problem = tuning_problem(result.experiment, cost, result.own)
    possible = baselines(problem.experiment, result.filter)
    wanted = {name: possible[name] for name in (CONSTANT, EKF) if name in possible}
    lacking = {name: each for name, each in wanted.items() if name not in known}
    known |= search_baselines(problem, lacking)
    return {name: scored(known[name], each.experiment, recordings) for name, each in wanted.items()}


def _others(asked: bool | None, recordings: Sequence[Recording]) -> Scores:
    """Scores of other libraries' filters: all, none, or by default those that can run here."""
    names = list(OTHER_FILTERS) if asked else []
    if asked is None and all(map(readable, recordings)):
        names = list(filter(installed, OTHER_FILTERS))
    return {
        name: [score(one, other_filter(name, one)) for one in recordings]
        for name in steps.each("judging", names, str)
    }


def beside_what_was_not_searched(
    result: Result, training: Sequence[Recording], held_out: Sequence[Recording]
) -> Result:
    """A result, beside the filters that a user has without a search.

    They are what the recordings give, and the Kalman filter as it comes. One that is the result's
    own filter is left out.
    """
    plain = default_experiment(training)
    beside = {IMU_AS_IT_COMES if plain.filter.kind == "imu" else NOISES_FOUND: plain}
    if plain.filter.kind == "kalman":
        beside[KALMAN_AS_IT_COMES] = config.load("kalman")
    baselines, in_training = {}, {}
    for name, experiment in beside.items():
        if not _same_numbers(result.tuned.filter, experiment.filter):
            steps.begin("judging", about=name)
            filter = configured_filter(experiment)
            baselines[name] = scored(filter, experiment, held_out)
            in_training[name] = scored(filter, experiment, training)
    judged = result.on_recordings
    assert judged is not None
    judged = replace(judged, baselines=baselines, baselines_in_training=in_training)
    return replace(result, on_recordings=judged)


def _same_numbers(one: Section, other: Section) -> bool:
    """Whether two sections agree, but for rounding to single precision."""
    a, b = one.model_dump(), other.model_dump()
    return a.keys() == b.keys() and all(
        math.isclose(value, b[key], rel_tol=1e-6) if isinstance(value, float) else value == b[key]
        for key, value in a.items()
    )
