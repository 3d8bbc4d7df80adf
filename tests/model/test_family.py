"""Scenario families: what is drawn, what is not touched, and that keys stay apart."""

from dataclasses import fields
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from jax import Array
from scipy import stats
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from posegsa import config
from posegsa.config import Experiment, FamilyConfig
from posegsa.config.family_config import (
    BurstsConfig,
    InTurn,
    JumpsConfig,
    NoiseJumpsConfig,
    Outages,
)
from posegsa.config.shipped import find as config_file
from posegsa.errors import ConfigError, PosegsaWarning
from posegsa.judging.metrics import error_tracks, metrics_of
from posegsa.model.family import Family, draw_scenario, realise
from posegsa.model.scenario import Scenario
from posegsa.model.schedules import ConstantGain
from posegsa.model.se3 import attitude_distance, quaternion, rotation_angle, unstack
from posegsa.report import NO_FAMILY
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import all_scenarios, family, scenario
from posegsa.search.keys import Keys, keys, scenario_keys
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import tuning_problem

SHORT = Experiment(
    scenario=config.ScenarioConfig(duration=0.2),
    cost=config.CostConfig(transient_window=(0, 5), steady_window=(10, 19)),
)

OUTAGES = Outages(rate=0.1, duration=(1.0, 5.0))
BURSTS = BurstsConfig(rate=0.2, duration=(0.5, 2.0), size=0.7)
OWN_BURSTS = BurstsConfig(rate=0.05, duration=(0.5, 3.0), size=(0.5, 3.0), each=True)
NOISE_JUMPS = NoiseJumpsConfig(rate=0.1, factor=(0.5, 4.0))
IN_TURN = InTurn(duration=(1.0, 3.0), begin=3.0)
JUMPS = JumpsConfig(rate=0.1, angle=(10.0, 90.0), distance=(0.5, 3.0))
EVERYTHING = {
    "attitude_error": (0.0, 180.0),
    "position_error": (0.0, 10.0),
    "bias_scale": (0.0, 2.0),
    "noise_scale": (0.5, 2.0),
    "landmark_spread": 1.0,
    "motion_scale": (0.5, 2.0),
    "vector_bias": 0.1,
    "landmark_bias": 0.2,
    "angular_velocity_drift": (0.0, 0.01),
    "velocity_drift": (0.1, 0.2),
    "outages": OUTAGES,
    "bursts": BURSTS,
    "landmark_bursts": OWN_BURSTS,
    "noise_jumps": NOISE_JUMPS,
    "landmarks_in_turn": IN_TURN,
    "jumps": JUMPS,
    "landmark_interval": (0.02, 0.2),
    "rest": (5.0, 15.0),
    "duration": (10.0, 60.0),
    "random_phase": True,
}
"""Every setting that varies something; the rest of the section says how."""
COUNT = 2000

one_drawn, draw_many = (
    jax.jit(draw_scenario),
    jax.jit(jax.vmap(draw_scenario, in_axes=(None, None, 0))),
)
realised = jax.jit(realise)


@pytest.fixture(scope="module")
def base():
    return scenario(SHORT)


def varied(dtype: str = "float32", **settings) -> Family:
    """The family of a [family] section, for the short scenario."""
    return family(
        SHORT.model_copy(update={"family": FamilyConfig(**{**dict(NO_FAMILY), **settings})}), dtype
    )


@cache
def many_keys() -> Array:
    return scenario_keys(jax.random.key(0), COUNT)


def drawn(base, **settings) -> Scenario:
    """Many scenarios of a family, arrays (COUNT, ...), in which everything else varies too.

    So all of them are drawn by one program.
    """
    many = draw_many(base, varied(**{**EVERYTHING, **settings}), many_keys())
    return jax.tree.map(np.asarray, many)


def initial_angles(scenarios) -> np.ndarray:
    """Initial attitude errors [deg]."""
    q_est, q = (unstack(quaternion(R)) for R in (scenarios.rotation_estimate, scenarios.rotation))
    return np.degrees(rotation_angle(attitude_distance(q_est, q)))


def test_without_variation_a_scenario_is_unchanged(base):
    one = one_drawn(base, varied(), jax.random.key(4))
    for before, after in zip(jax.tree.leaves(base), jax.tree.leaves(one), strict=True):
        np.testing.assert_array_equal(before, after)


