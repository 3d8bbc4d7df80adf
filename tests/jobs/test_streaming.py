"""The filter for streams: its estimates are those of the whole sequence at once."""

import dataclasses
import math
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.results import trust
from helpers.schedules import K, tuned
from helpers.streams import START, N, at_once, fed, learning_filter, stream

import posegsa
from posegsa.errors import ArgumentError, MeasurementError, PosegsaWarning
from posegsa.model.schedules import SwitchGain
from posegsa.stream_inputs import FIRST_SAMPLES

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def result() -> posegsa.Result:
    return learning_filter()


@pytest.fixture
def pose_filter(result) -> posegsa.PoseFilter:
    return posegsa.PoseFilter(result, **START)


# Results ------------------------------------------------------------------------------------------


def test_it_gives_what_a_whole_sequence_gives_at_once(result, pose_filter):
    steps, samples, references = stream(result)
    with jax.enable_x64(True):
        measurements = at_once(steps, samples, references, np.float64)
        expected = jax.tree.map(np.asarray, result.estimate(measurements, **START))
    before = [pose_filter.pose, *fed(pose_filter, steps, samples, slice(N - 1))]
    # Sample k of the sequence is the estimate before its update.
    for name in ("rotation", "position"):
        found = np.array([getattr(pose, name) for pose in before])
        assert found.dtype == np.float64
        np.testing.assert_allclose(found, getattr(expected, name), atol=1e-13)
    np.testing.assert_allclose(pose_filter.bias, expected.bias[-1], atol=1e-13)
    np.testing.assert_allclose(pose_filter.vector_bias, expected.vector_bias[-1], atol=1e-13)
    assert np.abs(pose_filter.vector_bias).max() > 0.01
    np.testing.assert_allclose(pose_filter.gain, expected.gain[-2], rtol=1e-12)
    np.testing.assert_allclose(pose_filter.gain_used, expected.gain_used[-2], rtol=1e-12)
    assert pose_filter.time == pytest.approx(steps[:-1].sum())


def test_in_float32_it_gives_the_same_to_its_rounding(result, pose_filter):
    steps, samples, _ = stream(result)
    single = posegsa.PoseFilter(learning_filter("float32"), **START)
    for mine, expected in zip(
        *(fed(f, steps, samples) for f in (single, pose_filter)), strict=True
    ):
        for array, other in zip(mine, expected, strict=True):
            assert array.dtype == np.float32
            np.testing.assert_allclose(array, other, atol=1e-5)
    for name in ("bias", "vector_bias"):
        found = getattr(single, name)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, getattr(pose_filter, name), atol=1e-5)
    for name in ("gain", "gain_used"):
        assert getattr(single, name) == pytest.approx(getattr(pose_filter, name), rel=1e-4)


def test_a_schedule_over_time_by_hand(result):
    steps, samples, references = stream(result)
    with jax.enable_x64(True):
        settings = posegsa.filter_settings(result.experiment)
        signal = posegsa.signal_settings(result.experiment.gain, "float64")
        # The gain switches, and bias estimation starts, between two samples.
        schedule = SwitchGain(*jnp.asarray([30.0, 4.0, steps[:19].sum() + 0.002, 0.1]))
        observer = posegsa.Observer(schedule, settings, signal)
        run = at_once(steps, samples, references, "float64"), posegsa.initial_state(**START)
        expected = jax.tree.map(np.asarray, posegsa.run_filter(observer, *run))
    pose_filter = posegsa.PoseFilter(observer, **START, **references)
    assert math.isnan(pose_filter.gain), "none was asked for yet"
    poses = fed(pose_filter, steps, samples, slice(N - 1))
    np.testing.assert_allclose([p.position for p in poses], expected.position[1:], atol=1e-13)
    np.testing.assert_allclose([p.rotation for p in poses], expected.rotation[1:], atol=1e-13)
    assert pose_filter.gain == 4


