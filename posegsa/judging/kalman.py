"""The invariant Kalman filter (`filters.kalman`) as a baseline, with tuned noises."""

import math

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from posegsa import config
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.rollout import ErrorTrack
from posegsa.judging.evaluation import Description
from posegsa.judging.metrics import error_tracks
from posegsa.model.scenario import Scenario
from posegsa.optimisers import DifferentialEvolution, runner, start
from posegsa.search.build import scenario_batch
from posegsa.search.candidates import Candidate, SearchSpace, without_schedule
from posegsa.search.keys import keys, training_keys
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.population import ScenarioBatch, TrackCost

AGENTS = 20
MAX_EVALUATIONS = 1000
"""Maximum evaluations of a search; one takes as long as two to three of the observer's."""
CHECK_INTERVAL = 200
"""Evaluations between two checks of the improvement."""
MIN_IMPROVEMENT = 0.01
"""Relative improvement of the cost between two checks, below which the search stops."""

BOUNDS = {
    "angular_velocity": (0.002, 5.0),
    "velocity": (0.001, 2.0),
    "angular_walk": (1e-5, 1.0),
    "linear_walk": (1e-5, 1.0),
    "vector_walk": (1e-6, 0.3),
    "vector": (0.03, 3.0),
    "landmark": (0.03, 3.0),
    "initial_attitude": (0.003, 10.0),
    "initial_position": (0.02, 50.0),
    "initial_angular_bias": (0.003, 3.0),
    "initial_linear_bias": (0.01, 5.0),
    "initial_vector_bias": (0.001, 1.0),
}
"""Search range of each noise, in the units of `KalmanNoise`; its logarithm is searched."""


def kalman_scenarios(
    experiment: config.Experiment,
    one: Scenario,
    scenario_keys: Array,
    *,
    vector_biases: bool,
    own: ScenarioBatch | None = None,
) -> ScenarioBatch:
    """Scenarios of an experiment for the Kalman filter, which reads each vector as measured.

    `own` are the observer's scenarios of the same keys, if they exist already; they are reused
    where both filters read the same.
    """
    filter = untuned(vector_biases, jnp.dtype(experiment.run.dtype))
    if own is not None and experiment.filter.vector_bias == "estimated":
        return own._replace(filter=filter)
    return scenario_batch(experiment, one, scenario_keys, filter)


def untuned(vector_biases: bool, dtype: DTypeLike) -> KalmanFilter:
    """A filter whose noises are not set yet."""
    zero = jnp.zeros((), dtype)
    return KalmanFilter(KalmanNoise(*(zero,) * len(KalmanNoise._fields)), vector_biases)


def tune_kalman(
    experiment: config.Experiment,
    one: Scenario,
    *,
    vector_biases: bool,
    cost: TrackCost | None = None,
) -> Description:
    """The noises of lowest cost on the run's training scenarios; `cost` is a user's own cost."""
    run = experiment.run
    training = kalman_scenarios(
        experiment,
        one,
        training_keys(run.seed, run.training_scenarios),
        vector_biases=vector_biases,
    )
    return search_noises(experiment, training, cost)


def search_noises(
    experiment: config.Experiment, training: ScenarioBatch, cost: TrackCost | None = None
) -> Description:
    """The noises of lowest cost on scenarios or recordings, by name.

    Differential evolution searches their logarithms until a check finds less than
    MIN_IMPROVEMENT.
    """
    assert isinstance(training.filter, KalmanFilter)
    names = tuple(noise_names(training.filter.vector_biases))
    lower, upper = (jnp.asarray(ends, training.dtype) for ends in bounds_of(names))
    logarithmic = (True,) * len(names)
    space = SearchSpace(without_schedule(training.dtype), lower, upper, names, logarithmic)
    optimiser = DifferentialEvolution(
        agents=AGENTS, iterations=MAX_EVALUATIONS // AGENTS, strategy="best/1/bin", factor=0.6
    )
    objective = SearchObjective(experiment.objective, None, cost)
    go = runner(optimiser, objective, space.box, packed_batch(training), space, None)
    search, before = start(optimiser, space.box, keys(experiment.run.seed).baselines), math.inf
    chunk = CHECK_INTERVAL // AGENTS
    for stop in range(chunk, optimiser.iterations + 1, chunk):
        search = go(search, stop)
        best = float(search.best_cost)
        if best > (1 - MIN_IMPROVEMENT) * before:
            break
        before = best
    noises = np.exp(np.asarray(search.best_position, np.float64)).tolist()
    return Description(
        kind="Kalman",
        numbers={name: [noise] for name, noise in zip(names, noises, strict=True)},
        also={},
        evaluations=int(search.iteration) * AGENTS,
    )


def bounds_of(names: tuple[str, ...]) -> np.ndarray:
    """Lower and upper bounds (2, n) of the logarithms of noises."""
    return np.log([BOUNDS[name] for name in names]).T


def kalman_tracks(found: Description, batch: ScenarioBatch) -> ErrorTrack:
    """The filter's errors on all S `kalman_scenarios`; on the host, leaves (S, ...)."""
    return error_tracks(candidate_of_noises(found, batch.dtype), batch)


def candidate_of_noises(found: Description, dtype: DTypeLike) -> Candidate:
    """The candidate with the stored noises."""
    values = tuple(jnp.asarray(numbers[0], dtype) for numbers in found.numbers.values())
    return Candidate(None, values, tuple(found.numbers))


def noise_names(vector_biases: bool) -> list[str]:
    """Names of the noises of a filter with or without vector biases as states."""
    return [n for n in BOUNDS if vector_biases or n not in ("vector_walk", "initial_vector_bias")]
