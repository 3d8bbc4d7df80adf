"""Turn what a search found into a result: judge it on held-out scenarios and check it."""

import jax
import numpy as np

from posegsa import steps
from posegsa.judging import trust
from posegsa.judging.baselines import CONSTANT_GAINS, best_constant, describe, search_baseline
from posegsa.judging.endurance import endurance
from posegsa.judging.evaluation import CONSTANT, TUNED, contender, evaluation
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.judging.result import TuneResult
from posegsa.judging.trajectory import trajectory_on
from posegsa.runtime import environment
from posegsa.search.build import TuningProblem
from posegsa.search.population import cost_name
from posegsa.search.run import Found
from posegsa.version import VERSION

_PARTS = ("best constant gains", "unseen scenarios", "one run", "long after", "trust")


def judge(problem: TuningProblem, found: Found) -> TuneResult:
    """Judge the best candidate of a search, and the best constant gain beside it."""
    experiment, search, space = problem.experiment, found.search, problem.space
    tuned = space.candidate(search.best_position)
    _begin("best constant gains")
    # The gain alone is found on a grid. With further tuned numbers it needs a search of its own.
    constant = search_baseline(problem, "constant") if tuned.keys else best_constant(problem)
    candidates = {TUNED: tuned, CONSTANT: constant}
    evaluations = experiment.search.evaluations
    spent = {TUNED: evaluations, CONSTANT: evaluations if tuned.keys else CONSTANT_GAINS}
    descriptions = {
        name: describe(each, space.schedules, spent[name]) for name, each in candidates.items()
    }

    _begin("unseen scenarios")
    # Training and held-out scenarios run together, so each kind of schedule compiles once.
    count = experiment.run.training_scenarios
    tracks = {name: error_tracks(each, problem.scenarios) for name, each in candidates.items()}
    training = {
        name: metrics_of(each.select(slice(count)), problem.training, problem.cost)[0].cost
        for name, each in tracks.items()
    }
    contenders = {
        name: contender(
            each.select(slice(count, None)), problem.held_out, descriptions[name], problem.cost
        )
        for name, each in tracks.items()
    }
    _begin("one run")
    trajectory = trajectory_on(tuned, problem.scenarios, count)  # the first held-out one
    _begin("long after")
    long_after = endurance(experiment, tuned, constant)
    _begin("trust")
    trusted = trust.check(problem, tuned, tracks[TUNED], trajectory)
    return TuneResult(
        experiment=experiment,
        cost=cost_name(problem.cost),
        best_cost=float(search.best_cost),
        parameters=np.array(descriptions[TUNED].numbers["k"]),
        also=descriptions[TUNED].also,
        training_costs=training[TUNED],
        constant_gain=descriptions[CONSTANT].numbers["gain"][0],
        constant_training_costs=training[CONSTANT],
        evaluation=evaluation(contenders, problem.held_out),
        endurance=long_after,
        trust=trusted,
        evaluations=evaluations,
        non_finite=int(search.non_finite),
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=trajectory,
        environment=environment(),
        version=VERSION,
    )


def _begin(part: str) -> None:
    steps.begin("judging", _PARTS.index(part), len(_PARTS), part)