def test_a_filter_of_ones_own_numbers_is_that_of_the_result(result):
    steps, samples, references = stream(result)
    with jax.enable_x64(True):
        by_hand = posegsa.Observer(
            posegsa.FuzzyGain(result.controller),
            posegsa.filter_settings(result.experiment),
            posegsa.signal_settings(result.experiment.gain, "float64"),
        )
    filters = (
        posegsa.PoseFilter(by_hand, **START, **references),
        posegsa.PoseFilter(result, **START),
    )
    one, other = (fed(each, steps, samples)[-1] for each in filters)
    np.testing.assert_array_equal(one.position, other.position)


def test_a_kalman_filter_is_streamed_as_it_is_run(result):
    steps, samples, references = stream(result)
    noise = posegsa.KalmanNoise(*np.geomspace(0.01, 0.5, len(posegsa.KalmanNoise._fields)))
    with jax.enable_x64(True):
        filter = posegsa.KalmanFilter(jax.tree.map(jnp.asarray, noise))
        measured = at_once(steps, samples, references, "float64")
        expected = posegsa.run_filter(filter, measured, posegsa.initial_state(**START))
        expected = jax.tree.map(np.asarray, expected)
    pose_filter = posegsa.PoseFilter(filter, **START, **references)
    poses = fed(pose_filter, steps, samples, slice(N - 1))
    np.testing.assert_allclose([p.position for p in poses], expected.position[1:], atol=1e-12)
    np.testing.assert_allclose([p.rotation for p in poses], expected.rotation[1:], atol=1e-12)
    np.testing.assert_allclose(pose_filter.vector_bias, expected.vector_bias[-1], atol=1e-12)
    np.testing.assert_allclose(pose_filter.covariance, expected.covariance[-1], atol=1e-12)
    assert pose_filter.nis == pytest.approx(expected.nis[-2], rel=1e-9)
    assert math.isnan(pose_filter.gain), "it has none"


def test_an_observer_has_no_covariance(pose_filter):
    assert pose_filter.covariance is None
    assert math.isnan(pose_filter.nis)


def test_weights_of_a_sample_are_factors_on_those_of_the_filter(result):
    steps, samples, references = stream(result)
    factors = np.random.default_rng(1).uniform(0.2, 2, (N, 2))
    with jax.enable_x64(True):
        measurements = posegsa.Measurements.from_arrays(
            time_step=steps, **samples, **references, vector_weights=factors, dtype=np.float64
        )
        expected = np.asarray(result.estimate(measurements, **START).position)
    weighted = posegsa.PoseFilter(result, **START, vector_weights=[0.0, 5.0])
    fed(weighted, steps, {**samples, "vector_weights": factors}, slice(N - 1))
    np.testing.assert_allclose(weighted.pose.position, expected[-1], atol=1e-13)


def test_the_state_is_a_start_for_a_whole_sequence(result, pose_filter):
    steps, samples, _ = stream(result)
    fed(pose_filter, steps, samples, slice(10))
    state = pose_filter.state
    assert {a.dtype for a in jax.tree.leaves(state)} == {np.dtype("float64")}
    with jax.enable_x64(True):
        np.testing.assert_allclose(state.rotation, pose_filter.pose.rotation, atol=1e-15)
        np.testing.assert_array_equal(state.position, pose_filter.pose.position)
        np.testing.assert_array_equal(state.bias, pose_filter.bias)


# Missing measurements -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "missing"),
    [
        ("vectors", [None, [0.0, 1.0, 0.0]]),
        ("vectors", [[1.0, None, 0.0], [0.0, 1.0, 0.0]]),
        ("vectors", [np.zeros(3), [0.0, 1.0, 0.0]]),
        ("landmarks", None),
        ("landmarks", [None]),
        ("landmarks", [[1.0, 2.0, np.nan]]),
        ("landmarks", np.ma.masked_array([[1.0, 2.0, 999.0]], mask=[[False, False, True]])),
    ],
)
def test_whatever_is_missing_counts_alike(result, name, missing):
    steps, samples, _ = stream(result)
    poses = []
    absent = {"vectors": [[np.nan] * 3, [0.0, 1.0, 0.0]], "landmarks": [[np.nan] * 3]}
    for given in (missing, absent[name]):
        pose_filter = posegsa.PoseFilter(result, **START)
        fed(pose_filter, steps, samples, slice(3))
        sample = {key: a[3] for key, a in samples.items()} | {name: given}
        poses.append(pose_filter.update(time_step=0.01, **sample))
    np.testing.assert_array_equal(poses[0].rotation, poses[1].rotation)
    np.testing.assert_array_equal(poses[0].position, poses[1].position)


