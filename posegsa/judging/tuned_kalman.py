"""The invariant Kalman filter (`filters.kalman`) as a baseline, with tuned noises."""

import math

from posegsa import config
from posegsa.judging.description import Description, describe
from posegsa.optimisers import DifferentialEvolution, runner, start
from posegsa.search.build import TuningProblem
from posegsa.search.keys import keys
from posegsa.search.objective import SearchObjective, packed_batch

AGENTS = 20
MAX_EVALUATIONS = 1000
"""Evaluations of a search, at most; one takes as long as many of the observer's."""
CHECK_INTERVAL = 200
"""Evaluations between two checks of the improvement."""
MIN_IMPROVEMENT = 0.01
"""Relative improvement of the cost between two checks, below which the search stops."""


def kalman_experiment(experiment: config.Experiment, *, vector_biases: bool) -> config.Experiment:
    """An experiment with the Kalman filter in place of its own; all its noises are tuned."""
    data = experiment.model_dump(mode="json")
    data["filter"] = {"kind": "kalman", "vector_bias": "estimated" if vector_biases else "off"}
    del data["parameters"]["also"], data["tuned"]
    return config.from_dict(data)


def tune_kalman(problem: TuningProblem) -> Description:
    """The noises of lowest cost in a problem with the Kalman filter.

    Differential evolution searches their logarithms until a check finds less than
    MIN_IMPROVEMENT.
    """
    experiment, space = problem.experiment, problem.space
    optimiser = DifferentialEvolution(
        agents=AGENTS, iterations=MAX_EVALUATIONS // AGENTS, strategy="best/1/bin", factor=0.6
    )
    objective = SearchObjective(experiment.objective, None, problem.cost)
    go = runner(optimiser, objective, space.box, packed_batch(problem.training), space, None)
    search, before = start(optimiser, space.box, keys(experiment.run.seed).baselines), math.inf
    chunk = CHECK_INTERVAL // AGENTS
    for stop in range(chunk, optimiser.iterations + 1, chunk):
        search = go(search, stop)
        best = float(search.best_cost)
        if best > (1 - MIN_IMPROVEMENT) * before:
            break
        before = best
    candidate = space.candidate(search.best_position)
    return describe(candidate, experiment, int(search.iteration) * AGENTS)
