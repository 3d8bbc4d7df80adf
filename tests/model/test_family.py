"""Scenario families: what is drawn, what is not touched, and that keys stay apart."""

import jax
import numpy as np
import pytest
from builders import quietly
from jax import Array

from posegsa import config
from posegsa.config import Experiment, FamilyConfig
from posegsa.errors import ConfigError
from posegsa.model.family import draw_scenario, realise
from posegsa.model.se3 import attitude_distance, quaternion, rotation_angle, unstack
from posegsa.search.build import family
from posegsa.search.keys import Keys, keys, scenario_keys

SHORT = Experiment(
    scenario=config.ScenarioConfig(duration=0.2),
    cost=config.CostConfig(transient_window=(0, 5), steady_window=(10, 19)),
)

one_drawn, draw_many = (
    jax.jit(draw_scenario),
    jax.jit(jax.vmap(draw_scenario, in_axes=(None, None, 0))),
)
realised = jax.jit(realise)


@pytest.fixture(scope="module")
def base():
    return quietly(SHORT)


def drawn(base, count: int = 200, **settings):
    """Many scenarios of a family, leaves (count, ...)."""
    chosen = family(FamilyConfig(**settings), "float32")
    return draw_many(base, chosen, scenario_keys(jax.random.key(0), count))


@jax.jit
def angles_between(R_est: Array, R: Array) -> Array:
    q_est, q = (unstack(quaternion(R)) for R in (R_est, R))
    return rotation_angle(attitude_distance(q_est, q))


def initial_angles(scenarios) -> np.ndarray:
    """Initial attitude errors [deg]."""
    return np.degrees(angles_between(scenarios.rotation_estimate, scenarios.rotation))


def attitude_errors(scenarios) -> np.ndarray:
    """R_err (count, 3, 3)."""
    R_est, R = np.asarray(scenarios.rotation_estimate), np.asarray(scenarios.rotation)
    return R_est @ np.swapaxes(R, -1, -2)


def test_by_default_only_the_noise_differs(base):
    one = one_drawn(base, family(FamilyConfig(), "float32"), jax.random.key(4))
    for before, after in zip(jax.tree.leaves(base), jax.tree.leaves(one), strict=True):
        np.testing.assert_array_equal(before, after)
    first, second = (
        realised(base, family(FamilyConfig(), "float32"), jax.random.key(i))[2] for i in (0, 1)
    )
    assert not np.array_equal(first.velocity, second.velocity)


def test_initial_angles_fill_their_range(base):
    angles = initial_angles(drawn(base, attitude_error=(20.0, 180.0)))
    # float32 quaternions give angles near 180 degrees to about 0.05 degrees.
    assert angles.min() >= 19.9
    assert angles.max() <= 180.0
    assert np.percentile(angles, 10) < 45
    assert np.percentile(angles, 90) > 155


def test_the_axis_of_the_initial_error_has_no_direction(base):
    scenarios = drawn(base, 2000, attitude_error=(90.0, 90.0))
    R_err = attitude_errors(scenarios)
    axis = np.stack([R_err[:, 2, 1] - R_err[:, 1, 2], R_err[:, 0, 2] - R_err[:, 2, 0]]) / 2
    # Means of 2000 coordinates of unit vectors: standard deviation 0.013.
    assert np.abs(axis.mean(axis=1)).max() < 0.05


def test_initial_position_errors_fill_their_range(base):
    scenarios = drawn(base, position_error=(1.0, 10.0), attitude_error=(0.0, 180.0))
    moved = np.einsum("sij,sj->si", attitude_errors(scenarios), scenarios.position)
    length = np.linalg.norm(np.asarray(scenarios.position_estimate) - moved, axis=-1)
    assert length.min() >= 1 - 1e-5
    assert length.max() <= 10 + 1e-5
    assert length.max() - length.min() > 8


def test_scales_spread_and_phases(base):
    scenarios = drawn(
        base,
        bias_scale=(0.5, 2.0),
        noise_scale=(0.5, 2.0),
        motion_scale=(0.5, 2.0),
        landmark_spread=0.5,
        random_phase=True,
    )
    for name in ("bias", "angular_noise", "vector_noise", "landmark_noise"):
        before, after = np.asarray(getattr(base, name)), np.asarray(getattr(scenarios, name))
        ratio = (after / before).reshape(len(after), -1)
        np.testing.assert_allclose(ratio, ratio[:, :1].repeat(ratio.shape[1], 1), rtol=1e-5)
        assert 0.5 <= ratio.min() < 0.7
        assert 1.8 < ratio.max() <= 2.0
    shift = np.asarray(scenarios.landmarks) - np.asarray(base.landmarks)
    assert 0.4 < np.abs(shift).max() <= 0.5 + 1e-6
    amplitude = np.asarray(scenarios.velocity.amplitude) / np.asarray(base.velocity.amplitude)
    assert 0.5 <= amplitude.min() < amplitude.max() <= 2.0 + 1e-6
    assert np.std(np.asarray(scenarios.angular_velocity.phase)[:, 0, 0]) > 1


def test_varying_one_thing_does_not_change_what_is_drawn_of_another(base):
    angles = initial_angles(drawn(base, attitude_error=(0.0, 180.0)))
    both = drawn(base, attitude_error=(0.0, 180.0), landmark_spread=1.0, bias_scale=(0.0, 2.0))
    np.testing.assert_array_equal(angles, initial_angles(both))


def test_a_key_means_the_same_scenario_in_both_precisions(base):
    settings = FamilyConfig(
        attitude_error=(0.0, 180.0), position_error=(0.0, 5.0), random_phase=True
    )
    single = one_drawn(base, family(settings, "float32"), jax.random.key(7))
    with jax.enable_x64(True):
        exact = quietly(config.override(SHORT, ["run.dtype=float64"]))
        double = one_drawn(exact, family(settings, "float64"), jax.random.key(7))
        np.testing.assert_allclose(single.rotation_estimate, double.rotation_estimate, atol=1e-6)
        np.testing.assert_allclose(single.position_estimate, double.position_estimate, atol=1e-5)


def test_vmap_equals_a_loop(base):
    chosen = family(FamilyConfig(attitude_error=(0.0, 180.0), landmark_spread=1.0), "float32")
    many = scenario_keys(jax.random.key(2), 3)
    together = draw_many(base, chosen, many)
    for i in range(3):
        alone = one_drawn(base, chosen, many[i])
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_allclose(a, b[i], atol=1e-6)


@pytest.mark.parametrize("key", ["attitude_error", "position_error", "bias_scale"])
def test_a_range_that_descends_is_refused_by_name(key):
    with pytest.raises(ConfigError, match=rf"family\.{key}"):
        config.override(Experiment(), [f"family.{key}=[2.0, 1.0]"])


def test_angles_over_180_degrees_are_refused():
    with pytest.raises(ConfigError, match=r"family\.attitude_error"):
        config.override(Experiment(), ["family.attitude_error=[0.0, 181.0]"])


def test_no_two_uses_share_a_scenario_key():
    seen = set()
    for seed in range(3):
        use = keys(seed)
        for name in Keys._fields:
            if name != "search":
                data = jax.random.key_data(scenario_keys(getattr(use, name), 300)).tolist()
                seen |= {tuple(k) for k in data}
    assert len(seen) == 3 * 300 * (len(Keys._fields) - 1)
