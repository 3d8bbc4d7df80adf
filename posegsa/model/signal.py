"""The error signal, the input of gain schedules, and its memory from sample to sample."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.errors import ArgumentError
from posegsa.model.elementwise import choose, maximum, minimum
from posegsa.model.estimate import FilterState
from posegsa.model.sample import Sample, Seen, seen_from_estimate
from posegsa.model.schedules import Gains, GainSchedule, PreparedSchedule, ScheduleInputs
from posegsa.model.se3 import (
    Quaternion,
    Vec3,
    attitude_distance,
    dot,
    norm,
    rows,
    subtract,
    unrotate,
)

Signal = Literal["measured", "pose"]
Rate = Literal["per_sample", "per_second"]


class TruePose(NamedTuple):
    """The true pose at one sample, by components, in the form in which errors are computed."""

    attitude: Quaternion
    """R."""
    origin: Vec3
    """R^T P, so that P_err = P_est - R_est R^T P [m]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Unknown:
    """How the unknown share of the biases raises the schedule's input; the numbers are traced."""

    start: Array
    """The unknown share before the first sample, on the scale of the schedule's input: 0 to 1."""
    fall: Array
    """How fast the share falls at the gain K: at the rate `fall` K [1/s], so it has no unit."""
    rise: Array
    """Lower limit of the unknown share, as a factor on the scaled error, no unit."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SignalSettings:
    """Settings of the error signal; `signal` and `rate` are static, the numbers are traced."""

    signal: Signal = field(default="measured", metadata={"static": True})
    rate: Rate = field(default="per_sample", metadata={"static": True})
    """Whether the rate is the change of the signal per sample or per second."""
    position_weight: Array | float = 0.2
    """Weight of the position part [1/m]."""
    smoothing: Array | float = 1.5
    """Time constant of the low-pass filter of the signal [s]; 0 means none."""
    error_scale: Array | float = 0.3
    """The signal at which the scaled error is 1."""
    rate_scale: Array | float = 1.0
    """Factor on the signal's change (per sample, or [s] per second) before it is clipped."""
    unknown: Unknown | None = None
    """How the unknown share of the biases raises the schedule's input; None if it does not."""


class Measured(NamedTuple):
    """The errors at one sample, and whether they could be measured."""

    attitude: Array
    """The attitude part, in [0, 1] for a consistent sample."""
    position: Array
    """The position part [m]."""
    attitude_seen: Array | bool
    """Whether any vector was measured."""
    position_seen: Array | bool
    """Whether any landmark was measured."""


def known_pose(truth: TruePose | None) -> TruePose:
    """The true pose.

    Raises:
        ArgumentError: The pose is not known.
    """
    if truth is None:
        raise ArgumentError(
            'signal "pose" needs the true pose; use "measured" where it is not known'
        )
    return truth


def pose_errors(state: FilterState, truth: TruePose | None) -> tuple[Array, Array]:
    """||R_err||_I and ||P_err|| [m], with R_err = R_est R^T, P_err = P_est - R_err P.

    Raises:
        ArgumentError: The true pose is not known.
    """
    truth = known_pose(truth)
    # In the body frame, where the correction needs the position too: R_est^T P_est - R^T P.
    position = subtract(unrotate(rows(state.attitude), state.place), truth.origin)
    return attitude_distance(state.attitude, truth.attitude), norm(position)


def measured_errors(state: FilterState, sample: Sample, seen: Seen) -> Measured:
    """The same two errors from measurements alone, as a vehicle can compute them.

    The attitude part is 3/(8 sum s_i) sum_i s_i |R_est u_i - v_i^I|^2, computed from the profile
    matrix as 3/(8 sum s_i) [sum_i s_i (|u_i|^2 + |v_i^I|^2) - 2 tr(R_est B)]. For orthonormal
    vectors without noise it is ||R_err||_I. The position part is |T_est y_i - p_i| [m] averaged
    over the landmarks by weight.
    """
    wahba, R = seen.wahba, rows(state.attitude)
    columns = tuple(zip(*wahba.profile, strict=True))
    trace = dot(R[0], columns[0]) + dot(R[1], columns[1]) + dot(R[2], columns[2])
    # Where every vector fits the difference is 0, and rounding may make it negative.
    attitude = wahba.scale * maximum(wahba.power - 2 * trace, 0.0)
    position, total = jnp.zeros_like(attitude), jnp.zeros_like(attitude)
    points = seen_from_estimate(state, R, sample)
    for x, landmark, s in zip(points, sample.landmarks, seen.landmark_weights, strict=True):
        position = position + s * norm(subtract(x, landmark.inertial))
        total = total + s
    located = total > 0
    position = choose(located, position / choose(located, total, 1.0), 0.0)
    return Measured(attitude, position, wahba.scale > 0, located)