def test_initial_angles_fill_their_range(base):
    angles = initial_angles(drawn(base, attitude_error=(20.0, 180.0)))
    # float32 quaternions give angles near 180 degrees to about 0.05 degrees.
    assert angles.min() >= 19.9
    assert angles.max() <= 180.0
    assert np.percentile(angles, 10) < 45
    assert np.percentile(angles, 90) > 155


def test_the_axis_of_the_initial_error_has_no_direction(base):
    scenarios = drawn(base, attitude_error=(90.0, 90.0))
    R_err = scenarios.rotation_estimate @ np.swapaxes(scenarios.rotation, -1, -2)
    axis = np.stack([R_err[:, 2, 1] - R_err[:, 1, 2], R_err[:, 0, 2] - R_err[:, 2, 0]]) / 2
    # Means of 2000 coordinates of unit vectors: standard deviation 0.013.
    assert np.abs(axis.mean(axis=1)).max() < 0.05


def test_initial_position_errors_fill_their_range(base):
    scenarios = drawn(base, position_error=(1.0, 10.0), attitude_error=(0.0, 180.0))
    R_err = scenarios.rotation_estimate @ np.swapaxes(scenarios.rotation, -1, -2)
    moved = np.einsum("sij,sj->si", R_err, scenarios.position)
    length = np.linalg.norm(scenarios.position_estimate - moved, axis=-1)
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


CHANGED = {
    "attitude_error": ("rotation_estimate",),
    "bias_scale": ("bias",),
    "noise_scale": ("angular_noise", "linear_noise", "vector_noise", "landmark_noise"),
    "landmark_spread": ("landmarks",),
    "vector_bias": ("vector_bias",),
    "landmark_bias": ("landmark_bias",),
    "outages": ("vector_outages", "landmark_outages"),
    "bursts": ("bursts",),
    "landmark_bursts": ("landmark_bursts",),
    "noise_jumps": ("noise_jumps",),
    "landmarks_in_turn": ("landmark_turns",),
    "jumps": ("jumps",),
    "landmark_interval": ("landmark_period",),
    "rest": ("rest",),
    "duration": ("end",),
}
"""The fields that only this setting changes."""


def test_varying_one_thing_does_not_change_what_is_drawn_of_another(base):
    assert set(EVERYTHING) <= set(FamilyConfig.model_fields)
    # `bias_scale` is a factor on the drawn biases too.
    biases = {"angular_velocity_bias", "velocity_bias"}
    assert set(FamilyConfig.model_fields) - set(EVERYTHING) == {"rest_share"} | biases
    chosen = {name: varied(**{name: EVERYTHING[name]}) for name in CHANGED}
    # Outages alone have as many windows as together with these bursts; the draws depend on that.
    assert chosen["outages"].outages.most == varied(**EVERYTHING).outages.most
    draws = jax.jit(
        lambda families, key: {n: draw_scenario(base, f, key) for n, f in families.items()}
    )
    # A single scenario with one setting varied, and one of many with all varied.
    each = draws(chosen, many_keys()[3])
    together = jax.tree.map(lambda a: a[3], drawn(base))
    for name, one in each.items():
        for field in (f.name for f in fields(Scenario) if f.name != "samples"):
            mine = field in CHANGED[name]
            wanted = getattr(together if mine else base, field)
            if name == "attitude_error" and field == "position_estimate":
                continue  # turned with the attitude, about the true position
            for a, b in zip(
                jax.tree.leaves(getattr(one, field)), jax.tree.leaves(wanted), strict=True
            ):
                close = {"rtol": 1e-6, "atol": 1e-6 if mine else 0}
                np.testing.assert_allclose(a, b, **close, err_msg=f"{name}: {field}")
            if mine:
                before, after = (jax.tree.leaves(getattr(a, field))[0] for a in (base, one))
                assert not np.array_equal(before, after), (name, field)


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_after_its_end_a_scenario_no_longer_counts() -> None:
    short = tiny("family.duration=[1.6, 1.9]")
    candidate = Candidate(ConstantGain(jnp.float32(9.0)))
    problem = tuning_problem(short)
    costs = costs_by_scenario(jax.tree.map(lambda a: a[None], candidate), problem.training)[:, 0]
    tracks = error_tracks(candidate, problem.training)
    end = np.asarray(problem.training.end)
    assert (end >= 1.6).all()
    assert (end <= 1.9).all()
    time, k = np.asarray(problem.training.samples.time[0]), np.arange(200)
    first, last = short.cost.transient_window
    weights = 0.3 * ((k >= first) & (k <= last)) + (k >= 150)
    error = tracks.attitude + 0.2 * tracks.position
    by_hand = (weights * error * (time < end[:, None])).sum(axis=1)
    np.testing.assert_allclose(costs, by_hand, rtol=1e-5)
    metrics, _ = metrics_of(tracks, problem.training)
    np.testing.assert_allclose(metrics.cost, by_hand, rtol=1e-5)
    later = (time < end[:, None]) & (k >= 150)
    rms = [np.sqrt(np.mean(p[w] ** 2)) for p, w in zip(tracks.position, later, strict=True)]
    np.testing.assert_allclose(metrics.rms_position, rms, rtol=1e-5)


