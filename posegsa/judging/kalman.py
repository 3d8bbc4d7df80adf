"""The invariant Kalman filter (`model.ekf`) as a baseline: its noises tuned as users tune them."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from posegsa import config
from posegsa.judging.evaluation import Description
from posegsa.model.ekf import EkfNoise, ekf_cost, ekf_errors
from posegsa.model.filter import FilterState
from posegsa.model.rollout import ErrorTrack, Samples
from posegsa.model.scenario import Scenario
from posegsa.optimisers import Box, DifferentialEvolution, runner, start
from posegsa.search.build import scenario_batch
from posegsa.search.keys import keys, training_keys
from posegsa.search.population import ScenarioBatch, TrackCost, over_scenarios

AGENTS = 20
CHECKED = 200
"""Evaluations after which it is looked at how much they brought."""
ENOUGH = 0.01
"""Improvement of the cost that CHECKED evaluations must bring for the search to go on."""
MOST = 1000
"""Evaluations of a search, at most: one takes as long as two to three of the observer's."""
SCENARIOS = 25
"""Scenarios simulated at once when judging, to bound memory."""

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
"""Where each noise is searched, by its logarithm, in the units of `EkfNoise`."""


def kalman_scenarios(
    experiment: config.Experiment,
    one: Scenario,
    scenario_keys: Array,
    *,
    vector_biases: bool,
    own: ScenarioBatch | None = None,
) -> ScenarioBatch:
    """Scenarios of an experiment as the Kalman filter reads them: each vector as measured.

    `own` are the experiment's own of these keys, if there are any: they are not made twice.
    """
    if own is not None and experiment.filter.vector_bias == "estimated":
        batch = own
    else:
        each_vector = config.override(experiment, ["filter.vector_bias=estimated"])
        batch = scenario_batch(each_vector, one, scenario_keys)
    if vector_biases:
        return batch
    return batch._replace(initial=batch.initial._replace(vector_biases=(), turning=()))


def tune_kalman(
    experiment: config.Experiment,
    one: Scenario,
    *,
    vector_biases: bool,
    cost: TrackCost | None = None,
) -> Description:
    """The noises of lowest cost on the run's training scenarios; a user's own if there is one.

    Differential evolution in their logarithms, until CHECKED evaluations bring less than ENOUGH.
    """
    run = experiment.run
    training = kalman_scenarios(
        experiment,
        one,
        training_keys(run.seed, run.training_scenarios),
        vector_biases=vector_biases,
    )
    names = tuple(noise_names(vector_biases))
    objective = _Objective(experiment.objective, names, cost)
    return search_noises(objective, training, names, run.seed)


def search_noises(
    objective: Callable[[ScenarioBatch], Callable[[Array], Array]],
    training: ScenarioBatch,
    names: tuple[str, ...],
    seed: int,
) -> Description:
    """The noises, by name, of lowest objective, a function of their logarithms (A, d)."""
    bounds = np.log([BOUNDS[name] for name in names]).T
    box = Box(*(jnp.asarray(ends, training.dtype) for ends in bounds))
    optimiser = DifferentialEvolution(
        agents=AGENTS, iterations=MOST // AGENTS, strategy="best/1/bin", factor=0.6
    )
    go = runner(optimiser, objective, box, training)
    search, before = start(optimiser, box, keys(seed).baselines), math.inf
    chunk = CHECKED // AGENTS
    for stop in range(chunk, optimiser.iterations + 1, chunk):
        search = go(search, stop)
        best = float(search.best_cost)
        if best > (1 - ENOUGH) * before:
            break
        before = best
    noises = np.exp(np.asarray(search.best_position, np.float64)).tolist()
    return Description(
        kind="Kalman",
        numbers={name: [noise] for name, noise in zip(names, noises, strict=True)},
        also={},
        evaluations=int(search.iteration) * AGENTS,
    )


def kalman_tracks(found: Description, batch: ScenarioBatch) -> ErrorTrack:
    """What the filter does on all S `kalman_scenarios`; on the host, leaves (S, ...)."""
    noise = noise_of(found, batch.dtype)
    count, parts = batch.bias.shape[0], []
    for first in range(0, count, SCENARIOS):
        # The last part wraps round, so that all have one shape and are compiled once.
        some = batch.select(np.arange(first, first + SCENARIOS) % count)
        parts.append(jax.device_get(_tracks(some.samples, some.initial, noise)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *parts)


def noise_of(found: Description, dtype: jnp.dtype) -> EkfNoise:
    """The noises that were stored."""
    return named_noise({name: jnp.asarray(n[0], dtype) for name, n in found.numbers.items()})


def noise_names(vector_biases: bool) -> list[str]:
    """The noises that a filter with or without the vectors' biases as states has."""
    return [n for n in BOUNDS if vector_biases or n not in ("vector_walk", "initial_vector_bias")]


def named_noise(given: dict[str, Array]) -> EkfNoise:
    """Noises by name; those that are not given are 0."""
    nothing = jnp.zeros_like(next(iter(given.values())))
    return EkfNoise(**{name: given.get(name, nothing) for name in EkfNoise._fields})


class _Objective(NamedTuple):
    """What is minimised, for programs that are compiled for it."""

    objective: config.ObjectiveConfig
    names: tuple[str, ...]
    cost: TrackCost | None

    def __call__(self, training: ScenarioBatch):
        """As a function of the noises' logarithms (A, d)."""

        def costs(vectors: Array) -> Array:
            def on_scenario(scenario: tuple[Samples, FilterState, Array | None]) -> Array:
                samples, initial, end = scenario
                weights = training.weights.until(samples.time, end)

                def agent(vector: Array) -> Array:
                    noise = named_noise(dict(zip(self.names, jnp.exp(vector), strict=True)))
                    if self.cost is not None:
                        return self.cost(ekf_errors(samples, initial, noise), samples.time)
                    return ekf_cost(samples, initial, weights, noise).total

                return jax.vmap(agent)(vectors)

            by_scenario = lax.map(on_scenario, (training.samples, training.initial, training.end))
            return over_scenarios(by_scenario, self.objective)

        return costs


@jax.jit
def _tracks(samples: Samples, initial: FilterState, noise: EkfNoise) -> ErrorTrack:
    return ekf_errors(samples, initial, noise, together=True)