@pytest.mark.parametrize("name", ["angular_velocity", "velocity"])
@pytest.mark.parametrize("missing", [None, [np.nan] * 3, [1.0, None, 2.0]], ids=str)
def test_a_missing_velocity_is_held_and_then_refused(result, name, missing):
    _, samples, _ = stream(result)
    held, given = (posegsa.PoseFilter(result, **START, hold_time=0.025) for _ in range(2))
    first = {key: a[0] for key, a in samples.items()}
    for each in (held, given):
        each.update(time_step=0.01, **first)
    for _ in range(2):  # 0.01 and 0.02 s after the last one
        a = held.update(time_step=0.01, **first | {name: missing})
        b = given.update(time_step=0.01, **first)
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.position, b.position)
    before = held.checkpoint()
    with pytest.raises(MeasurementError, match=rf"{name}: missing for 0.03 s.*hold_time = 0.025 s"):
        held.update(time_step=0.01, **first | {name: missing})
    after = held.checkpoint()
    for key, array in before.items():
        np.testing.assert_array_equal(after[key], array)
    a, b = (each.update(time_step=0.01, **first) for each in (held, given))
    np.testing.assert_array_equal(a.position, b.position)


def test_the_first_sample_needs_velocities(pose_filter):
    with pytest.raises(MeasurementError, match="angular_velocity: missing from the first"):
        pose_filter.update(time_step=0.01, velocity=np.zeros(3))


def test_nothing_is_held_where_that_is_asked(result):
    pose_filter = posegsa.PoseFilter(result, **START, hold_time=0)
    sample = {"time_step": 0.01, "angular_velocity": np.zeros(3)}
    pose_filter.update(**sample, velocity=np.zeros(3))
    with pytest.raises(MeasurementError, match=r"velocity: missing for 0\.01 s"):
        pose_filter.update(**sample)


# Whether the pose is observable -------------------------------------------------------------------


def test_it_says_whether_what_was_seen_lately_fixes_the_pose(result):
    pose_filter = posegsa.PoseFilter(result, **START, observable_window=0.1)
    assert pose_filter.observable is False
    assert pose_filter.why_unobservable.startswith("in the last 0.1 s: found no vectors and no")
    still = {"time_step": 0.04, "angular_velocity": np.zeros(3), "velocity": np.zeros(3)}
    seen = np.eye(3)[:2]
    pose_filter.update(**still, vectors=seen)
    assert "found 2 vectors and no landmarks" in pose_filter.why_unobservable
    pose_filter.update(**still, vectors=[seen[0], None], landmarks=[[1.0, 0, 0]])
    # Both vectors within 0.1 s, but not in the same sample.
    assert pose_filter.observable is True
    assert pose_filter.why_unobservable == ""
    pose_filter.update(**still, landmarks=[[1.0, 0, 0]])
    assert pose_filter.observable
    pose_filter.update(**still, landmarks=[[1.0, 0, 0]])  # the second vector is 0.12 s old
    assert "found 1 vector and 1 landmark" in pose_filter.why_unobservable
    pose_filter.reset()
    assert not pose_filter.observable


def test_a_sensor_without_weight_fixes_nothing(result):
    pose_filter = posegsa.PoseFilter(result, **START, vector_weights=[1.0, 0.0])
    pose_filter.update(
        time_step=0.01,
        angular_velocity=np.zeros(3),
        velocity=np.zeros(3),
        vectors=np.eye(3)[:2],
        landmarks=[[1.0, 0, 0]],
    )
    assert "found 1 vector and 1 landmark" in pose_filter.why_unobservable
    pose_filter.update(
        time_step=0.01,
        angular_velocity=np.zeros(3),
        velocity=np.zeros(3),
        vectors=np.eye(3)[:2],
        vector_weights=1.0,  # instead, the reason is this sample
    )
    assert pose_filter.observable


