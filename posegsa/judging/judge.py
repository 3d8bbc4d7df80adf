"""Turn the outcome of a search into a result: judge it on unseen data, and check it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from posegsa import config, steps
from posegsa.config import ObserverConfig
from posegsa.judging import trust
from posegsa.judging.baselines import CONSTANT_GAINS, best_constant, search_baseline
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.judging.description import (
    Description,
    candidate_of,
    configured_filter,
    describe,
)
from posegsa.judging.endurance import endurance
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CONSTANT,
    SMOOTH,
    UNTUNED,
    Contender,
    contender,
    evaluation,
    own_name,
)
from posegsa.judging.known_sensors import of_recordings
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.judging.on_recordings import (
    OnRecordings,
    SimulatedScore,
    scored,
)
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.recorded_baselines import beside_what_was_not_searched
from posegsa.judging.result import FoundBy, Result
from posegsa.judging.trajectory import trajectory_on
from posegsa.judging.untuned import always_starts, untuned_kalman, with_idle_schedules
from posegsa.recordings.recording import Recording
from posegsa.runtime import environment
from posegsa.search.background import in_background
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys
from posegsa.search.population import cost_name, costs_by_scenario, over_scenarios
from posegsa.search.problem import TuningProblem
from posegsa.search.run_search import Found
from posegsa.version import VERSION

_PARTS = (
    "the filter to compare with",
    "unseen scenarios",
    "long after",
    "references",
    "one run",
    "trust",
)


class References(NamedTuple):
    """The references on held-out scenarios, which can be computed while the search runs."""

    untuned: dict[str, Contender]
    """The untuned Kalman filter, by name; none where it cannot start."""
    clairvoyant: np.ndarray | None
    """(S,) costs of the clairvoyant; None with a user's own cost."""


class Recorded(NamedTuple):
    """Recordings to tune and to judge on."""

    training: Sequence[Recording]
    held_out: Sequence[Recording]
    position_weight: float
    """Weight of the position's RMSE in the cost [deg/m]."""


def judge(
    problem: TuningProblem,
    found: Found,
    recorded: Recorded | None = None,
    known: Callable[[], References] | None = None,
) -> Result:
    """Judge the best candidate of a search.

    Args:
        problem: The problem that was searched.
        found: The outcome of the search.
        recorded: The recordings that it was tuned on, and those held out; None without recordings.
        known: Returns the `references` of drawn scenarios, if they were started before.
    """
    search = found.search
    configured = _configured_if_gained_little(problem, float(search.best_cost))
    tuned = configured or problem.space.candidate(search.best_position)
    if recorded is None:
        tuned_on, own_cost, weight = "scenarios", cost_name(problem.cost), 0.0
    else:
        mixed = problem.beside is not None
        tuned_on = "recordings and scenarios" if mixed else "recordings"
        own_cost, weight = cost_name(None), recorded.position_weight
    description = describe(tuned, problem.experiment, problem.experiment.search.evaluations)
    result = Result(
        experiment=problem.experiment,
        filter=description,
        search=FoundBy(
            tuned_on=tuned_on,
            cost=own_cost,
            position_weight=weight,
            best_cost=float(search.best_cost),
            non_finite=int(search.non_finite),
            compile_seconds=found.compile_seconds,
            search_seconds=found.search_seconds,
            history=jax.tree.map(_stored, search.history),
        ),
        on_scenarios=on_scenarios(problem, tuned, description, known) if recorded is None else None,
        environment=environment(),
        version=VERSION,
        own=problem.own,
    )
    if recorded is None:
        return result
    simulated = None if problem.beside is None else _on_simulated(problem, tuned)
    judged = on_recordings(result, recorded.training, recorded.held_out, simulated)
    if not recorded.held_out:
        return judged
    return beside_what_was_not_searched(judged, recorded.training, recorded.held_out)


def _configured_if_gained_little(problem: TuningProblem, best_cost: float) -> Candidate | None:
    """The candidate with the configured numbers, if the search improves the cost by too little."""
    experiment, training = problem.experiment, problem.training
    least, keys = experiment.objective.least_gain, problem.space.keys
    if not least or training.recorded is None or len(keys) != problem.space.box.lower.size:
        return None  # a schedule has no numbers before a search
    values = (jnp.asarray(config.number_at(experiment, key), training.dtype) for key in keys)
    configured = Candidate(None, tuple(values), keys)
    costs = costs_by_scenario(jax.tree.map(lambda a: a[None], configured), training)
    before = float(over_scenarios(costs, experiment.objective)[0])
    return configured if best_cost > (1 - least) * before else None


def _stored(column: jax.Array) -> np.ndarray:
    """A column of a history as it is stored: in double precision."""
    a = np.asarray(column)
    return a.astype(np.float64) if a.dtype.kind == "f" else a.astype(np.int64)


def references(problem: TuningProblem) -> References:
    """What judges a filter on the held-out scenarios of a problem, whatever a search finds."""
    experiment = problem.experiment
    clairvoyant = clairvoyant_costs(experiment) if problem.cost is None else None
    return References(_untuned(problem), clairvoyant)


