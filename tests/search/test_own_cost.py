"""A user's own cost of a simulation, instead of the configured one."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.experiments import paper, tiny

from posegsa.filters.rollout import ErrorTrack
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.model.schedules import ConstantGain
from posegsa.search.candidates import Candidate
from posegsa.search.population import costs_by_scenario, evaluate_population
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import first_search, run_search


def configured(track: ErrorTrack, time) -> jnp.ndarray:
    """The paper's cost, Eq. 17, written by hand."""
    error = track.attitude + 0.2 * track.position
    begin, steady = time < 1.005, (time > 3.995) & (time < 14.005)
    return 0.3 * jnp.sum(jnp.where(begin, error, 0)) + jnp.sum(jnp.where(steady, error, 0))


def often(track: ErrorTrack, time) -> jnp.ndarray:
    """`configured`, but NaN if the integer part of the last gain is a multiple of 4."""
    return jnp.where(jnp.floor(track.gain[-1]) % 4 > 0, configured(track, time), jnp.nan)


def test_the_configured_cost_by_hand_gives_the_same_costs_and_nan_loses() -> None:
    sizes = "run.training_scenarios=2", "search.agents=20", "search.iterations=3"
    experiment = paper("search.optimiser=random_search", *sizes, dtype="float32")
    problem = tuning_problem(experiment, often)
    found = [
        run_search(problem, search=first_search(problem, jax.random.key(seed))).search
        for seed in range(5)
    ]
    for one in found:
        assert 0 < int(one.non_finite) < problem.experiment.search.evaluations
    # The winners have the configured cost, so no NaN was taken for a number. Each is repeated to a
    # population of 100, to use the same program as other tests.
    vectors = np.repeat([one.best_position for one in found], 20, axis=0)
    costs = evaluate_population(jnp.asarray(vectors), problem.training, problem.space)
    np.testing.assert_allclose(costs[::20], [one.best_cost for one in found], rtol=1e-5)
    assert len(np.unique(costs[::20])) == 5


def early(track: ErrorTrack, time) -> jnp.ndarray:
    """The mean distance over the first half second."""
    return jnp.mean(jnp.where(time < 0.495, track.distance, 0)) * time.size / 50


def test_before_a_start_from_the_sensors_a_cost_sees_the_errors_of_the_start() -> None:
    training = tuning_problem(tiny()).training
    late = training._replace(begin=0.01 * jnp.array([50, 80, 0], training.dtype))
    one = Candidate(ConstantGain(jnp.float32(20)))
    tracks = error_tracks(one, training)
    distance = np.asarray(tracks.distance)
    expected = [distance[0, 50], distance[1, 80], distance[2, :50].mean()]
    agent = jax.tree.map(lambda a: a[None], one)
    np.testing.assert_allclose(
        costs_by_scenario(agent, late, None, early)[:, 0], expected, rtol=1e-5
    )
    np.testing.assert_allclose(metrics_of(tracks, late, early)[0].cost, expected, rtol=1e-5)
