"""The Kalman filter as a baseline: its noises are found, and its errors are those of the filter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import quietly, tiny

from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.rollout import simulate_errors
from posegsa.judging import kalman
from posegsa.judging.evaluation import Description
from posegsa.judging.kalman import BOUNDS, kalman_scenarios, kalman_tracks, tune_kalman
from posegsa.search.keys import training_keys

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

TINY = tiny()
"""The experiment of `test_evaluate`, so that its programs are compiled once."""
NOISES = {name: float(np.sqrt(low * high)) for name, (low, high) in BOUNDS.items()}


def described(noises: dict[str, float]) -> Description:
    return Description("Kalman", {name: [n] for name, n in noises.items()}, {}, 20)


def test_the_noises_are_all_that_the_filter_has() -> None:
    assert set(BOUNDS) == set(KalmanNoise._fields)
    assert all(0 < low < high for low, high in BOUNDS.values())


@pytest.fixture(scope="module")
def found():
    """Two searches of one generation, with the program of `test_evaluate`."""
    patch = pytest.MonkeyPatch()
    patch.setattr(kalman, "CHECK_INTERVAL", 20)
    patch.setattr(kalman, "MAX_EVALUATIONS", 40)
    experiment = tiny()
    one = quietly(experiment)
    yield [tune_kalman(experiment, one, vector_biases=False) for _ in range(2)]
    patch.undo()


def test_noises_are_found_within_their_bounds_and_the_same_again(found) -> None:
    first, again = found
    assert first == again
    assert first.kind == "Kalman"
    assert first.also == {}
    assert first.evaluations in (20, 40)
    expected = set(BOUNDS) - {"vector_walk", "initial_vector_bias"}
    assert set(first.numbers) == expected, "there are no such states"
    for name, (noise,) in first.numbers.items():
        low, high = BOUNDS[name]
        assert low * (1 - 1e-6) <= noise <= high * (1 + 1e-6), name


def test_tracks_are_those_of_the_filter_one_by_one() -> None:
    """They are simulated in groups of 16; the last group is padded."""
    noises = NOISES | {"vector": 0.1, "landmark": 0.1}
    batch = kalman_scenarios(TINY, quietly(TINY), training_keys(0, 3), vector_biases=False)
    several = jax.device_get(batch).select(np.arange(26) % 3)
    tracks = kalman_tracks(described(noises), several)
    noise = KalmanNoise(**{name: jnp.float32(n) for name, n in noises.items()})
    filter, alone = KalmanFilter(noise, vector_biases=False), jax.jit(simulate_errors)
    for i in range(3):
        scenario = jax.tree.map(lambda a, i=i: a[i], (several.samples, several.initial))
        for ours, theirs in zip(tracks, alone(filter, *scenario), strict=True):
            for same in range(i, 26, 3):
                np.testing.assert_allclose(ours[same], theirs, rtol=1e-3, atol=1e-5)
    assert tracks.position.shape == (26, 200)
    assert not np.allclose(tracks.position[0], tracks.position[1])


def test_only_with_vector_biases_are_there_such_states() -> None:
    for vector_biases in (False, True):
        batch = kalman_scenarios(
            TINY, quietly(TINY), training_keys(0, 3), vector_biases=vector_biases
        )
        start = batch.filter.start(jax.tree.map(lambda a: a[0], batch.initial), 2)
        assert len(start.covariance) == (18 if vector_biases else 12)
        assert batch.samples.sample.vectors.each[0].measured[0].shape == (3, 200), (
            "each, as measured"
        )
