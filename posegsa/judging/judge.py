"""From what a search found to a result: judged on unseen scenarios, and checked."""

import jax
import numpy as np

from posegsa.judging import trust
from posegsa.judging.baselines import best_constant
from posegsa.judging.evaluation import (
    CONSTANT,
    TUNED,
    ConstantDescription,
    FuzzyDescription,
    contender,
    evaluation,
)
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
    controller = problem.space.schedules.controller(search.best_position)
    parameters = np.asarray(problem.space.schedules.vector(controller), np.float64)
    tuned = FuzzyGain(controller)
    constant = best_constant(
        problem.training, experiment.parameters.gain_range, experiment.objective
    )

    # Training and held-out scenarios together, so that each kind of schedule compiles once.
    tuned_tracks = error_tracks(tuned, problem.everywhere)
    constant_tracks = error_tracks(constant, problem.everywhere)
    training = slice(experiment.run.training_scenarios)
    held_out = slice(experiment.run.training_scenarios, None)
    tuned_training, _ = metrics_of(tuned_tracks.select(training), problem.training)
    constant_training, _ = metrics_of(constant_tracks.select(training), problem.training)

    constant_gain = float(constant.gain)
    contenders = {
        TUNED: contender(
            tuned_tracks.select(held_out),
            problem.held_out,
            FuzzyDescription(kind="fuzzy", k=parameters.tolist()),
        ),
        CONSTANT: contender(
            constant_tracks.select(held_out),
            problem.held_out,
            ConstantDescription(kind="constant", gain=constant_gain),
        ),
    }
    first_held_out = held_out_keys(experiment.run.seed, 1)[0]
    trajectory = simulate_scenario(tuned, problem.scenario, experiment, first_held_out)
    return TuneResult(
        experiment=experiment,
        best_cost=float(search.best_cost),
        parameters=parameters,
        training_costs=tuned_training.cost,
        constant_gain=constant_gain,
        constant_training_costs=constant_training.cost,
        evaluation=evaluation(contenders, problem.held_out),
        trust=trust.check(
            experiment,
            parameters,
            problem.everywhere,
            tuned_tracks,
            trajectory.error,
            trajectory.rate,
        ),
        evaluations=experiment.search.evaluations,
        non_finite=int(search.non_finite),
        compile_seconds=found.compile_seconds,
        search_seconds=found.search_seconds,
        history=jax.tree.map(np.asarray, search.history),
        trajectory=trajectory,
        environment=environment(),
        version=VERSION,
    )
