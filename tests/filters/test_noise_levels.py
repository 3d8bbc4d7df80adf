"""The noise of each sensor, found from how far its successive samples differ."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import as_arrays
from helpers.filters import state_of
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from posegsa import config
from posegsa.errors import ArgumentError
from posegsa.filters.base import Sensors, samples_of
from posegsa.filters.noise_levels import BOUNDS, LARGEST, NoiseLevel, NoiseLevels, next_level
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import run_filter
from posegsa.search.configured_filters import filter_of

pytestmark = pytest.mark.usefixtures("x64")
STEP, SAMPLES, STATED, MEMORY = 0.01, 6000, 0.05, 100.0
VECTORS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
LANDMARKS = np.array([[2.0, 1.0, 0.0], [-2.0, 1.0, 1.0], [0.0, -2.0, 0.5]])


def flight(
    vector: float = 1.0,
    landmark: float = 1.0,
    gyroscope: float = 1.0,
    velocity: float = 1.0,
    disturbed: bool = False,
) -> Recording:
    """A body that turns about a fixed point, its sensors with so many times the stated noise.

    If it is disturbed, one vector is off by 1 for 3 s in each 10 s.
    """
    time, rng = STEP * np.arange(SAMPLES), np.random.default_rng(5)
    turn = Rotation.from_rotvec(time[:, None] * np.array([0.3, -0.5, 0.4]))
    R = turn.as_matrix()
    a, b, c, d = (times * STATED for times in (vector, landmark, gyroscope, velocity))
    vectors = np.einsum("kji,nj->kni", R, VECTORS) + a * rng.normal(size=(SAMPLES, 2, 3))
    if disturbed:
        vectors[time % 10 > 7, 0, 0] += 1
    landmarks = np.einsum("kji,nj->kni", R, LANDMARKS) + b * rng.normal(size=(SAMPLES, 3, 3))
    return Recording.from_arrays(
        time=time,
        angular_velocity=[0.3, -0.5, 0.4] + c * rng.normal(size=(SAMPLES, 3)),
        velocity=d * rng.normal(size=(SAMPLES, 3)),
        vectors=vectors,
        vector_references=VECTORS,
        landmarks=landmarks,
        landmark_references=LANDMARKS,
        truth_quaternion=turn.as_quat(scalar_first=True),
        truth_position=np.zeros((SAMPLES, 3)),
    )


def experiment(adaptation: float | str = MEMORY) -> config.Experiment:
    """With the stated noises; of 12 states, which are compiled in half the time of 18."""
    filter: dict[str, Any] = {"kind": "kalman", "vector_bias": "off", "vector": STATED}
    density = STATED * STEP**0.5
    filter |= {"landmark": STATED, "angular_velocity": density, "velocity": density}
    filter |= {"noise_adaptation": adaptation, "initial_attitude": 0.05, "initial_position": 0.05}
    return config.from_dict({"run": {"dtype": "float64"}, "filter": filter, "parameters": {}})


def levels(recording: Recording) -> NoiseLevels:
    """The levels at each sample, from a start at the truth."""
    filter = filter_of(experiment())
    samples = samples_of(filter, as_arrays(recording.measurements, np.float64))
    start = filter.start(state_of(np.eye(4)), Sensors(2, 3))

    @jax.jit
    def run(filter, samples, start):
        filter = filter.ready()
        return jax.lax.scan(lambda s, now: (filter.step(s, now)[0], s.levels), start, samples)[1]

    return jax.tree.map(np.asarray, run(filter, samples, start))


def deviation(level: NoiseLevel) -> float:
    """Mean over the last half of a flight, as a multiple of what is stated."""
    return float(np.mean(np.sqrt(level.factor[SAMPLES // 2 :])))


def mean_nis(adaptation: float | str, **noise: float) -> float:
    """Over the last half of a flight; 1 if the covariance is right."""
    nis = run_filter(filter_of(experiment(adaptation)), flight(**noise)).nis
    assert nis is not None
    return float(np.mean(nis[SAMPLES // 2 :]))


def test_it_finds_the_noise_of_each_sensor_by_itself() -> None:
    found = levels(flight(vector=3.0, landmark=1 / 3, gyroscope=2.0, velocity=0.5))
    assert [deviation(one) for one in found.vectors] == pytest.approx([3, 3], rel=0.05)
    assert [deviation(one) for one in found.landmarks] == pytest.approx([1 / 3] * 3, rel=0.05)
    assert deviation(found.angular_velocity) == pytest.approx(2, rel=0.05)
    assert deviation(found.velocity) == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("times", [3.0, 1 / 3])
def test_it_makes_the_covariance_right(times: float) -> None:
    noise = dict.fromkeys(("vector", "landmark", "gyroscope", "velocity"), times)
    assert mean_nis(MEMORY, **noise) == pytest.approx(1, rel=0.1)
    assert mean_nis("off", **noise) == pytest.approx(times**2, rel=0.2)


def test_a_vector_that_is_off_for_a_while_is_not_noisy() -> None:
    found = levels(flight(disturbed=True)).vectors
    assert deviation(found[0]) == pytest.approx(deviation(found[1]), rel=0.05)
    assert np.max(np.sqrt(found[0].factor)) < 1.3


def random_level(rng: np.random.Generator, known: float) -> NoiseLevel:
    last = tuple(jnp.asarray(x) for x in rng.normal(size=3))
    return NoiseLevel(jnp.asarray(rng.uniform(0.5, 2.0)), last, jnp.asarray(known))


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_it_is_the_recursion_that_its_page_states(size: float) -> None:
    rng = np.random.default_rng(0)
    level, now = random_level(rng, known=1.0), size * rng.normal(size=3)
    q = np.sum((now - np.array(level.last)) ** 2) / (6 * 0.7)
    f = float(level.factor)
    expected = f * (1 + (min(q / f, LARGEST) - 1) / 20)
    numbers = jnp.asarray(0.7), jnp.asarray(True), jnp.asarray(20.0)
    after = next_level(level, tuple(map(jnp.asarray, now)), *numbers)
    assert float(after.factor) == pytest.approx(expected, rel=1e-12)
    np.testing.assert_array_equal(after.last, now)


def test_a_sample_that_is_missing_changes_nothing_and_the_first_no_factor() -> None:
    rng = np.random.default_rng(1)
    level, now = random_level(rng, known=1.0), tuple(map(jnp.asarray, rng.normal(size=3)))
    one, memory = jnp.asarray(1.0), jnp.asarray(20.0)
    missing = next_level(level, (jnp.asarray(np.nan),) * 3, one, jnp.asarray(False), memory)
    jax.tree.map(np.testing.assert_array_equal, missing, level)
    first = next_level(level._replace(known=0 * one), now, one, jnp.asarray(True), memory)
    assert float(first.factor) == float(level.factor)
    assert float(first.known) == 1
    np.testing.assert_array_equal(first.last, now)


def test_it_stays_within_a_tenth_and_ten_times() -> None:
    level, memory = random_level(np.random.default_rng(2), known=1.0), jnp.asarray(1.0)
    for variance, bound in ((1e-30, BOUNDS[1]), (1e30, BOUNDS[0])):
        for k in range(9):
            now = (jnp.asarray(float(k % 2)),) * 3
            level = next_level(level, now, jnp.asarray(variance), jnp.asarray(True), memory)
        assert float(level.factor) == bound


def test_the_bound_of_a_jump_hardly_biases_it() -> None:
    """The mean of min(q, 5) for three components of white noise."""
    q = chi2(3, scale=1 / 3)
    mean = q.expect(lambda x: np.minimum(x, LARGEST), lb=0, ub=40)
    assert mean == pytest.approx(1, abs=0.005)
    assert q.sf(LARGEST) == pytest.approx(0.002, abs=0.0005)


def test_a_filter_without_it_has_no_levels_and_no_such_number() -> None:
    filter = filter_of(experiment("off"))
    assert filter.start(state_of(np.eye(4)), Sensors(2, 3)).levels == ()
    with pytest.raises(ArgumentError, match="noise_adaptation: not a number of this filter"):
        filter.with_values({"noise_adaptation": jnp.asarray(1.0)})
