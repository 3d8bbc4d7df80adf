"""Invariant Kalman filters (`filters.kalman`) as baselines, with tuned noises."""

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from posegsa import config, steps
from posegsa.filters.kalman import KalmanNoise
from posegsa.filters.leads import LEAD_KEYS
from posegsa.judging.description import Description, describe
from posegsa.judging.evaluation import EKF, EKF_CLOCK, EKF_GATED, EKF_ITERATED, EKF_VECTORS
from posegsa.judging.untuned import with_kalman
from posegsa.optimisers import DifferentialEvolution, runner, start
from posegsa.optimisers.search_box import to_unit
from posegsa.search.keys import keys
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.problem import TuningProblem
from posegsa.search.schedule_spaces import KNOTS

AGENTS = 20
MIN_EVALUATIONS, MAX_EVALUATIONS = 0, 1000
"""Fewest and most evaluations of a search; one takes as long as many of the observer."""
CHECK_INTERVAL = 200
"""Evaluations between two checks of the improvement."""
MIN_IMPROVEMENT = 0.01
"""Relative improvement of the cost between two checks, below which the search stops."""


VARIANTS: dict[str, dict[str, Any]] = {
    EKF: {"vector_bias": "off"},
    EKF_VECTORS: {},
    EKF_ITERATED: {"iterations": 10},
    EKF_GATED: {"belief": "ramp", "belief_smoothing": 0.0},
    EKF_CLOCK: {"unknown": "clock"},
}
"""Changes of [filter] from a plain Kalman filter with the vectors' biases as states, by name. A
gate is a steep ramp of belief at once; the search finds its threshold and its slope."""
_INACTIVE = {"ramp": (1.0, 0.5), "clock": (0.0,) * KNOTS}
"""Numbers of schedules that leave the noises as they are, as shares of their ranges."""
_KEPT = (*KalmanNoise._fields, *LEAD_KEYS, "vector_scales", "landmark_scales")
"""Settings that a plain Kalman filter takes over from another."""


def kalman_experiment(experiment: config.Experiment, name: str) -> config.Experiment:
    """An experiment with one of the VARIANTS in place of its filter; all its noises are tuned.

    They are those of the experiment's own Kalman filter, if it has one, without its schedules.
    """
    section = experiment.filter
    kept = _KEPT if isinstance(section, config.KalmanConfig) else ()
    own = {key: getattr(section, key) for key in kept}
    filter = config.KalmanConfig(**own | VARIANTS[name])
    return with_kalman(experiment, filter)


def tune_kalman(problem: TuningProblem) -> Description:
    """The noises of lowest cost in a problem with one of the VARIANTS, and its schedules.

    Differential evolution searches their logarithms until a check finds less than
    MIN_IMPROVEMENT. Its first agent has the noises as configured, by default those of the sensors'
    data sheet, and schedules without effect. A few evaluations hardly improve on it.
    """
    experiment, space = problem.experiment, problem.space
    optimiser = DifferentialEvolution(
        agents=AGENTS, iterations=MAX_EVALUATIONS // AGENTS, strategy="best/1/bin", factor=0.6
    )
    objective = SearchObjective(experiment.objective, None, problem.cost)
    go = runner(optimiser, objective, space.box, packed_batch(problem.training), space, None)
    search, before = start(optimiser, space.box, keys(experiment.run.seed).baselines), math.inf
    search = search._replace(state=optimiser.begin_at(search.state, first_agent(problem)))
    chunk = CHECK_INTERVAL // AGENTS
    for stop in range(chunk, optimiser.iterations + 1, chunk):
        search = go(search, stop)
        best = float(search.best_cost)
        steps.share(stop / optimiser.iterations, best)
        enough = stop * AGENTS >= MIN_EVALUATIONS
        if enough and best > (1 - MIN_IMPROVEMENT) * before:
            break
        before = best
    candidate = space.candidate(search.best_position)
    return describe(candidate, experiment, int(search.iteration) * AGENTS)


def first_agent(problem: TuningProblem) -> Array:
    """(d,) the noises as configured, after schedules without effect, in the unit box."""
    section, space = problem.experiment.filter, problem.space
    kinds = getattr(section, "roles", {}).values()
    inactive = [share for kind in kinds for share in _INACTIVE[kind]]
    values = [getattr(section, key.removeprefix("filter.")) for key in space.keys]
    scales = zip(values, space.logarithmic, strict=True)
    noises = [math.log(value) if logarithmic else value for value, logarithmic in scales]
    dtype = space.box.lower.dtype
    unit = to_unit(space.box, jnp.asarray([*inactive, *noises], dtype))
    return jnp.concatenate([jnp.asarray(inactive, dtype), unit[len(inactive) :]])
