"""The error signal that a gain schedule looks at, and what it remembers from sample to sample."""

from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.errors import ArgumentError
from posegsa.model.elementwise import choose, maximum, minimum
from posegsa.model.filter import FilterState, seen_from_estimate
from posegsa.model.measurements import Sample
from posegsa.model.schedules import GainSchedule, PreparedSchedule, ScheduleInputs
from posegsa.model.se3 import (
    Quaternion,
    Vec3,
    attitude_distance,
    dot,
    norm,
    rotate,
    rows,
    subtract,
)

Signal = Literal["measured", "pose"]


class TruePose(NamedTuple):
    """The true pose at one sample, by components, in the form that the errors need."""

    attitude: Quaternion
    """R."""
    origin: Vec3
    """R^T P, so that P_err = P_est - R_est R^T P [m]."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["position_weight", "smoothing", "error_scale", "rate_scale"],
    meta_fields=["signal"],
)
@dataclass(frozen=True)
class SignalSettings:
    """How the error signal is made; `signal` is structure, the numbers are traced."""

    signal: Signal
    position_weight: Array
    """Weight of the position part [1/m]."""
    smoothing: Array
    """Time constant of the low-pass filter that the signal passes [s]; 0 passes it as it is."""
    error_scale: Array
    """Signal at which the scaled error is 1."""
    rate_scale: Array
    """Factor on the signal's change per sample, before it is clipped."""


def pose_errors(state: FilterState, truth: TruePose | None) -> tuple[Array, Array]:
    """||R_err||_I in [0, 1] and ||P_err|| [m], with R_err = R_est R^T, P_err = P_est - R_err P.

    Raises:
        ArgumentError: The true pose is not known.
    """
    if truth is None:
        raise ArgumentError(
            'signal "pose" needs the true pose; use "measured" where it is not known'
        )
    position = subtract(state.place, rotate(rows(state.attitude), truth.origin))
    return attitude_distance(state.attitude, truth.attitude), norm(position)


def measured_errors(state: FilterState, sample: Sample) -> tuple[Array, Array]:
    """The same two errors from what a vehicle has.

    The attitude part is 3/(8 sum s_i) sum_i s_i |R_est v_i^B - v_i^I|^2, by the profile matrix
    3/(8 sum s_i) [sum_i s_i (|v_i^B|^2 + |v_i^I|^2) - 2 tr(R_est B)]; it is ||R_err||_I for
    orthonormal vectors without noise. The position part is |T_est y_i - p_i| [m] averaged over the
    landmarks by weight. Each part is 0 at a sample without vectors or landmarks.
    """
    R = rows(state.attitude)
    columns = tuple(zip(*sample.profile, strict=True))
    trace = dot(R[0], columns[0]) + dot(R[1], columns[1]) + dot(R[2], columns[2])
    # Zero but for rounding where every vector fits, so the difference may come out below 0.
    attitude = sample.attitude_scale * maximum(sample.vector_power - 2 * trace, 0.0)
    position = jnp.zeros_like(attitude)
    for x, landmark in zip(seen_from_estimate(state, R, sample), sample.landmarks, strict=True):
        position = position + landmark.share * norm(subtract(x, landmark.inertial))
    return attitude, position


class SignalMemory(NamedTuple):
    """What the error signal and the schedule remember from sample to sample."""

    error: Array
    """The last error signal, smoothed, unscaled; not read before the first sample."""
    gain: Array
    """The last gain asked for [1/s]."""
    time_step: Array
    """Time since the last sample [s]; infinite before the first one."""


def initial_memory(schedule: GainSchedule, like: Array) -> SignalMemory:
    """Memory before the first sample, at the shape and dtype of `like`."""
    gain = jnp.broadcast_to(jnp.asarray(schedule.initial_gain(), like.dtype), like.shape)
    return SignalMemory(
        error=jnp.zeros_like(like), gain=gain, time_step=jnp.full_like(like, jnp.inf)
    )


def scheduled_gain(
    schedule: PreparedSchedule,
    memory: SignalMemory,
    errors: tuple[Array, Array],
    time: Array,
    time_step: Array,
    settings: SignalSettings,
) -> tuple[Array, ScheduleInputs, SignalMemory]:
    """The gain K [1/s] that a schedule asks for, from the errors of attitude [1] and position [m].

    e = attitude + weight x position, passed through a first-order low-pass filter (backward Euler,
    started at the first e). The schedule sees e / error_scale and, as the rate,
    |e_k - e_{k-1}| x rate_scale, both clipped to [0, 1]. The rate is that of e itself, neither
    scaled nor clipped before, and 0 at the first sample.

    Returns:
        The gain, what the schedule saw, and the memory for the next sample.
    """
    attitude, position = errors
    now = attitude + settings.position_weight * position
    previous = choose(jnp.isinf(memory.time_step), now, memory.error)
    # Backward Euler over the time since the last sample: without smoothing, and at the first
    # sample, e is exactly `now`.
    old = settings.smoothing / (settings.smoothing + memory.time_step)
    e = now + old * (previous - now)
    inputs = ScheduleInputs(
        error=minimum(maximum(e / settings.error_scale, 0.0), 1.0),
        rate=minimum(jnp.abs(e - previous) * settings.rate_scale, 1.0),
        time=time,
        last=memory.gain,
    )
    gain = schedule(inputs)
    memory = SignalMemory(error=e, gain=gain, time_step=jnp.broadcast_to(time_step, e.shape))
    return gain, inputs, memory