class SignalMemory(NamedTuple):
    """The memory of the error signal and the schedule from sample to sample."""

    attitude: Array
    """The last attitude part that was measured; 0 before the first."""
    position: Array
    """The last position part that was measured [m]; 0 before the first."""
    error: Array
    """The last error signal, smoothed, unscaled; ignored at the first sample."""
    gain: Array
    """The last gain that the schedule requested [1/s]."""
    time_step: Array
    """Time since the last sample [s]; infinite before the first one."""
    unknown: Array | tuple[()] = ()
    """The unknown share of the biases, 0 to 1; () if the schedule does not use it."""


def initial_memory(
    schedule: GainSchedule, like: Array, unknown: Unknown | None = None
) -> SignalMemory:
    """The memory before the first sample, in the shape and dtype of `like`."""
    gain = jnp.broadcast_to(jnp.asarray(schedule.initial_gain(), like.dtype), like.shape)
    zero = jnp.zeros_like(like)
    return SignalMemory(
        attitude=zero,
        position=zero,
        error=zero,
        gain=gain,
        time_step=jnp.full_like(like, jnp.inf),
        unknown=() if unknown is None else jnp.broadcast_to(unknown.start, like.shape),
    )


def scheduled_gain(
    schedule: PreparedSchedule,
    memory: SignalMemory,
    errors: Measured,
    time: Array,
    time_step: Array,
    settings: SignalSettings,
) -> tuple[Gains, ScheduleInputs, SignalMemory]:
    """The gains that a schedule requests, from the errors of attitude [1] and position [m].

    A part that is not measured at a sample keeps its last value. The signal e is attitude + weight
    x position after a first-order low-pass filter (backward Euler, starting at the first value).
    The inputs of the schedule are e / error_scale and the rate |e_k - e_{k-1}| x rate_scale, for
    "per_second" divided by the time between the two; both are clipped to [0, 1]. The rate comes
    from the unscaled, unclipped e, and is 0 at the first sample. With `settings.unknown` the scaled
    error is at least the unknown share of the biases, which is at least `rise` times the scaled
    error.

    Returns:
        The gains, the inputs of the schedule, and the memory for the next sample.
    """
    attitude = choose(errors.attitude_seen, errors.attitude, memory.attitude)
    position = choose(errors.position_seen, errors.position, memory.position)
    now = attitude + settings.position_weight * position
    first = jnp.isinf(memory.time_step)
    previous = choose(first, now, memory.error)
    # Backward Euler over the time since the last sample. Without smoothing, and at the first
    # sample, e equals `now` exactly.
    old = settings.smoothing / (settings.smoothing + memory.time_step)
    e = now + old * (previous - now)
    change = jnp.abs(e - previous)
    if settings.rate == "per_second":
        change = change / memory.time_step
    error, unknown = minimum(maximum(e * (1 / settings.error_scale), 0.0), 1.0), memory.unknown
    if settings.unknown is not None and not isinstance(unknown, tuple):
        unknown = maximum(unknown, settings.unknown.rise * error)
        error = maximum(error, unknown)
    inputs = ScheduleInputs(
        error=error,
        rate=minimum(change * settings.rate_scale, 1.0),
        time=time,
        last=memory.gain,
    )
    gains = schedule(inputs)
    memory = SignalMemory(
        attitude=attitude,
        position=position,
        error=e,
        gain=gains.gain,
        time_step=jnp.broadcast_to(time_step, e.shape),
        unknown=unknown,
    )
    return gains, inputs, memory


def still_unknown(
    memory: SignalMemory, seen: Seen, learnt: Array, settings: SignalSettings
) -> SignalMemory:
    """The memory after a sample that the biases were learnt from.

    The unknown share falls while the estimate is corrected: vectors count as one half, landmarks as
    the other. While nothing is measured it stays.

    Args:
        memory: The memory from `scheduled_gain`.
        seen: What was measured.
        learnt: K dt of the sample, times the factor on the gains of the bias laws.
        settings: As for `scheduled_gain`.
    """
    unknown = memory.unknown
    if settings.unknown is None or isinstance(unknown, tuple):
        return memory
    none, half = jnp.zeros_like(learnt), jnp.full_like(learnt, 0.5)
    total = none
    for weight in seen.landmark_weights:
        total = total + weight
    measured = choose(seen.wahba.scale > 0, half, none) + choose(total > 0, half, none)
    return memory._replace(unknown=unknown / (1 + settings.unknown.fall * learnt * measured))