# Checkpoints --------------------------------------------------------------------------------------


def test_a_checkpoint_resumes_to_the_same_bits(result, tmp_path):
    steps, samples, _ = stream(result)
    samples["angular_velocity"][21] = np.nan  # kept across the checkpoint
    one, other = (posegsa.PoseFilter(result, **START) for _ in range(2))
    fed(one, steps, samples, slice(21))
    with (tmp_path / "filter.npz").open("wb") as file:
        np.savez(file, **one.checkpoint())
    expected = fed(one, steps, samples, slice(21, N))
    with np.load(tmp_path / "filter.npz") as checkpoint:
        other.restore(checkpoint)
    for got, want in zip(fed(other, steps, samples, slice(21, N)), expected, strict=True):
        np.testing.assert_array_equal(got.rotation, want.rotation)
        np.testing.assert_array_equal(got.position, want.position)
    assert (other.time, other.gain, other.observable) == (one.time, one.gain, one.observable)


def test_a_filter_can_be_pickled(result):
    steps, samples, _ = stream(result)
    one = posegsa.PoseFilter(result, **START)
    fed(one, steps, samples, slice(21))
    other = pickle.loads(pickle.dumps(one))
    expected = fed(one, steps, samples, slice(21, N))
    for got, want in zip(fed(other, steps, samples, slice(21, N)), expected, strict=True):
        np.testing.assert_array_equal(got.rotation, want.rotation)
        np.testing.assert_array_equal(got.position, want.position)
    other.restore(one.checkpoint())
    assert other.time == one.time


def test_reset_starts_again(result, pose_filter):
    steps, samples, _ = stream(result)
    first = fed(pose_filter, steps, samples)[-1]
    pose_filter.reset()
    assert pose_filter.time == 0
    np.testing.assert_array_equal(pose_filter.pose.position, START["position"])
    np.testing.assert_array_equal(fed(pose_filter, steps, samples)[-1].position, first.position)
    pose_filter.reset(rotation=np.eye(3), position=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(pose_filter.pose.rotation, np.eye(3))
    np.testing.assert_array_equal(pose_filter.pose.position, [1.0, 2.0, 3.0])
    with pytest.raises(ArgumentError, match="rotation, position: one without the other"):
        pose_filter.reset(rotation=np.eye(3))


def test_what_is_returned_is_the_callers_own(pose_filter):
    pose = pose_filter.pose
    pose.position[:] = 7
    pose_filter.bias[:] = 7
    pose_filter.checkpoint()["record"][:] = 7
    np.testing.assert_array_equal(pose_filter.pose.position, START["position"])
    assert not pose_filter.bias.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("ages"), "checkpoint: without 'ages'"),
        (lambda c: c.update(format=np.array(7)), "format 7; allowed: format 5"),
        (lambda c: c.update(record=c["record"][1:]), "record of float64"),
        (lambda c: c["parameters"].__imul__(2), "of a filter with other numbers"),
        (lambda c: c.update(structure=c["structure"] + 1), "of a filter with other laws or rules"),
        (lambda c: c["record"].__setitem__(0, np.nan), "checkpoint: record holds NaN or infinity"),
        (lambda c: c["velocities"].__iadd__(np.inf), "checkpoint: velocities holds NaN"),
        (lambda c: c["ages"].__imul__(-1), "checkpoint: ages holds NaN or a negative number"),
        (lambda c: c["clock"].__isub__(1), "checkpoint: clock holds a negative time"),
    ],
)
def test_a_checkpoint_of_something_else_is_refused(pose_filter, change, message):
    checkpoint = pose_filter.checkpoint()
    change(checkpoint)
    with pytest.raises(ArgumentError, match=message):
        pose_filter.restore(checkpoint)


# Refusals -----------------------------------------------------------------------------------------


