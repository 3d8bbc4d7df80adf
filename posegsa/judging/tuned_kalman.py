"""The invariant Kalman filter (`filters.kalman`) as a baseline, with tuned noises."""

import math

import jax.numpy as jnp

from posegsa import config, steps
from posegsa.filters.kalman import KalmanNoise
from posegsa.filters.leads import LEAD_KEYS
from posegsa.judging.description import Description, describe
from posegsa.judging.untuned import with_kalman
from posegsa.optimisers import DifferentialEvolution, runner, start
from posegsa.optimisers.search_box import to_unit
from posegsa.search.keys import keys
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.problem import TuningProblem

AGENTS = 20
MAX_EVALUATIONS = 1000
"""Maximum evaluations of a search; one takes as long as many evaluations of the observer."""
CHECK_INTERVAL = 200
"""Evaluations between two checks of the improvement."""
MIN_IMPROVEMENT = 0.01
"""Relative improvement of the cost between two checks, below which the search stops."""


_KEPT = (*KalmanNoise._fields, *LEAD_KEYS, "vector_scales", "landmark_scales")
"""Settings that a plain Kalman filter takes over from another."""


def kalman_experiment(experiment: config.Experiment, *, vector_biases: bool) -> config.Experiment:
    """An experiment with a plain Kalman filter in place of its own; all its noises are tuned.

    They are those of the experiment's own Kalman filter, if it has one, without its schedules.
    """
    section = experiment.filter
    kept = _KEPT if isinstance(section, config.KalmanConfig) else ()
    filter = config.KalmanConfig(
        vector_bias="estimated" if vector_biases else "off",
        **{name: getattr(section, name) for name in kept},
    )
    return with_kalman(experiment, filter)


def tune_kalman(problem: TuningProblem) -> Description:
    """The noises of lowest cost in a problem with the Kalman filter.

    Differential evolution searches their logarithms until a check finds less than
    MIN_IMPROVEMENT. Its first agent has the noises as configured, by default those of the sensors'
    data sheet, which a few evaluations hardly improve.
    """
    experiment, space = problem.experiment, problem.space
    optimiser = DifferentialEvolution(
        agents=AGENTS, iterations=MAX_EVALUATIONS // AGENTS, strategy="best/1/bin", factor=0.6
    )
    objective = SearchObjective(experiment.objective, None, problem.cost)
    go = runner(optimiser, objective, space.box, packed_batch(problem.training), space, None)
    search, before = start(optimiser, space.box, keys(experiment.run.seed).baselines), math.inf
    values = [getattr(experiment.filter, key.removeprefix("filter.")) for key in space.keys]
    scales = zip(values, space.logarithmic, strict=True)
    configured = [math.log(value) if logarithmic else value for value, logarithmic in scales]
    first = to_unit(space.box, jnp.asarray(configured, space.box.lower.dtype))
    search = search._replace(state=optimiser.begin_at(search.state, first))
    chunk = CHECK_INTERVAL // AGENTS
    for stop in range(chunk, optimiser.iterations + 1, chunk):
        search = go(search, stop)
        best = float(search.best_cost)
        steps.share(stop / optimiser.iterations, best)
        if best > (1 - MIN_IMPROVEMENT) * before:
            break
        before = best
    candidate = space.candidate(search.best_position)
    return describe(candidate, experiment, int(search.iteration) * AGENTS)
