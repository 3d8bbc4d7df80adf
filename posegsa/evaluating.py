"""`posegsa evaluate`: a finished run on many unseen scenarios, beside every baseline."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax

from posegsa.arguments import MAX_INTEGER, check_callable, check_type, check_whole
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
from posegsa.judging.result import TuneResult
from posegsa.search import memory
from posegsa.search.build import TuningProblem, scenario_batch, tuning_problem
from posegsa.search.candidates import Candidate
from posegsa.search.keys import held_out_keys
from posegsa.search.parameters import ParameterSpace
from posegsa.search.population import TrackCost, check_same_cost
from posegsa.settings.fields import MAX_COUNT


def evaluate(
    result: TuneResult,
    *,
    scenarios: int = 1000,
    seed: int | None = None,
    cost: TrackCost | None = None,
    progress: Callable[[str], object] | None = None,
) -> TuneResult:
    """Judge a tuned schedule on unseen scenarios beside all baselines.

    Schedules are searched on the run's training scenarios with the run's optimiser and number of
    evaluations (`judging.baselines`), the Kalman filters' noises until that brings little more
    (`judging.kalman`). What a result has been judged beside before is not searched again. The
    scenarios that judge are drawn with keys that no search has seen.

    Args:
        result: A tuned result.
        scenarios: Number of held-out scenarios, at least 2.
        seed: Another held-out set than the run's own.
        cost: The user's own cost that the result was tuned with, if it was.
        progress: Told in words what is done next.

    Returns:
        The result with its evaluation replaced.

    Raises:
        ArgumentError: Fewer than 2 scenarios, an argument of another type, or another cost.
        MemoryLimitError: So many scenarios would need more memory than there is.
    """
    check_type("result", result, TuneResult)
    check_whole("scenarios", scenarios, 2, MAX_COUNT)
    if seed is not None:
        check_whole("seed", seed, 0, MAX_INTEGER)
    check_callable("progress", progress)
    check_callable("cost", cost)
    check_same_cost(cost, result.cost)
    experiment = result.experiment
    memory.check([experiment], held_out=scenarios)
    say = progress if progress is not None else lambda _: None
    with jax.enable_x64(experiment.run.dtype == "float64"):
        problem = tuning_problem(experiment, cost)
        found = _all_found(result, problem, say)
        unseen = held_out_keys(experiment.run.seed, scenarios, seed)
        contenders = {}
        for name, description in found.items():
            say(f"judging: {name}")
            if description.kind == "Kalman":
                held_out = kalman_scenarios(
                    experiment, problem.scenario, unseen, vector_biases=name == EKF_VECTORS
                )
                tracks = kalman_tracks(description, held_out)
            else:
                held_out = scenario_batch(experiment, problem.scenario, unseen)
                tracks = error_tracks(candidate_of(description, problem.space.schedules), held_out)
            contenders[name] = contender(tracks, held_out, description, cost)
        return replace(result, evaluation=evaluation(contenders, held_out, seed))


def _all_found(
    result: TuneResult, problem: TuningProblem, say: Callable[[str], object]
) -> dict[str, Description]:
    """All contenders, in order; those that the result has been judged beside are not searched."""
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
    for name, search in find.items():
        if name not in known:
            say(f"searching: {name}")
            known[name] = search()
    return {name: known[name] for name in CONTENDERS}


def _described(
    search: Callable[[], Candidate], space: ParameterSpace, evaluations: int
) -> Description:
    return describe(search(), space, evaluations)
