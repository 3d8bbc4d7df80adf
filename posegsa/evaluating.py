"""`posegsa evaluate`: a finished run compared with all baselines on many held-out scenarios."""

from collections.abc import Iterable
from dataclasses import replace
from operator import itemgetter

import jax

from posegsa import config, steps
from posegsa.arguments import (
    MAX_INTEGER,
    check_callable,
    check_type,
    check_whole,
    refuse,
    several,
)
from posegsa.defaults import SCENARIOS
from posegsa.judging.baselines import baselines, batch_for, search_baselines
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.judging.description import Description, candidate_of
from posegsa.judging.evaluation import (
    CLAIRVOYANT,
    CONTENDERS,
    UNTUNED,
    contender,
    evaluation,
    own_name,
)
from posegsa.judging.judge import on_scenarios
from posegsa.judging.metrics import error_tracks
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.recorded_baselines import judged_beside_baselines
from posegsa.judging.result import Result
from posegsa.judging.untuned import always_starts
from posegsa.progress import shown
from posegsa.recordings.recording import Recording
from posegsa.search import memory
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys
from posegsa.search.population import TrackCost, check_same_cost
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.settings.fields import MAX_COUNT


def evaluate(
    result: Result,
    *,
    recordings: Recording | Iterable[Recording] | None = None,
    training: Recording | Iterable[Recording] = (),
    others: bool | None = None,
    scenarios: int = SCENARIOS,
    seed: int | None = None,
    cost: TrackCost | None = None,
    progress: steps.Listener | None = None,
) -> Result:
    """Judge a tuned filter and all baselines, on held-out scenarios or on recordings.

    On scenarios the baselines are other gain schedules of the observer, Kalman filters, and
    variants of the tuned filter itself: its gains, or the outputs of its schedule `unknown`,
    replayed by time; a random search for it; its numbers before the tuning (`judging.baselines`).
    They are searched on the run's training scenarios, with the run's optimiser and number of
    evaluations; the Kalman filters (fixed, iterated, gated, by the clock) until 200 evaluations
    improve the cost by less than 1 % (`judging.tuned_kalman`). What is already in the result is not
    searched again. The held-out scenarios use random keys that no search has used.

    On recordings the baselines are the best constant gains and the invariant Kalman filter. Both
    are tuned on the data that the result was tuned on: on `training`, or on its simulated
    scenarios. On recordings of an IMU, VQF and the filters of Madgwick and Mahony are compared too,
    each with the settings of its paper (`judging.other_filters`).

    Args:
        result: A tuned filter, or one that was not searched (`configured`).
        recordings: Held-out recordings, used instead of scenarios.
        training: Recordings to tune the baselines on: those that the result was tuned on. Without
            them only filters without tuning are compared, unless it was tuned on scenarios.
        others: Whether filters of other libraries are compared. By default they are, if the
            recordings have their sensors and the libraries are installed.
        scenarios: Number of held-out scenarios, at least 2.
        seed: Seed of the held-out scenarios; by default that of the run.
        cost: The user's own cost, if the result was tuned with one.
        progress: Called with each `steps.Step`; its `about` names the filter.

    Returns:
        The result with a new judgement; an existing one on other data is kept.

    Raises:
        ArgumentError: Fewer than 2 scenarios, an argument of the wrong type or without effect here,
            a different cost, or, on recordings, a gain that depends on the true pose.
        RecordingError: A recording has no ground truth.
        MemoryLimitError: That number of scenarios would need more memory than available.
    """
    check_type("result", result, Result)
    check_callable("progress", progress)
    check_callable("cost", cost)
    if result.search is not None and result.search.tuned_on == "scenarios":
        check_same_cost(cost, result.search.cost)
    elif cost is not None and recordings is not None:
        refuse(
            "cost with recordings, for a result not tuned on scenarios",
            "recordings, training and others",
        )
    if recordings is not None:
        given = {"scenarios": scenarios != SCENARIOS, "seed": seed is not None}
        for name in (name for name, stated in given.items() if stated):
            refuse(f"{name} with recordings", "recordings, training and others")
        with shown(progress):
            return _on_recordings(result, recordings, training, others, cost)
    if training != () or others is not None:
        refuse("training, others without recordings", "both, or neither")
    check_whole("scenarios", scenarios, 2, MAX_COUNT)
    if seed is not None:
        check_whole("seed", seed, 0, MAX_INTEGER)
    experiment = result.experiment
    memory.check([experiment], held_out=scenarios)
    with shown(progress), jax.enable_x64(experiment.run.dtype == "float64"):
        steps.begin("preparing")
        on_drawn = experiment.replace(**{"objective.simulated_share": 0.0})
        problem = tuning_problem(on_drawn, cost, result.own)
        if result.on_scenarios is None:
            judged = on_scenarios(problem, result.candidate, result.filter)
        else:
            judged = result.on_scenarios
        found = _all_found(result, judged, problem)
        unseen = held_out_keys(experiment.run.seed, scenarios, seed)
        held_out = scenario_batch(on_drawn, unseen, problem.training.filter)
        contenders = {}
        for name, (its, description) in steps.each("judging", list(found.items()), itemgetter(0)):
            same = (its.filter, its.scenario) == (on_drawn.filter, on_drawn.scenario)
            batch = held_out if same else batch_for(held_out, on_drawn, its, unseen)
            if name == UNTUNED and not always_starts(batch):
                continue
            tracks = error_tracks(candidate_of(description, its), batch)
            contenders[name] = contender(tracks, batch, description, cost)
        steps.begin("judging", about=CLAIRVOYANT)
        reference = clairvoyant_costs(on_drawn, unseen) if cost is None else None
        evaluated = evaluation(contenders, held_out, seed, reference)
        return replace(result, on_scenarios=replace(judged, evaluation=evaluated))


def _all_found(
    result: Result, judged: OnScenarios, problem: TuningProblem
) -> dict[str, tuple[config.Experiment, Description]]:
    """All contenders, in order, each with the experiment that its filter belongs to.

    Those already in the result's evaluation are not searched.
    """
    known = {name: each.filter for name, each in judged.evaluation.contenders.items()}
    judged_one = {own_name(result.filter): (problem.experiment, result.filter)}
    possible = baselines(problem.experiment, result.filter)
    lacking = {name: each for name, each in possible.items() if name not in known}
    known |= search_baselines(problem, lacking)
    found = {name: (each.experiment, known[name]) for name, each in possible.items()}
    return judged_one | {name: found[name] for name in CONTENDERS if name in found}


def _on_recordings(
    result: Result,
    recordings: Recording | Iterable[Recording],
    training: Recording | Iterable[Recording],
    others: bool | None,
    cost: TrackCost | None,
) -> Result:
    unseen, seen = (
        several(name, [given] if isinstance(given, Recording) else given, Recording, "recordings")
        for name, given in (("recordings", recordings), ("training", training))
    )
    if not unseen:
        refuse("recordings: none", "at least one")
    if both := {id(one) for one in unseen} & {id(one) for one in seen}:
        name = next(one.name for one in unseen if id(one) in both)
        refuse(f"recordings: {name} is in training too", "recordings that are not")
    unseen, seen = ([result.as_read(one) for one in some] for some in (unseen, seen))
    return judged_beside_baselines(result, unseen, seen, others, cost)
