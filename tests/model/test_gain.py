"""Gain schedules and the error signal, against the reference."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import as_arrays
from helpers.controllers import fuzzy
from helpers.experiments import PAPER
from helpers.filters import jitted_prepare, settings, stacked, state_of, stepped
from helpers.measurements import random_measurements, random_poses, reference_sample
from jax import Array
from scipy.spatial.transform import Rotation

from posegsa.config import GainConfig
from posegsa.errors import ArgumentError
from posegsa.filters.base import samples_of
from posegsa.filters.observer import Observer, see
from posegsa.filters.rollout import simulate
from posegsa.model.estimate import FilterState
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, Seen
from posegsa.model.schedules import (
    ConstantGain,
    FuzzyGain,
    Gains,
    ScheduleInputs,
    SwitchGain,
    check_schedule,
)
from posegsa.model.signal import (
    Measured,
    SignalMemory,
    TruePose,
    initial_memory,
    measured_errors,
    pose_errors,
    scheduled_gain,
    still_unknown,
)
from posegsa.model.vectors import Wahba
from posegsa.recordings.running import run_filter
from posegsa.search.configured_filters import signal_settings

N = 60


@jax.jit
def jitted_errors(state: FilterState, sample: Sample) -> Measured:
    """The measured errors for vectors used as measured."""
    return measured_errors(state, sample, see(state, sample, settings(sample.time_step.dtype)))


jitted_pose_errors = jax.jit(pose_errors)


def states(poses: np.ndarray) -> FilterState:
    """Filter states of estimated poses (N, 4, 4)."""
    return state_of(poses)


def true_poses(poses: np.ndarray) -> TruePose:
    origin = np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    x, y, z = origin.T
    return TruePose(state_of(poses).attitude, (x, y, z))


class Listener(NamedTuple):
    """A schedule whose gain is one of its inputs."""

    field: str

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        return Gains(getattr(inputs, self.field))


def nothing_yet(gain: float) -> SignalMemory:
    """Memory before the first sample, for a schedule that starts at this gain."""
    return initial_memory(ConstantGain(jnp.asarray(gain)), jnp.asarray(0.0))


def schedule_input(
    errors: list[tuple[float | None, float | None]], field: str, step: float = 0.01, **changes: Any
) -> np.ndarray:
    """The input `field` of a schedule at each sample, from attitude and position errors."""
    memory = nothing_yet(0.0)
    heard = []
    for k, now in enumerate(errors):
        gain, memory = listen(Listener(field), memory, now, step * k, step, **changes)
        heard.append(gain)
    return np.array(heard)


def listen(
    schedule: Any,
    memory: SignalMemory,
    errors: tuple[float | None, float | None],
    time: float,
    step: float = 0.01,
    **changes: Any,
) -> tuple[Array, SignalMemory]:
    """Gain and memory after one sample of `schedule`; an error of None is not measured."""
    made = signal_settings(GainConfig(**PAPER.gain.model_dump() | changes), jnp.float32)
    values = (jnp.asarray(0.0 if error is None else error) for error in errors)
    seen = (jnp.asarray(error is not None) for error in errors)
    gains, _, memory = scheduled_gain(
        schedule, memory, Measured(*values, *seen), jnp.asarray(time), jnp.asarray(step), made
    )
    return gains.gain, memory


# The two error signals ----------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("vectors", "landmarks"), [(3, 2), (4, 2), (3, 0), (0, 2)])
def test_measured_signal_against_the_reference(vectors: int, landmarks: int) -> None:
    rng = np.random.default_rng(vectors)
    poses = random_poses(rng, N)
    sensed = random_measurements(rng, N, vectors, landmarks, missing=0.3)
    errors = jitted_errors(states(poses), jitted_prepare(as_arrays(sensed, jnp.float64)))
    expected = [
        reference.measured_errors(T, reference_sample(sensed, k)) for k, T in enumerate(poses)
    ]
    # Missing measurements have no effect, and some samples have none at all.
    each = (errors.attitude, errors.attitude_seen), (errors.position, errors.position_seen)
    for (part, seen), wanted in zip(each, zip(*expected, strict=True), strict=True):
        assert np.asarray(seen).tolist() == [want is not None for want in wanted]
        # A difference of sums of a few squares, so only their rounding.
        want = [0.0 if want is None else want for want in wanted]
        np.testing.assert_allclose(part, want, rtol=1e-13, atol=1e-14)
    assert not np.all(errors.attitude_seen) or vectors > 3


@pytest.mark.usefixtures("x64")
def test_pose_signal_against_the_reference() -> None:
    rng = np.random.default_rng(0)
    estimates, truths = random_poses(rng, N), random_poses(rng, N)
    errors = jitted_pose_errors(states(estimates), true_poses(truths))
    expected = [reference.pose_errors(*pair) for pair in zip(estimates, truths, strict=True)]
    np.testing.assert_allclose(np.stack(errors, axis=1), expected, rtol=1e-12)


@pytest.mark.usefixtures("x64")
def test_attitude_parts_are_equal_for_orthonormal_vectors_without_noise() -> None:
    rng = np.random.default_rng(1)
    estimates, truths = random_poses(rng, N), random_poses(rng, N)
    frame = Rotation.random(rng=rng).as_matrix()  # its rows are the vectors
    body = np.einsum("nji,vj->nvi", truths[:, :3, :3], frame)
    still = np.zeros((N, 3))
    sensed = Measurements.from_arrays(
        time_step=0.01,
        angular_velocity=still,
        velocity=still,
        vectors=body,
        vector_references=frame,
        vector_weights=0.7,
        dtype=np.float64,
    )
    measured = jitted_errors(states(estimates), jitted_prepare(sensed)).attitude
    true, _ = jitted_pose_errors(states(estimates), true_poses(truths))
    np.testing.assert_allclose(measured, true, rtol=1e-12)
    # Two of them do not suffice: the third direction is not measured.
    weights = np.array(sensed.vector_weights) * [1, 1, 0]
    two = sensed._replace(vector_weights=weights)
    unseen = jitted_errors(states(estimates), jitted_prepare(two)).attitude
    assert np.abs(unseen - true).max() > 0.05


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_measured_attitude_part_of_a_perfect_fit_is_not_negative(dtype: str) -> None:
    # The difference is 0 except for rounding; a negative one would mark the first sample.
    with jax.enable_x64(dtype == "float64"):
        rng = np.random.default_rng(2)
        poses = random_poses(rng, 500)
        known = rng.normal(size=(3, 3))
        sensed = random_measurements(rng, 500, 3, 1)._replace(
            vectors=np.einsum("nji,vj->nvi", poses[:, :3, :3], known),
            vector_references=np.broadcast_to(known, (500, 3, 3)),
        )
        state = state_of(poses, dtype=dtype)
        attitude = np.asarray(jitted_errors(state, jitted_prepare(as_arrays(sensed, dtype)))[0])
    assert (attitude >= 0).all()
    assert (attitude < 20 * np.finfo(dtype).eps).all()


# Inputs of the schedule ---------------------------------------------------------------------------

ERRORS: list[tuple[float | None, float | None]] = [
    (0.5, 10.0),
    (0.4, 8.0),
    (0.4, 2.0),
    (0.1, 1.0),
    (0.1, 1.0),
    (0.3, 0.0),
]
"""Unscaled signals 2.5, 2.0, 0.8, 0.3, 0.3, 0.3 at the weight 0.2."""


def test_the_error_is_scaled_then_clipped() -> None:
    np.testing.assert_allclose(
        schedule_input(ERRORS, "error"), [1, 1, 0.8, 0.3, 0.3, 0.3], rtol=1e-6
    )
    scaled = schedule_input(ERRORS, "error", error_scale=2.0)
    np.testing.assert_allclose(scaled, [1, 1, 0.4, 0.15, 0.15, 0.15], rtol=1e-6)
    weighted = schedule_input(ERRORS, "error", position_weight=0.0)
    np.testing.assert_allclose(weighted, [0.5, 0.4, 0.4, 0.1, 0.1, 0.3], rtol=1e-6)


def test_the_rate_is_that_of_the_signal_before_scaling_and_clipping() -> None:
    rate = [0, 0.5, 1, 0.5, 0, 0]  # 2.5 to 2.0 counts, though both are clipped; 1.2 is clipped
    np.testing.assert_allclose(schedule_input(ERRORS, "rate"), rate, atol=1e-6)
    np.testing.assert_allclose(schedule_input(ERRORS, "rate", error_scale=5.0), rate, atol=1e-6)
    halved = schedule_input(ERRORS, "rate", rate_scale=0.5)
    np.testing.assert_allclose(halved, [0, 0.25, 0.6, 0.25, 0, 0], atol=1e-6)
    np.testing.assert_array_equal(schedule_input(ERRORS, "rate", rate_scale=0.0), 0)


def test_the_rate_is_zero_at_the_first_sample_only() -> None:
    # Also after a signal of 0, which does not mean "no sample yet".
    assert schedule_input([(0.0, 0.0), (0.25, 0.0)], "rate").tolist() == [0, 0.25]
    assert schedule_input([(0.9, 0.0)], "rate").tolist() == [0]


def test_a_schedule_gets_the_time_and_its_own_last_gain() -> None:
    np.testing.assert_allclose(schedule_input(ERRORS[:3], "time"), [0, 0.01, 0.02], rtol=1e-6)
    memory = nothing_yet(12.5)
    gain, after = listen(Listener("last"), memory, (0.5, 0.0), 0.0)
    assert gain == after.gain == 12.5
    assert listen(Listener("error"), memory, (0.5, 0.0), 0.0)[0] == 0.5


def test_the_rate_per_second_is_over_the_time_since_the_last_sample() -> None:
    halved = schedule_input(ERRORS, "rate", step=0.5, rate="per_second", rate_scale=0.25)
    np.testing.assert_allclose(halved, [0, 0.25, 0.6, 0.25, 0, 0], atol=1e-6)
    # The same signal sampled twice as often changes half as much, in half the time.
    slow, fast = ([(0.1 * k / n, 0.0) for k in range(4 * n)] for n in (1, 2))
    slow = schedule_input(slow, "rate", step=0.02, rate="per_second", rate_scale=0.1)
    fast = schedule_input(fast, "rate", step=0.01, rate="per_second", rate_scale=0.1)
    np.testing.assert_allclose(slow[1:], 0.5, rtol=1e-5)
    np.testing.assert_allclose(fast[1:], 0.5, rtol=1e-5)
    assert slow[0] == fast[0] == 0


def test_a_part_that_is_not_measured_keeps_its_last_value() -> None:
    errors = [(None, None), (0.4, None), (None, 1.0), (0.2, None), (None, None), (None, 2.0)]
    want = [0, 0.4, 0.6, 0.4, 0.4, 0.6]
    np.testing.assert_allclose(schedule_input(errors, "error"), want, rtol=1e-6)
    np.testing.assert_allclose(
        schedule_input(errors, "rate"), [0, 0.4, 0.2, 0.2, 0, 0.2], atol=1e-6
    )


@pytest.mark.parametrize("smoothing", [0.0, 0.5])
def test_a_steady_error_of_a_landmark_in_one_sample_of_ten_is_seen_whole(smoothing: float) -> None:
    always = schedule_input([(0.0, 2.0)] * 40, "error", smoothing=smoothing)
    seldom = schedule_input(
        [(0.0, 2.0 if k % 10 == 0 else None) for k in range(40)], "error", smoothing=smoothing
    )
    np.testing.assert_allclose(always, 0.4, rtol=1e-6)
    np.testing.assert_array_equal(seldom, always)


def test_smoothing_is_a_low_pass_filter_before_all_else() -> None:
    # Backward Euler, started at the first value: with a time constant of three steps a quarter of
    # the difference at each sample. Without scaling the rate is the smoothed signal's change.
    signal = [(0.8, 0.0), (0.0, 0.0), (0.0, 0.0), (0.8, 0.0)]
    smoothed = [0.8, 0.6, 0.45, 0.5375]
    np.testing.assert_allclose(schedule_input(signal, "error", smoothing=0.03), smoothed, rtol=1e-6)
    rate = [0, 0.2, 0.15, 0.0875]
    np.testing.assert_allclose(schedule_input(signal, "rate", smoothing=0.03), rate, atol=1e-6)
    np.testing.assert_array_equal(schedule_input(signal, "error"), np.float32([0.8, 0, 0, 0.8]))


def test_smoothing_goes_by_the_time_since_the_last_sample() -> None:
    memory, heard = nothing_yet(0.0), []
    for e, passed in ((0.8, 0.01), (0.0, 0.03), (0.0, 0.01)):
        gain, memory = listen(Listener("error"), memory, (e, 0.0), 0.0, passed, smoothing=0.03)
        heard.append(float(gain))
    # 0.01 s passed before the second sample, 0.03 s before the third.
    np.testing.assert_allclose(heard, [0.8, 0.8 * 0.75, 0.8 * 0.75 * 0.5], rtol=1e-6)


def test_the_unknown_share_falls_by_measurements_and_not_by_time() -> None:
    made = signal_settings(GainConfig(unknown=0.5, unknown_fall=0.1), jnp.float32)
    memory = initial_memory(ConstantGain(jnp.asarray(0.0)), jnp.asarray(0.0), made.unknown)
    zero = jnp.asarray(0.0)
    nothing = Wahba(((zero,) * 3,) * 3, power=zero, curvature=zero, scale=zero)
    vectors = nothing._replace(scale=zero + 0.3)
    for wahba, weights, want in (
        (nothing, (zero, zero), 0.5),
        (vectors, (zero, zero), 0.5 / 1.1),
        (nothing, (zero, zero + 2), 0.5 / 1.1),
        (vectors, (zero + 1,), 0.5 / 1.2),
        (vectors, (), 0.5 / 1.1),
    ):
        after = still_unknown(memory, Seen(wahba, (), weights), zero + 2, made)
        np.testing.assert_allclose(after.unknown, want, rtol=1e-6)


def test_the_error_is_at_least_the_unknown_share_which_rises_with_it() -> None:
    changes = {"unknown": 0.4, "unknown_rise": 0.75, "error_scale": 2.0, "rate_scale": 0.0}
    made = signal_settings(GainConfig(**PAPER.gain.model_dump() | changes), jnp.float32)
    memory = initial_memory(ConstantGain(jnp.asarray(0.0)), jnp.asarray(0.0), made.unknown)
    heard = []
    for error in (0.2, 1.2, 0.0, 5.0, 0.0):
        gain, memory = listen(Listener("error"), memory, (error, 0.0), 0.0, **changes)
        heard.append(float(gain))
    np.testing.assert_allclose(heard, [0.4, 0.6, 0.45, 1.0, 0.75], rtol=1e-6)


def test_settings_come_from_the_configuration_at_the_dtype() -> None:
    configured = GainConfig(signal="pose", position_weight=0.5, error_scale=3.0, rate_scale=7.0)
    made = signal_settings(configured, jnp.float32)
    assert (made.signal, made.position_weight, made.error_scale, made.rate_scale) == (
        "pose",
        0.5,
        3,
        7,
    )
    assert made.rate_scale.dtype == jnp.float32


# Schedules ----------------------------------------------------------------------------------------


def test_a_fuzzy_gain_is_held_from_sample_to_sample_where_nothing_fires() -> None:
    inputs = [[0, 0, 0.1], [0.3, 0.3, 0.4], [0.35, 0.5, 0.6], [0.55, 0.7, 0.8], [0.75, 1, 1]]
    outputs = [[0, 0, 10], [5, 10, 20], [20, 30, 40], [40, 60, 70], [60, 100, 100]]
    schedule = FuzzyGain(fuzzy(inputs, outputs, "float32"))
    prepared = schedule.prepare()
    memory = initial_memory(schedule, jnp.asarray(0.0))
    assert memory.gain == 51
    # Scaled errors: a gap, firing, a gap twice, firing again; the rate is scaled to 0.
    gains = []
    for e in (0.2, 0.5, 0.2, 0.25, 0.9):
        gain, memory = listen(prepared, memory, (e, 0.0), 0.0, rate_scale=0.0)
        gains.append(float(gain))
    fired, later = (float(schedule.controller(e, 0.0)) for e in (0.5, 0.9))
    np.testing.assert_allclose(gains, [51, fired, fired, fired, later], rtol=1e-6)
    assert len({51.0, fired, later}) == 3


def test_a_switch_changes_gain_and_learning_each_at_its_time() -> None:
    schedule = SwitchGain(*(jnp.asarray(x) for x in (80.0, 10.0, 2.0, 1.0)))
    assert schedule.initial_gain() == 80
    time = jnp.asarray([0.0, 0.9, 1.0, 1.9, 2.0, 9.0])
    gains = schedule.prepare()(ScheduleInputs(0 * time, 0 * time, time, 0 * time))
    assert gains.gain.tolist() == [80, 80, 80, 80, 10, 10]
    assert jnp.asarray(gains.learning).tolist() == [0, 0, 1, 1, 1, 1]


def test_a_gain_that_is_nan_stays_nan() -> None:
    # Also if a limit would cut it.
    poses = random_poses(np.random.default_rng(0), 1)
    m = as_arrays(random_measurements(np.random.default_rng(0), 3, 2, 1), np.float32)
    chosen = settings(np.float32)
    observer = Observer(ConstantGain(jnp.asarray(jnp.nan)), chosen)
    sensors = jax.jit(samples_of)(observer, m)
    estimates = simulate(observer, sensors, state_of(poses[0], dtype=np.float32))
    assert np.isnan(estimates.gain).all()
    assert np.isnan(estimates.gain_used).all()


def test_a_negative_gain_is_refused_and_inside_jit_makes_the_estimate_nan() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 3, 2, 1), np.float32)
    state = state_of(np.eye(4), dtype=np.float32)
    chosen = settings(np.float32)
    with pytest.raises(ArgumentError, match=r"gain = -1.*at least 0"):
        stepped(state, m.at(0), -1.0, chosen)
    with pytest.raises(ArgumentError, match=r"gain = -2.*at least 0"):
        run_filter(Observer(ConstantGain(jnp.asarray(-2.0)), chosen), m, state)
    after = jax.jit(stepped)(state, m.at(0), jnp.float32(-1), chosen)
    assert np.isnan(stacked(after)[0][:3]).all()


def test_a_constant_gain_is_constant() -> None:
    schedule = ConstantGain(jnp.asarray(7.5))
    assert schedule.initial_gain() == 7.5
    inputs = ScheduleInputs(*(jnp.linspace(0, 1, 4) for _ in range(4)))
    assert schedule.prepare()(inputs).gain.tolist() == [7.5] * 4
    assert schedule.prepare()(inputs).learning == 1
    assert initial_memory(schedule, jnp.zeros(3)).gain.tolist() == [7.5] * 3


def test_a_schedule_that_begins_below_0_is_refused() -> None:
    terms = [[0.0, 0.0, 0.6], [0.4, 1.0, 1.0]]
    below = FuzzyGain(FuzzyController(terms, np.asarray(terms) - 3, ((0, 1), (1, 1)), (-3.0, -1.0)))
    assert below.controller.middle_gain == below.initial_gain() == -1
    for schedule, gain in ((below, "-1.0"), (ConstantGain(jnp.asarray(-2.0)), "-2.0")):
        with pytest.raises(ArgumentError, match=f"gain = {gain}.*0"):
            check_schedule(schedule)
