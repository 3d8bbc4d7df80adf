"""What a filter on recordings has to beat: constant gains, a Kalman filter, other libraries'."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import jax

from posegsa.judging.evaluation import CONSTANT, EKF
from posegsa.judging.other_filters import OTHER_FILTERS, other_filter, readable
from posegsa.judging.recorded import RecordingResult, RecordingScore, judge_on_recordings, score
from posegsa.judging.recorded_kalman import recorded_kalman_estimates, tune_recorded_kalman
from posegsa.recordings.recording import Recording
from posegsa.search.recorded import recorded_problem
from posegsa.search.run import run_search, tell_share

Say = Callable[[str], object]


def judged_beside_baselines(
    result: RecordingResult,
    recordings: Sequence[Recording],
    training: Sequence[Recording],
    others: Sequence[str],
    say: Say,
) -> RecordingResult:
    """A result on recordings, beside other filters on the same ones.

    Args:
        result: What is judged.
        recordings: That judge.
        training: On which constant gains and the Kalman filter are tuned; without any they are left
            out.
        others: Of `OTHER_FILTERS`, those that are tried.
        say: Told in words what is done next.
    """
    with jax.enable_x64(result.experiment.run.dtype == "float64"):
        own = [score(one, result.estimate(one)) for one in recordings]
        baselines: dict[str, list[RecordingScore]] = {}
        if training:
            if result.filter.kind != "constant":
                say(f"searching: {CONSTANT}")
                baselines[CONSTANT] = _constant(result, recordings, training)
            say(f"searching: {EKF}")
            baselines[EKF] = _kalman(result, recordings, training)
        for name in others:
            say(f"judging: {name}")
            baselines[name] = [score(one, other_filter(name, one)) for one in recordings]
    return replace(result, held_out=own, baselines=baselines)


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


def _kalman(
    result: RecordingResult, recordings: Sequence[Recording], training: Sequence[Recording]
) -> list[RecordingScore]:
    found = tune_recorded_kalman(result.experiment, training, result.position_weight)
    every = recorded_kalman_estimates(found, result.experiment, recordings)
    return [score(one, estimates) for one, estimates in zip(recordings, every, strict=True)]