def test_a_result_tuned_on_true_errors_is_refused():
    with pytest.raises(ArgumentError, match=r"true errors.*which no vehicle knows"):
        posegsa.PoseFilter(tuned(K, "gain.signal=pose"), **START)


def test_what_a_result_warns_of_is_said(result):
    judged = dataclasses.replace(result.on_scenarios, trust=trust(sensitive=True))
    worse = dataclasses.replace(result, on_scenarios=judged)
    with pytest.warns(PosegsaWarning, match="the result says: SENSITIVE"):
        posegsa.PoseFilter(worse, **START)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotation": np.ones((3, 3))}, "rotation: must be a rotation"),
        ({"position": [0, 0]}, "position: must have the shape"),
        ({"position": [0, 0, 2e9]}, r"position = 2e\+09; allowed: -1e\+09 to 1e\+09 m"),
        ({"bias": [0, 0, 0, 0, 2e4, 0]}, "bias = 20000; allowed: -10000 to 10000 m/s"),
        ({"landmark_references": [[2e9, 0, 0]]}, r"landmark_references = 2e\+09; allowed"),
        ({"vector_references": np.ones((2, 2))}, "vector_references: must have the shape"),
        ({"vector_references": np.zeros((2, 3))}, "vector_references: must not be zero"),
        ({"landmark_weights": -1}, "landmark_weights = -1; allowed"),
        ({"landmark_weights": [1.0, 2.0]}, "landmark_weights: must have the shape"),
        ({"hold_time": -1.0}, "hold_time = -1.0; allowed"),
        ({"observable_window": math.nan}, "observable_window = nan; allowed"),
    ],
)
def test_bad_arguments_are_refused_by_name(result, change, message):
    with pytest.raises((ArgumentError, MeasurementError), match=message):
        posegsa.PoseFilter(result, **{**START, **change})


def test_bad_sources_are_refused(result):
    settings = posegsa.filter_settings(tuned(K).experiment)
    constant = posegsa.ConstantGain(jnp.float32(7.0))
    for source, message in (
        (7.0, "source: a float; allowed: a Result"),
        (result.controller, "source: a FuzzyController; allowed: .*Observer"),
        (posegsa.Observer, "source: the class Observer; allowed"),
        (posegsa.Observer(posegsa.ConstantGain(jnp.float32(-7.0))), "gain = -7.0; allowed"),
        (posegsa.Observer(None), "schedule: None; allowed: a gain schedule"),
        (
            posegsa.Observer(constant, signal=posegsa.SignalSettings(signal="pose")),
            'source.signal: "pose"',
        ),
        (
            posegsa.Observer(constant, settings),
            "settings.vectors.weights: 2 of them; allowed: 0",
        ),
    ):
        with pytest.raises(ArgumentError, match=message):
            posegsa.PoseFilter(source, **START)
    with pytest.raises(posegsa.PosegsaError, match=r"run: no file, and no configuration.* imu"):
        posegsa.PoseFilter("run", **START)
    with pytest.raises(ArgumentError, match="not given, and 0 vectors and 0 landmarks never show"):
        posegsa.PoseFilter(posegsa.Observer(constant))
    for pose in ({"rotation": np.eye(3)}, {"position": np.zeros(3)}):
        with pytest.raises(ArgumentError, match="rotation, position: one without the other"):
            posegsa.PoseFilter(posegsa.Observer(constant), **pose)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_step": 0.0}, r"time_step = 0; allowed: 1e-09 to 60 s"),
        ({"time_step": 61.0}, r"time_step = 61; allowed"),
        ({"velocity": [0.0, -1e26, 0.0]}, r"velocity = -1e\+26; allowed: -10000 to 10000 m/s"),
        ({"angular_velocity": [2e3, 0, 0]}, r"angular_velocity = 2000; allowed: -1000 to 1000 rad"),
        ({"vectors": [[2e6, 0, 0], [0, 0, 1]]}, r"vectors = 2e\+06; allowed: -1e\+06 to 1e\+06$"),
        ({"landmarks": [[2e6, 0, 0]]}, r"landmarks = 2e\+06; allowed: -1e\+06 to 1e\+06 m"),
        ({"time_step": math.nan}, "time_step: must be finite"),
        ({"time_step": None}, "time_step: must be an array of numbers|must be finite"),
        ({"velocity": [0.0, np.inf, 0.0]}, "velocity = inf; allowed"),
        ({"angular_velocity": "fast"}, "angular_velocity: must be an array of numbers"),
        ({"vectors": np.zeros((3, 3))}, r"vectors: must have the shape \(2, 3\), got \(3, 3\)"),
        ({"landmarks": [[np.inf, 0, 0]]}, "landmarks = inf; allowed"),
        ({"vector_weights": [1.0, -2.0]}, r"vector_weights = -2; allowed: 0 to 1e\+06$"),
    ],
)
def test_a_bad_sample_is_refused_and_changes_nothing(pose_filter, change, message):
    sample = {"time_step": 0.01, "angular_velocity": np.zeros(3), "velocity": np.zeros(3)}
    pose_filter.update(**sample)
    before = pose_filter.checkpoint()
    with pytest.raises(MeasurementError, match=message):
        pose_filter.update(**sample | change)
    for name, array in pose_filter.checkpoint().items():
        np.testing.assert_array_equal(array, before[name])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Spoilt:
    """An observer whose estimate is multiplied by factors, as by a faulty program."""

    observer: posegsa.Observer
    attitude: float = 1.0
    place: float = 1.0

    def with_values(self, values):
        return self

    def prepare(self, measurements):
        return self.observer.prepare(measurements)

    def start(self, initial, sensors):
        return self.observer.start(initial, sensors)

    def ready(self):
        return self

    def step(self, state, now):
        after, record = self.observer.ready().step(state, now)
        w, x, y, z = (self.attitude * a for a in after.estimate.attitude)
        px, py, pz = (self.place * a for a in after.estimate.place)
        estimate = after.estimate._replace(attitude=(w, x, y, z), place=(px, py, pz))
        return after._replace(estimate=estimate), record

    def estimate(self, state):
        return state.estimate