def test_outages_come_at_random_and_last_as_long_as_they_may(base):
    windows = np.asarray(drawn(base).vector_outages, np.float64)
    lengths = windows[..., 1] - windows[..., 0]
    assert lengths.min() >= 1 - 1e-3
    assert lengths.max() <= 5 + 1e-3
    count = lengths.size
    assert lengths.mean() == pytest.approx(3, abs=5 * 4 / np.sqrt(12 * count))
    # The time from the end of one to the next is exponential: of mean and deviation 1 / rate.
    ends = np.concatenate([np.zeros((len(windows), 1)), windows[:, :-1, 1]], axis=1)
    gaps = windows[..., 0] - ends
    assert gaps.min() > -1e-3
    assert gaps.mean() == pytest.approx(10, abs=5 * 10 / np.sqrt(count))
    assert gaps.std() == pytest.approx(10, abs=5 * 10 * np.sqrt(2 / count))


@pytest.mark.parametrize("sensors", ["all", "vectors", "landmarks"])
def test_an_outage_is_of_the_sensors_asked_for(base, sensors):
    outages = Outages(rate=0.1, sensors=sensors)
    one = jax.eval_shape(draw_scenario, base, varied(outages=outages), jax.random.key(0))
    for name in ("vectors", "landmarks"):
        windows = getattr(one, f"{name.removesuffix('s')}_outages")
        assert (windows.shape[0] > 0) == (sensors in ("all", name))


def test_nothing_happens_at_a_rate_of_zero_and_only_the_noise_differs(base):
    never = varied(outages=Outages(rate=0.0))
    (one, _, sensed), (_, _, other) = (realised(base, never, jax.random.key(i)) for i in (0, 1))
    windows = np.asarray(one.vector_outages)
    assert not np.isnan(windows).any()
    assert (windows[:, 0] > 1e9).all()
    assert (np.asarray(sensed.measurements.vector_weights) == 1).all()
    # Except for the noise.
    assert not np.array_equal(sensed.measurements.velocity, other.measurements.velocity)


def test_bursts_hit_one_vector_in_any_direction_with_their_size(base):
    bursts = drawn(base).bursts
    length = np.linalg.norm(bursts.offset, axis=-1)  # (COUNT, vectors, bursts)
    np.testing.assert_allclose(length.sum(axis=1), 0.7, rtol=1e-5)
    assert ((length > 0).sum(axis=1) == 1).all()
    count = length[:, 0].size
    assert np.mean(length[:, 0] > 0) == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(count))
    # Coordinates of unit vectors have the deviation 1 / sqrt(3).
    limit = 5 * 0.7 / np.sqrt(3 * count)
    assert np.abs(np.mean(bursts.offset.sum(axis=1), axis=(0, 1))).max() < limit
    np.testing.assert_array_equal(bursts.window[:, 0], bursts.window[:, 1])


def poisson(begin: np.ndarray, end: np.ndarray, rate: float) -> None:
    """Check that events (..., w) start at a rate after the last one's end [1/s, s]."""
    before = np.concatenate([np.zeros((*begin.shape[:-1], 1)), end[..., :-1]], axis=-1)
    gaps = begin - before
    # An exponential distribution: mean and deviation 1 / rate; those of the estimates follow.
    limit = 5 / rate / np.sqrt(gaps.size)
    assert gaps.min() > -1e-3
    assert gaps.mean() == pytest.approx(1 / rate, abs=limit)
    assert gaps.std() == pytest.approx(1 / rate, abs=np.sqrt(2) * limit)
    assert np.mean(gaps > 2 / rate) == pytest.approx(np.exp(-2), abs=5 * 0.35 / np.sqrt(gaps.size))


