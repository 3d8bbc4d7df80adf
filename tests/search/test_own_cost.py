"""A user's own cost of a simulation, in the place of the configured one."""

import jax.numpy as jnp
import numpy as np
import pytest
from experiments import tiny

from posegsa.model.rollout import ErrorTrack
from posegsa.search.build import tuning_problem
from posegsa.search.population import evaluate_population
from posegsa.search.run import run_search

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

SHORT = tiny(
    *("scenario.duration=0.3", "cost.transient_window=[0, 9]", "cost.steady_window=[15, 28]")
)


def configured(track: ErrorTrack, time) -> jnp.ndarray:
    """The configured cost of SHORT, by hand: Eq. 17."""
    error = track.attitude + 0.2 * track.position
    begin, steady = (time > -1) & (time < 0.095), (time > 0.145) & (time < 0.285)
    return 0.3 * jnp.sum(jnp.where(begin, error, 0)) + jnp.sum(jnp.where(steady, error, 0))


def even(track: ErrorTrack, time) -> jnp.ndarray:
    """The same, but NaN unless the whole part of the last gain is even."""
    return jnp.where(jnp.floor(track.gain[-1]) % 2 == 0, configured(track, time), jnp.nan)


def test_the_configured_cost_by_hand_gives_the_same_costs() -> None:
    own, usual = tuning_problem(SHORT, configured), tuning_problem(SHORT)
    rng = np.random.default_rng(0)
    vectors = rng.uniform(own.space.box.lower, own.space.box.upper, (5, 22)).astype(np.float32)
    costs = [
        evaluate_population(jnp.asarray(vectors), one.training, one.space, cost=one.cost)
        for one in (own, usual)
    ]
    np.testing.assert_allclose(costs[0], costs[1], rtol=1e-5)


def test_nan_loses() -> None:
    problem = tuning_problem(SHORT, even)
    found = run_search(problem).search
    assert 0 < int(found.non_finite) < problem.experiment.search.evaluations
    # What won has the configured cost: no NaN was passed off as a number. As many as above.
    vectors = jnp.broadcast_to(found.best_position, (5, 22))
    costs = evaluate_population(vectors, problem.training, problem.space, cost=configured)
    assert float(costs[0]) == pytest.approx(float(found.best_cost), rel=1e-5)
