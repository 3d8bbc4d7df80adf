"""Baselines on recordings: constant gains, a Kalman filter, filters of other libraries.

Baselines are tuned on the same data as the filter: recordings, or the scenarios of a run.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax

from posegsa import steps
from posegsa.judging.evaluation import CONSTANT, EKF, Description
from posegsa.judging.kalman import tune_kalman
from posegsa.judging.other_filters import OTHER_FILTERS, other_filter, readable
from posegsa.judging.recorded import (
    RecordingResult,
    RecordingScore,
    judge_on_recordings,
    score,
    tuned_on_scenarios,
)
from posegsa.judging.recorded_kalman import recorded_kalman_estimates, tune_recorded_kalman
from posegsa.judging.result import TuneResult
from posegsa.recordings.recording import Recording
from posegsa.search.build import scenario
from posegsa.search.population import TrackCost
from posegsa.search.recorded import recorded_problem
from posegsa.search.run import run_search, tell_share

Scores = dict[str, list[RecordingScore]]
"""Scores on each recording, by name of the filter."""


def judged_beside_baselines(
    result: RecordingResult,
    recordings: Sequence[Recording],
    training: Sequence[Recording],
    others: Sequence[str],
) -> RecordingResult:
    """Judge a result and its baselines on the same recordings.

    Args:
        result: The filter to judge.
        recordings: Recordings to judge it on.
        training: Recordings that constant gains and the Kalman filter are tuned on; if empty, both
            are left out.
        others: Names of the `OTHER_FILTERS` to run.
    """
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        own = _scores(result, recordings)
        baselines: Scores = {}
        if training:
            if result.filter.kind != "constant":
                steps.begin("searching", about=CONSTANT)
                baselines[CONSTANT] = _constant(result, recordings, training)
            steps.begin("searching", about=EKF)
            noises = tune_recorded_kalman(result.experiment, training, result.position_weight)
            baselines[EKF] = _kalman_scores(noises, result, recordings)
        baselines |= _other_scores(others, recordings)
    return replace(result, held_out=own, baselines=baselines)


def run_beside_baselines(
    run: TuneResult,
    recordings: Sequence[Recording],
    others: Sequence[str],
    cost: TrackCost | None = None,
) -> RecordingResult:
    """Judge the filter of a run on recordings, with baselines tuned on the run's scenarios.

    Args:
        run: The run whose tuned filter and best constant gains are judged.
        recordings: Recordings to judge them on.
        others: Names of the `OTHER_FILTERS` to run.
        cost: The user's own cost, if the run was tuned with one.
    """
    experiment = run.experiment
    with jax.enable_x64(experiment.run.dtype == "float64"):
        known = {name: each.filter for name, each in run.evaluation.contenders.items()}
        result, constant = tuned_on_scenarios(run), tuned_on_scenarios(run, known[CONSTANT])
        own = _scores(result, recordings)
        baselines: Scores = {CONSTANT: _scores(constant, recordings)}
        if EKF not in known:
            steps.begin("searching", about=EKF)
            known[EKF] = tune_kalman(
                experiment, scenario(experiment), vector_biases=False, cost=cost
            )
        baselines[EKF] = _kalman_scores(known[EKF], result, recordings)
        baselines |= _other_scores(others, recordings)
    return replace(result, held_out=own, baselines=baselines)


def _scores(result: RecordingResult, recordings: Sequence[Recording]) -> list[RecordingScore]:
    return [score(one, result.estimate(one)) for one in recordings]


def _other_scores(names: Sequence[str], recordings: Sequence[Recording]) -> Scores:
    found: Scores = {}
    for name in names:
        steps.begin("judging", about=name)
        found[name] = [score(one, other_filter(name, one)) for one in recordings]
    return found


def others_for(recordings: Sequence[Recording]) -> list[str]:
    """Names of other libraries' filters, if the recordings have the signals that they need."""
    return list(OTHER_FILTERS) if all(map(readable, recordings)) else []


def _constant(
    result: RecordingResult, recordings: Sequence[Recording], training: Sequence[Recording]
) -> list[RecordingScore]:
    """Scores of the best constant gain, tuned with the same numbers beside it."""
    weight = result.position_weight
    problem = recorded_problem(result.experiment, training, "constant", weight, strict=False)
    found = run_search(problem, tell_share)
    judged = judge_on_recordings(problem, found, weight, [], recordings)
    return judged.held_out


def _kalman_scores(
    noises: Description, result: RecordingResult, recordings: Sequence[Recording]
) -> list[RecordingScore]:
    every = recorded_kalman_estimates(noises, result.experiment, recordings)
    return [score(one, estimates) for one, estimates in zip(recordings, every, strict=True)]