def uniform(values: np.ndarray, low: float, high: float) -> None:
    """Check that values are uniform between two ends."""
    z = (np.asarray(values, np.float64).ravel() - low) / (high - low)
    assert z.min() > -1e-4
    assert z.max() < 1 + 1e-4
    # The largest distance to the uniform distribution (Kolmogorov), exceeded with chance 1e-7.
    assert stats.kstest(z, "uniform").statistic < 2.9 / np.sqrt(z.size)


def test_each_sensor_has_bursts_of_its_own_of_drawn_sizes(base):
    landmarks = tuple(config.Landmark(position=p) for p in np.eye(3).tolist())
    three = SHORT.model_copy(
        update={"scenario": SHORT.scenario.model_copy(update={"landmarks": landmarks})}
    )
    made = varied(landmark_bursts=OWN_BURSTS, bursts=OWN_BURSTS)
    many = jax.tree.map(np.asarray, draw_many(scenario(three), made, many_keys()))
    for bursts, sensors in ((many.bursts, 2), (many.landmark_bursts, 3)):
        window = bursts.window.astype(np.float64)
        assert window.shape[:2] == (COUNT, sensors)
        poisson(window[..., 0], window[..., 1], 0.05)
        uniform(window[..., 1] - window[..., 0], 0.5, 3.0)
        uniform(np.linalg.norm(bursts.offset, axis=-1), 0.5, 3.0)
        first = window[:, :, 0, 0] - window[:, :, 0, 0].mean(axis=0)
        correlation = np.corrcoef(first.T) - np.eye(sensors)
        assert np.abs(correlation).max() < 5 / np.sqrt(COUNT)
    assert np.abs(many.bursts.window[:, 0] - many.landmark_bursts.window[:, 0]).min() > 0


def test_the_noise_of_each_sensor_jumps_to_log_uniform_factors(base):
    jumps = drawn(base).noise_jumps
    assert jumps.time.shape[:2] == (COUNT, 2 + 2 + 1)
    poisson(jumps.time.astype(np.float64), jumps.time.astype(np.float64), 0.1)
    uniform(np.log(jumps.factor), np.log(0.5), np.log(4.0))
    first = np.concatenate([jumps.time[:, :, 0], np.log(jumps.factor[:, :, 0])], axis=1)
    assert np.abs(np.corrcoef(first.T) - np.eye(10)).max() < 5 / np.sqrt(COUNT)


def test_landmarks_come_into_sight_one_after_the_other(base):
    turns = np.asarray(drawn(base).landmark_turns, np.float64)
    np.testing.assert_array_equal(turns[:, 0], 3)
    uniform(np.diff(turns), 1, 3)


def test_the_body_jumps_about_any_axis_in_any_direction(base):
    jumps = drawn(base).jumps
    poisson(jumps.time.astype(np.float64), jumps.time.astype(np.float64), 0.1)
    twist = jumps.twist.reshape(-1, 6).astype(np.float64)
    matrices = np.zeros((len(twist), 4, 4))
    matrices[:, :3, :3] = [[[0, -z, y], [z, 0, -x], [-y, x, 0]] for x, y, z in twist[:, :3]]
    matrices[:, :3, 3] = twist[:, 3:]
    T = expm(matrices)
    angle = Rotation.from_matrix(T[:, :3, :3]).magnitude()
    distance = np.linalg.norm(T[:, :3, 3], axis=1)
    uniform(np.degrees(angle), 10, 90)
    uniform(distance, 0.5, 3)
    for vectors, length in ((twist[:, :3], angle), (T[:, :3, 3], distance)):
        unit = vectors / length[:, None]
        for coordinate in unit.T:  # of a vector that is uniform on the sphere (Archimedes)
            uniform(coordinate, -1, 1)


