"""`posegsa evaluate`: a finished run compared with all baselines on many held-out scenarios."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import overload

import jax

from posegsa import steps
from posegsa.arguments import (
    MAX_INTEGER,
    check_callable,
    check_type,
    check_whole,
    refuse,
    several,
)
from posegsa.defaults import SCENARIOS
from posegsa.judging.baselines import candidate_of, describe, schedule_baselines
from posegsa.judging.evaluation import (
    CONTENDERS,
    EKF,
    EKF_VECTORS,
    REPLAYED,
    Description,
    contender,
    evaluation,
)
from posegsa.judging.kalman import kalman_scenarios, kalman_tracks, tune_kalman
from posegsa.judging.metrics import error_tracks
from posegsa.judging.other_filters import OTHER_FILTERS, installed
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.recorded_baselines import (
    judged_beside_baselines,
    others_for,
    run_beside_baselines,
)
from posegsa.judging.result import TuneResult
from posegsa.recordings.recording import Recording
from posegsa.search import memory
from posegsa.search.build import TuningProblem, scenario_batch, tuning_problem
from posegsa.search.candidates import Candidate
from posegsa.search.keys import held_out_keys
from posegsa.search.parameters import ParameterSpace
from posegsa.search.population import TrackCost, check_same_cost
from posegsa.settings.fields import MAX_COUNT


@overload
def evaluate(
    result: TuneResult,
    *,
    scenarios: int = SCENARIOS,
    seed: int | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> TuneResult: ...


@overload
def evaluate(
    result: TuneResult,
    *,
    recordings: Recording | Iterable[Recording],
    others: bool | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> RecordingResult: ...


@overload
def evaluate(
    result: RecordingResult,
    *,
    recordings: Recording | Iterable[Recording],
    training: Recording | Iterable[Recording] = (),
    others: bool | None = None,
    progress: steps.Listener | None = None,
) -> RecordingResult: ...


def evaluate(
    result: TuneResult | RecordingResult,
    *,
    recordings: Recording | Iterable[Recording] | None = None,
    training: Recording | Iterable[Recording] = (),
    others: bool | None = None,
    scenarios: int = SCENARIOS,
    seed: int | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> TuneResult | RecordingResult:
    """Compare a tuned schedule with all baselines, on held-out scenarios or on recordings.

    Baseline schedules are searched on the run's training scenarios, with the run's optimiser and
    number of evaluations (`judging.baselines`). The Kalman filters' noises are searched until the
    cost hardly improves (`judging.kalman`). Baselines already stored in the result are not searched
    again. The held-out scenarios use random keys that no search has used.

    On recordings the baselines are the best constant gains and the invariant Kalman filter. Both
    are tuned on the data that the result was tuned on: on `training`, or on its simulated
    scenarios. On recordings of an IMU, VQF and the filters of Madgwick and Mahony are compared too,
    each with the settings of its paper (`judging.other_filters`). A recording's sensors take the
    experiment's weights in order; further sensors have the weight 1 (`TuneResult.filter_for`).

    Args:
        result: A tuned result.
        recordings: Held-out recordings, used instead of scenarios.
        training: The recordings that the result was tuned on, to tune the baselines on. Without
            them only filters without tuning are compared. Not for a result tuned on scenarios.
        others: Whether filters of other libraries are compared. By default they are, if the
            recordings have their sensors and the libraries are installed.
        scenarios: Number of held-out scenarios, at least 2.
        seed: Seed of the held-out scenarios; by default that of the run.
        cost: The user's own cost, if the result was tuned with one.
        progress: Called with each `steps.Step`; its `about` names the filter.

    Returns:
        The result with a new evaluation. For a result tuned on scenarios and judged on recordings,
        a `RecordingResult` with these recordings held out.

    Raises:
        ArgumentError: Fewer than 2 scenarios, an argument of the wrong type or without effect here,
            a different cost, or, on recordings, a gain that depends on the true pose.
        RecordingError: A recording has no ground truth.
        MemoryLimitError: So many scenarios would need more memory than available.
    """
    check_type("result", result, TuneResult, RecordingResult)
    check_callable("progress", progress)
    check_callable("cost", cost)
    if isinstance(result, RecordingResult) or recordings is not None:
        given = {"scenarios": scenarios != SCENARIOS, "seed": seed is not None}
        for name in (name for name, stated in given.items() if stated):
            refuse(f"{name} with recordings", "recordings, training and others")
        with steps.listening(progress):
            return _on_recordings(result, recordings, training, others, cost)
    if training != () or others is not None:
        refuse("training, others without recordings", "both, or neither")
    check_whole("scenarios", scenarios, 2, MAX_COUNT)
    if seed is not None:
        check_whole("seed", seed, 0, MAX_INTEGER)
    check_same_cost(cost, result.cost)
    experiment = result.experiment
    memory.check([experiment], held_out=scenarios)
    with steps.listening(progress), jax.enable_x64(experiment.run.dtype == "float64"):
        steps.begin("preparing")
        problem = tuning_problem(experiment, cost)
        found = _all_found(result, problem)
        unseen = held_out_keys(experiment.run.seed, scenarios, seed)
        held_out = scenario_batch(experiment, problem.scenario, unseen)
        contenders = {}
        for name, description in steps.each("judging", list(found.items()), itemgetter(0)):
            if description.kind == "Kalman":
                as_measured = kalman_scenarios(
                    experiment,
                    problem.scenario,
                    unseen,
                    vector_biases=name == EKF_VECTORS,
                    own=held_out,
                )
                tracks = kalman_tracks(description, as_measured)
            else:
                tracks = error_tracks(candidate_of(description, problem.space.schedules), held_out)
            contenders[name] = contender(tracks, held_out, description, cost)
        return replace(result, evaluation=evaluation(contenders, held_out, seed))


def _on_recordings(
    result: TuneResult | RecordingResult,
    recordings: Recording | Iterable[Recording] | None,
    training: Recording | Iterable[Recording],
    others: bool | None,
    cost: TrackCost | None,
) -> RecordingResult:
    unseen, seen = (
        several(name, [given] if isinstance(given, Recording) else given, Recording, "recordings")
        for name, given in (("recordings", recordings), ("training", training))
    )
    if not unseen:
        refuse("recordings: none", "at least one")
    simulated = isinstance(result, TuneResult) or result.tuned_on == "scenarios"
    if seen and simulated:
        refuse(
            "training with a result that was tuned on scenarios",
            "without it: what stands beside it was tuned on these scenarios too",
        )
    if both := {id(one) for one in unseen} & {id(one) for one in seen}:
        name = next(one.name for one in unseen if id(one) in both)
        refuse(f"recordings: {name} is in training too", "recordings that are not")
    names = others_for(unseen) if others is None else list(OTHER_FILTERS) * others
    if others is None:
        names = [name for name in names if installed(name)]
    if isinstance(result, TuneResult):
        check_same_cost(cost, result.cost)
        return run_beside_baselines(result, unseen, names, cost)
    if cost is not None:
        refuse("cost with a result on recordings", "recordings, training and others")
    return judged_beside_baselines(result, unseen, seen, names)


def _all_found(result: TuneResult, problem: TuningProblem) -> dict[str, Description]:
    """All contenders, in order; those already in the result's evaluation are not searched."""
    known = {name: each.filter for name, each in result.evaluation.contenders.items()}
    space, evaluations = problem.space.schedules, problem.experiment.search.evaluations
    find: dict[str, Callable[[], Description]] = {
        name: partial(_described, search, space, 0 if name == REPLAYED else evaluations)
        for name, search in schedule_baselines(problem, result.candidate).items()
    }
    for name in (EKF, EKF_VECTORS):
        find[name] = partial(
            tune_kalman,
            problem.experiment,
            problem.scenario,
            vector_biases=name == EKF_VECTORS,
            cost=problem.cost,
        )
    missing = [name for name in find if name not in known]
    for name in steps.each("searching", missing, str):
        known[name] = find[name]()
    return {name: known[name] for name in CONTENDERS}


def _described(
    search: Callable[[], Candidate], space: ParameterSpace, evaluations: int
) -> Description:
    return describe(search(), space, evaluations)
