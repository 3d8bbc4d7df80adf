"""Baselines on recordings: constant gains, a Kalman filter, filters of other libraries.

Baselines are tuned on the same data as the filter: recordings, or the scenarios of a run.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax

from posegsa import config, steps
from posegsa.filters.base import sensors_of
from posegsa.judging.baselines import baselines
from posegsa.judging.description import Description, describe, described_filter
from posegsa.judging.evaluation import CONSTANT, EKF
from posegsa.judging.judge import own_score
from posegsa.judging.on_recordings import OnRecordings, RecordingScore, score
from posegsa.judging.other_filters import OTHER_FILTERS, other_filter, readable
from posegsa.judging.result import Result
from posegsa.judging.tuned_kalman import kalman_experiment, tune_kalman
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter
from posegsa.search.population import TrackCost
from posegsa.search.problem import tuning_problem
from posegsa.search.recorded import DEGREES_PER_METRE, recorded_problem
from posegsa.search.run_search import run_search, tell_share

Scores = dict[str, list[RecordingScore]]
"""Scores on each recording, by name of the filter."""


def judged_beside_baselines(
    result: Result,
    recordings: Sequence[Recording],
    training: Sequence[Recording],
    others: Sequence[str],
    cost: TrackCost | None = None,
) -> Result:
    """Judge a result and its baselines on the same recordings.

    Args:
        result: The filter to judge.
        recordings: Recordings to judge it on.
        training: Recordings to tune constant gains and the Kalman filter on. If empty, they are
            tuned on the scenarios of a result that was tuned on scenarios, else left out.
        others: Names of the `OTHER_FILTERS` to run.
        cost: The user's own cost, if the result was tuned with one.
    """
    before = result.on_recordings
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        own = [own_score(result, one) for one in recordings]
        if result.filter.kind == "imu":  # no other filter of posegsa reads these sensors
            baselines = {}
        elif training:
            baselines = _tuned_on(result, recordings, training)
        elif result.on_scenarios is not None and not (before and before.training):
            baselines = _tuned_on_scenarios(result, recordings, cost)
        else:
            baselines = {}
        baselines |= _other_scores(others, recordings)
    judged = before or OnRecordings(training=[], held_out=[])
    if [one.fingerprint for one in judged.held_out] == [one.fingerprint for one in own]:
        baselines = judged.baselines | baselines
    judged = replace(judged, held_out=own, baselines=baselines)
    return replace(result, on_recordings=judged)


def _tuned_on(
    result: Result, recordings: Sequence[Recording], training: Sequence[Recording]
) -> Scores:
    """Scores of constant gains and of a Kalman filter, both tuned on recordings."""
    own, found = result.experiment, {}
    weight = DEGREES_PER_METRE if result.search is None else result.search.position_weight
    weight = weight or DEGREES_PER_METRE
    if result.filter.kind != "constant":
        steps.begin("searching", about=CONSTANT)
        constant = config.override(_observer_on_recordings(own), ["filter.schedule=constant"])
        problem = recorded_problem(constant, training, weight, strict=False)
        candidate = problem.space.candidate(run_search(problem, tell_share).search.best_position)
        description = describe(candidate, problem.experiment, constant.search.evaluations)
        found[CONSTANT] = _scores(description, problem.experiment, recordings)
    steps.begin("searching", about=EKF)
    kalman = kalman_experiment(own, vector_biases=False)
    kalman = kalman.replace(**{"objective.simulated_share": 0.0})
    problem = recorded_problem(kalman, training, weight, strict=False)
    found[EKF] = _scores(tune_kalman(problem), problem.experiment, recordings)
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
    possible, found = baselines(problem, result.filter), {}
    for name in (CONSTANT, EKF):
        if name not in possible:
            continue
        if name not in known:
            steps.begin("searching", about=name)
            known[name] = possible[name].search()
        found[name] = _scores(known[name], possible[name].experiment, recordings)
    return found


def _scores(
    found: Description, experiment: config.Experiment, recordings: Sequence[Recording]
) -> list[RecordingScore]:
    """The scores of a filter of an experiment on recordings."""
    scores = []
    for one in recordings:
        filter = described_filter(found, experiment, None, sensors_of(one.measurements))
        scores.append(score(one, run_filter(filter, one)))
    return scores


def _other_scores(names: Sequence[str], recordings: Sequence[Recording]) -> Scores:
    found: Scores = {}
    for name in names:
        steps.begin("judging", about=name)
        found[name] = [score(one, other_filter(name, one)) for one in recordings]
    return found


def others_for(recordings: Sequence[Recording]) -> list[str]:
    """Names of other libraries' filters, if the recordings have the signals that they need."""
    return list(OTHER_FILTERS) if all(map(readable, recordings)) else []