def on_scenarios(
    problem: TuningProblem,
    tuned: Candidate,
    found: Description,
    known: Callable[[], References] | None = None,
) -> OnScenarios:
    """The performance of a candidate on drawn scenarios, and of the filter always compared.

    `found` is its description, `known` is as in `judge`.
    """
    experiment, scenarios = problem.experiment, problem.simulated
    known = known or in_background(partial(references, problem))
    count = experiment.run.training_scenarios
    precision = in_background(partial(trust.other_precision, problem, tuned))
    _begin("the filter to compare with")
    name, other, evaluations = _beside(problem, tuned)
    judged = own_name(found)
    descriptions = {judged: found, name: describe(other, experiment, evaluations)}
    _begin("unseen scenarios")
    # Training and held-out scenarios run together, so each kind of schedule compiles once.
    tracks = {
        judged: error_tracks(tuned, scenarios),
        name: error_tracks(other, with_idle_schedules(scenarios, problem)),
    }
    training = {
        name: metrics_of(each.select(slice(count)), problem.training, problem.cost)[0].cost
        for name, each in tracks.items()
    }
    contenders = {
        name: contender(
            each.select(slice(count, None)),
            problem.held_out,
            descriptions[name],
            problem.cost,
        )
        for name, each in tracks.items()
    }
    long_after = None
    if experiment.run.endurance_times > 1:
        _begin("long after")
        long_after = endurance(problem, tuned, other)
    _begin("references")
    untuned, clairvoyant = known()
    _begin("one run")
    trajectory = trajectory_on(tuned, scenarios, count)  # the first held-out scenario
    _begin("trust")
    return OnScenarios(
        training=training,
        evaluation=evaluation(contenders | untuned, problem.held_out, clairvoyant=clairvoyant),
        endurance=long_after,
        trust=trust.check(problem, tuned, tracks[judged], trajectory, precision()),
        trajectory=trajectory,
    )


def _beside(problem: TuningProblem, tuned: Candidate) -> tuple[str, Candidate, int]:
    """The filter that a tuned one is always compared with: name, candidate, evaluations.

    For a gain schedule these are the best constant gains, for a constant gain the best smooth one,
    and for another filter the same filter with the numbers of its configuration.
    """
    section, evaluations = problem.experiment.filter, problem.experiment.search.evaluations
    if not isinstance(section, ObserverConfig):
        return AS_CONFIGURED, Candidate(), 0
    if section.schedule == "constant":
        return SMOOTH, search_baseline(problem, "smooth"), evaluations
    if tuned.keys or section.roles:
        return CONSTANT, search_baseline(problem, "constant"), evaluations
    # The gain alone is found on a grid. With further numbers it needs a search of its own.
    return CONSTANT, best_constant(problem), CONSTANT_GAINS


def _untuned(problem: TuningProblem) -> dict[str, Contender]:
    """The untuned Kalman filter on the held-out scenarios, by name; none where it cannot start."""
    plain, run = untuned_kalman(problem.experiment), problem.experiment.run
    keys = held_out_keys(run.seed, run.held_out_scenarios)
    batch = scenario_batch(plain, keys, quiet=True)
    if not always_starts(batch):
        return {}
    found = configured_filter(plain)
    tracks = error_tracks(candidate_of(found, plain), with_idle_schedules(batch, problem))
    return {UNTUNED: contender(tracks, batch, found, problem.cost)}


def _begin(part: str) -> None:
    steps.begin("judging", _PARTS.index(part), len(_PARTS), part)


def on_recordings(
    result: Result,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    simulated: SimulatedScore | None = None,
) -> Result:
    """A result, with its filter judged on recordings.

    Args:
        result: The tuned filter.
        training: Recordings that it was tuned on; the filter knows their sensors.
        held_out: Recordings that only judge. A filter that was not searched knows their sensors,
            and those without a truth do not judge it.
        simulated: Its costs on simulated scenarios that were tuned on in addition to recordings.
    """
    experiment, filter = result.experiment, result.filter
    judges = [
        [one for one in some if one.truth is not None or result.search is not None]
        for some in (training, held_out)
    ]
    scores = [
        scored(filter, experiment, [one], result.own)[0]
        for one in steps.each("judging", [*judges[0], *judges[1]], lambda one: one.name)
    ]
    judged = OnRecordings(
        training=scores[: len(judges[0])],
        held_out=scores[len(judges[0]) :],
        simulated=simulated,
        sensors=of_recordings(held_out if result.search is None else training),
    )
    return replace(result, on_recordings=judged)


def _on_simulated(problem: TuningProblem, tuned: Candidate) -> SimulatedScore:
    """The cost on each simulated scenario of a problem that was tuned on recordings too."""
    agent = jax.tree.map(lambda a: a[None], tuned)
    costs = np.asarray(costs_by_scenario(agent, problem.simulated)[:, 0], np.float64).tolist()
    count = problem.experiment.run.training_scenarios
    return SimulatedScore(costs[:count], costs[count:])
