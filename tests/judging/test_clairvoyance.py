"""The clairvoyant's costs: paired with other filters', and independent of the events it knows."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posegsa import config
from posegsa.config.shipped import find
from posegsa.errors import ArgumentError
from posegsa.filters.kalman import KalmanFilter, KalmanNoise
from posegsa.filters.rollout import simulate_cost
from posegsa.judging.clairvoyance import INITIAL_DEVIATION, clairvoyant_costs
from posegsa.model.estimate import initial_state
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys

SHORT = (
    *("scenario.duration=8.0", "cost.steady_window=[400, 700]"),
    *("run.held_out_scenarios=6", "run.training_scenarios=1"),
)


def short(name: str, *settings: str) -> config.Experiment:
    """A shipped configuration with six scenarios of 8 s."""
    return config.override(config.load(find(name)), [*SHORT, *settings])


@pytest.mark.parametrize("start", ["given", "sensors"])
def test_where_nothing_happens_it_is_the_kalman_filter_from_the_true_pose(start: str) -> None:
    experiment = short(
        "kalman",
        f"scenario.start={start}",
        "family.angular_velocity_bias=0.2",
        "family.noise_scale=[2.0, 2.0]",
        "family.outages={rate=0.1}",
    )
    keys = held_out_keys(experiment.run.seed, 6)
    batch = scenario_batch(experiment, keys)
    numbers = dict.fromkeys(KalmanNoise._fields, 0.0) | {
        "angular_velocity": 2 * 0.2 * 0.1,  # twice the noise, in samples of 0.01 s
        "velocity": 2 * 0.1 * 0.1,
        "vector": 2 * 0.1,
        "landmark": 2 * 0.1,
        "initial_attitude": INITIAL_DEVIATION,
        "initial_position": INITIAL_DEVIATION,
        "initial_angular_bias": 0.2,  # as drawn
        "initial_linear_bias": np.sqrt((0.2**2 + 0.5**2 + 0.1**2) / 3),  # as configured
        "initial_vector_bias": np.sqrt(4 * 0.1**2 / 6),
    }
    filter = KalmanFilter(KalmanNoise(**{k: jnp.float32(v) for k, v in numbers.items()}))
    wanted = []
    run = jax.jit(simulate_cost)
    for i in range(6):
        one = batch.select(slice(i, i + 1))
        samples: Any = jax.tree.map(lambda a: jnp.asarray(a[0]), one.samples)
        begin = None if one.begin is None else one.begin[0]
        first = 0 if begin is None else round(float(begin) / 0.01)
        w, x, y, z = (float(a[first]) for a in samples.truth.attitude)
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ],
            np.float32,
        )
        P = R @ np.array([float(a[first]) for a in samples.truth.origin], np.float32)
        weights = batch.weights.between(samples.time, begin, None)
        wanted.append(float(run(filter, samples, initial_state(R, P), weights).total))
    np.testing.assert_allclose(clairvoyant_costs(experiment), wanted, rtol=2e-3)
    # As many as before, so that nothing is compiled anew.
    others = clairvoyant_costs(experiment, keys[::-1])
    np.testing.assert_allclose(others, wanted[::-1], rtol=2e-3)


def test_bursts_of_any_size_cost_it_the_same() -> None:
    costs = [
        clairvoyant_costs(
            short(
                "disturbed",
                f"family.bursts.size={size}",
                f"family.landmark_bursts.size={2 * size}",
                "family.bursts.rate=0.3",
                "family.landmark_bursts.rate=0.3",
            )
        )
        for size in (0.5, 50.0)
    ]
    np.testing.assert_array_equal(*costs)


def test_jumps_of_the_body_cost_it_little() -> None:
    jumping, still = (
        clairvoyant_costs(short("sparse", f"family.jumps={jumps}"))
        for jumps in ("{rate=0.5, angle=[60, 90], distance=[2, 3]}", "off")
    )
    # Two or three jumps a scenario; one that it did not follow would cost 0.5 a sample. A
    # displacement moves the origin about which the cost's position error is measured.
    assert np.all(jumping < still + 20)
    assert np.mean(jumping) < 1.5 * np.mean(still)


def test_keys_of_another_generator_are_refused() -> None:
    experiment = short("disturbed")
    for keys in (jax.random.split(jax.random.key(0, impl="rbg"), 2), held_out_keys(0, 2)[:0]):
        with pytest.raises(ArgumentError, match="keys of shape"):
            clairvoyant_costs(experiment, keys)