def test_biases_of_the_velocities_have_mean_zero_and_may_be_scaled(base):
    settings = {"angular_velocity_bias": 0.1, "velocity_bias": 0.3}
    bias = np.asarray(draw_many(base, varied(**settings), many_keys()).bias)
    for part, deviation in ((bias[:, :3], 0.1), (bias[:, 3:], 0.3)):
        assert stats.kstest(part.ravel() / deviation, "norm").statistic < 2.9 / np.sqrt(part.size)
    assert np.abs(np.corrcoef(bias.T) - np.eye(6)).max() < 5 / np.sqrt(COUNT)
    one = draw_many(base, varied(velocity_bias=0.3), many_keys())
    np.testing.assert_array_equal(one.bias[:, 3:], bias[:, 3:])
    np.testing.assert_array_equal(one.bias[:, :3], np.tile(base.bias[:3], (COUNT, 1)))
    twice = varied(**settings, bias_scale=(2.0, 2.0))
    np.testing.assert_allclose(draw_many(base, twice, many_keys()).bias, 2 * bias, rtol=1e-6)


def shipped(name: str) -> config.Experiment:
    """A shipped configuration with few scenarios."""
    few = ["run.training_scenarios=8", "run.held_out_scenarios=8"]
    return config.override(config.load(config_file(name)), few)


def test_disturbed_sensors_show_a_pose_at_once_and_sparse_ones_wait_for_it():
    for name, waits in (("disturbed", 0.0), ("sparse", 3.0)):
        experiment = config.override(shipped(name), ["scenario.start=sensors"])
        batch = all_scenarios(experiment)
        # At 0 or 3 s only an outage hides a pose.
        first = np.asarray(batch.begin)
        assert np.median(first) == pytest.approx(waits, abs=1e-5)
        assert (first > waits - 1e-5).all()
        at = np.round(first / 0.01).astype(int)
        rows = np.arange(len(at))
        for vector in batch.samples.sample.vectors.each:
            assert (np.asarray(vector.factor)[rows, at] > 0).all()


def test_a_start_that_no_sample_determines_is_warned_of():
    never = ["scenario.start=sensors", "scenario.vectors.1.begin=1000.0"]
    experiment = config.override(config.override(SHORT, never), ["run.training_scenarios=2"])
    with pytest.warns(PosegsaWarning, match=r"scenario\.start = 'sensors': in \d+ of \d+ .*fixes"):
        all_scenarios(experiment)


def test_biases_drifts_rests_periods_and_ends_fill_their_ranges(base):
    scenarios = drawn(base, rest_share=0.3)
    for name, deviation in (("vector_bias", 0.1), ("landmark_bias", 0.2)):
        bias = np.asarray(getattr(scenarios, name))
        assert bias.shape == (COUNT, *np.shape(getattr(base, name)))
        assert bias.std() == pytest.approx(deviation, rel=5 / np.sqrt(2 * bias.size))
        assert np.abs(bias.mean(axis=0)).max() < 5 * deviation / np.sqrt(COUNT)
    drift = np.asarray(scenarios.bias_drift)
    np.testing.assert_array_equal(drift[:, [0, 3]], drift[:, [2, 5]])  # one for all three axes
    period, end = np.asarray(scenarios.landmark_period), np.asarray(scenarios.end)
    for values, low, high in (
        (drift[:, 0], 0, 0.01),
        (drift[:, 3], 0.1, 0.2),
        (period, 2, 20),
        (end, 10, 60),
    ):
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
    rest = np.asarray(scenarios.rest)[:, -1]
    assert (rest[:, 0] == 0).all()
    resting = rest[:, 1] > 0
    assert resting.mean() == pytest.approx(0.3, abs=5 * np.sqrt(0.3 * 0.7 / COUNT))
    assert 5 <= rest[resting, 1].min() < 6
    assert 14 < rest[resting, 1].max() <= 15


def test_a_key_means_the_same_scenario_in_both_precisions(base):
    single = jax.tree.map(lambda a: a[7], drawn(base))
    with jax.enable_x64(True):
        exact = scenario(config.override(SHORT, ["run.dtype=float64"]))
        double = one_drawn(exact, varied("float64", **EVERYTHING), many_keys()[7])
        for a, b in zip(jax.tree.leaves(single), jax.tree.leaves(double), strict=True):
            # Lengths of up to 10 m, times of up to 400 s.
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    "key", ["attitude_error", "position_error", "bias_scale", "rest", "duration", "velocity_drift"]
)
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
