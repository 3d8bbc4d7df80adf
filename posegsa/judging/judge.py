"""From what a search found to a result: judged on unseen scenarios, and checked."""

import jax
import numpy as np

from posegsa.judging import trust
from posegsa.judging.baselines import best_constant
from posegsa.judging.evaluation import CONSTANT, TUNED, Description, contender, evaluation
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.judging.result import VERSION, TuneResult
from posegsa.judging.trajectory import simulate_scenario
from posegsa.model.schedules import FuzzyGain
from posegsa.runtime import environment
from posegsa.search.build import TuningProblem
from posegsa.search.keys import held_out_keys
from posegsa.search.run import Found


def judge(problem: TuningProblem, found: Found) -> TuneResult:
    """Judge the best controller that a search found, beside the best constant gain."""
    experiment, search = problem.experiment, found.search
    controller = problem.space.controller(search.best_position)
    parameters = np.asarray(problem.space.vector(controller), np.float64)
    tuned = FuzzyGain(controller)
    constant = best_constant(
        problem.training, experiment.parameters.gain_range, experiment.objective
    )
    constant_gain = float(constant.gain)
    schedules = {TUNED: tuned, CONSTANT: constant}
    descriptions: dict[str, Description] = {
        TUNED: {"kind": "fuzzy", "k": parameters.tolist()},
        CONSTANT: {"kind": "constant", "gain": constant_gain},
    }

    # Training and held-out scenarios together, so that each kind of schedule compiles once.
    count = experiment.run.training_scenarios
    tracks = {name: error_tracks(each, problem.everywhere) for name, each in schedules.items()}
    training = {
        name: metrics_of(each.select(slice(count)), problem.training)[0].cost
        for name, each in tracks.items()
    }
    contenders = {
        name: contender(each.select(slice(count, None)), problem.held_out, descriptions[name])
        for name, each in tracks.items()
    }
    first_held_out = held_out_keys(experiment.run.seed, 1)[0]
    trajectory = simulate_scenario(tuned, problem.scenario, experiment, first_held_out)
    return TuneResult(
        experiment=experiment,
        best_cost=float(search.best_cost),
        parameters=parameters,
        training_costs=training[TUNED],
        constant_gain=constant_gain,
        constant_training_costs=training[CONSTANT],
        evaluation=evaluation(contenders, problem.held_out),
        trust=trust.check(problem, parameters, tracks[TUNED], trajectory),
        evaluations=experiment.search.evaluations,
        non_finite=int(search.non_finite),
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=trajectory,
        environment=environment(),
        version=VERSION,
    )
