"""What a filter on recordings has to beat: constant gains, a Kalman filter, other libraries'.

All that is tuned has seen what the filter was tuned on: recordings, or a run's own scenarios.
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
"""Of each filter, by name, on each recording."""


def judged_beside_baselines(
    result: RecordingResult,
    recordings: Sequence[Recording],
    training: Sequence[Recording],
    others: Sequence[str],
) -> RecordingResult:
    """A result on recordings, beside other filters on the same ones.

    Args:
        result: What is judged.
        recordings: That judge.
        training: On which constant gains and the Kalman filter are tuned; without any they are left
            out.
        others: Of `OTHER_FILTERS`, those that are tried.
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
    """A run on simulated scenarios, on recordings, beside filters tuned on the same scenarios.

    Args:
        run: What is judged; its best constant gains are, too.
        recordings: That judge.
        others: Of `OTHER_FILTERS`, those that are tried.
        cost: The user's own cost that the run was tuned with, if it was.
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
    """Names of the other libraries' filters, if these recordings have what they read."""
    return list(OTHER_FILTERS) if all(map(readable, recordings)) else []


def _constant(
    result: RecordingResult, recordings: Sequence[Recording], training: Sequence[Recording]
) -> list[RecordingScore]:
    """The best constant gain, with all that was tuned beside the schedule."""
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