def test_a_state_that_is_no_floating_number_is_refused():
    class Counting(Spoilt):
        def start(self, initial, sensors):
            return self.observer.start(initial, sensors), jnp.int32(0)

    counting = jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(Counting))
    observer = posegsa.Observer(posegsa.ConstantGain(jnp.float32(5.0)))
    with pytest.raises(ArgumentError, match="filter: its state holds int32"):
        posegsa.PoseFilter(counting(observer), **START)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        ({"attitude": 1.1}, "squared length of the estimated quaternion"),
        ({"place": math.inf}, "NaN or infinite"),
    ],
)
def test_an_invalid_estimate_is_refused(factor, message):
    """An absurd result of a step is refused too: XLA's sine of 1e18 rad may be of any size."""
    observer = posegsa.Observer(posegsa.ConstantGain(jnp.float32(5.0)))
    pose_filter = posegsa.PoseFilter(Spoilt(observer, **factor), **START)
    with pytest.raises(MeasurementError, match=message):
        pose_filter.update(time_step=0.01, angular_velocity=np.ones(3), velocity=np.ones(3))
    np.testing.assert_array_equal(pose_filter.pose.rotation, START["rotation"])


def test_a_time_step_in_milliseconds_is_said_once(pose_filter):
    still = {"angular_velocity": np.zeros(3), "velocity": np.zeros(3)}
    for _ in range(FIRST_SAMPLES - 1):
        pose_filter.update(time_step=10.0, **still)
    with pytest.warns(PosegsaWarning, match="time_step: .*over 1 s.*in seconds") as said:
        pose_filter.update(time_step=10.0, **still)
    pose_filter.update(time_step=10.0, **still)
    assert len(said) == 1


def test_names_of_inertial_sensors_are_only_of_the_attitude_filter(pose_filter):
    with pytest.raises(ArgumentError, match=r"acc, mag; allowed: .*only for the attitude filter"):
        pose_filter.update(time_step=0.01, gyr=[0, 0, 0], acc=[0, 0, 9.81])
