"""A whole simulation: lax.scan of gain and filter step over the samples.

One loop body serves both forms: the trajectory form returns the estimates, the running form only
sums the cost up and stores nothing, so that its memory does not grow with time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.typing import ArrayLike

from posegsa.arguments import check_type, fitting
from posegsa.cost import CostParts, CostWeights, sample_error
from posegsa.errors import ArgumentError
from posegsa.filter import FilterSettings, FilterState, advance
from posegsa.gain import (
    GainSchedule,
    PreparedSchedule,
    ScheduleInputs,
    SignalMemory,
    SignalSettings,
    TruePose,
    initial_memory,
    measured_errors,
    pose_errors,
    scheduled_gain,
)
from posegsa.measurements import Measurements, Sample, prepare
from posegsa.se3 import quaternion, split


class Track(NamedTuple):
    """All that a simulation reads, time-major and by components, for one scenario."""

    time: Array
    """(N,) [s]."""
    sample: Sample
    """Components (N,)."""
    truth: TruePose | None
    """Components (N,); None where only the measurements are known."""


class Loop(NamedTuple):
    """What is carried from sample to sample."""

    state: FilterState
    memory: SignalMemory


class Step(NamedTuple):
    """What happened at a sample, beside the change of state."""

    inputs: ScheduleInputs
    """What the schedule saw."""
    gain: Array
    """The gain K that it asked for [1/s]."""
    gain_used: Array
    """The same after the gain limit, mean over the sub-steps [1/s]."""


class Estimates(NamedTuple):
    """The filter's output over N samples; sample k is the estimate before its update."""

    time: Array
    """(N,) [s]."""
    rotation: Array
    """(N, 3, 3) R_est, body to inertial."""
    position: Array
    """(N, 3) P_est [m], inertial frame."""
    bias: Array
    """(N, 6) b_est [rad/s, m/s], body frame, angular first."""
    gain: Array
    """(N,) the gain K that the schedule asked for [1/s]."""
    gain_used: Array
    """(N,) the same after the gain limit, mean over the sub-steps [1/s]."""
    error: Array
    """(N,) the scaled error that the schedule saw, in [0, 1]."""
    rate: Array
    """(N,) the scaled rate that it saw, in [0, 1]."""


def track(
    measurements: Measurements, rotation: Array | None = None, position: Array | None = None
) -> Track:
    """Measurements, and the truth where it is known, in the form of the loop (pure, jittable).

    Args:
        measurements: N samples.
        rotation: (N, 3, 3) true R.
        position: (N, 3) true P [m].
    """
    step = measurements.time_step
    time = jnp.cumsum(step) - step
    truth = None
    if rotation is not None and position is not None:
        w, x, y, z = split(quaternion(rotation))
        ox, oy, oz = split(jnp.einsum("nji,nj->ni", rotation, position, precision="highest"))
        truth = TruePose((w, x, y, z), (ox, oy, oz))
    return Track(time, prepare(measurements), truth)


def _advance(
    loop: Loop,
    time: Array,
    sample: Sample,
    truth: TruePose | None,
    schedule: PreparedSchedule,
    settings: FilterSettings,
    signal: SignalSettings,
) -> tuple[Loop, Step]:
    """One sample of the closed loop: signal, gain, filter step."""
    if signal.signal == "pose":
        if truth is None:
            raise ArgumentError(
                'signal "pose" needs the true pose; use "measured" where it is not known'
            )
        errors = pose_errors(loop.state, truth)
    else:
        errors = measured_errors(loop.state, sample)
    gain, inputs, memory = scheduled_gain(
        schedule, loop.memory, errors, time, sample.time_step, signal
    )
    state, used = advance(loop.state, sample, gain, settings)
    return Loop(state, memory), Step(inputs, gain, used)


def _scan(body: Callable[[Any, Any], tuple[Any, Any]], start: Any, samples: Any) -> tuple[Any, Any]:
    """`lax.scan` over the samples, whose numbers travel as one row of one array.

    A step then takes its numbers by one slice. Were they some fifty arrays, XLA would fuse a slice
    of each into the loops over agents, and LLVM does not vectorise a loop that looks up its own
    index: 2.3 times slower on CPUs.
    """
    leaves, structure = jax.tree.flatten(samples)
    rows = jnp.stack(leaves, axis=-1)

    def on_row(carry: Any, row: Array) -> tuple[Any, Any]:
        return body(carry, jax.tree.unflatten(structure, [row[i] for i in range(len(leaves))]))

    return lax.scan(on_row, start, rows)


def simulate_cost(
    schedule: GainSchedule,
    scenario: Track,
    initial: FilterState,
    weights: CostWeights,
    settings: FilterSettings,
    signal: SignalSettings,
) -> CostParts:
    """Cost of one simulation, run up sample by sample; nothing else is stored (pure, jittable)."""
    prepared = schedule.prepare()
    zero = jnp.zeros_like(initial.place[0])

    def body(carry, inputs):
        loop, (transient, steady) = carry
        time, sample, truth, transient_weight, steady_weight = inputs
        error = sample_error(*pose_errors(loop.state, truth), weights)
        loop, _ = _advance(loop, time, sample, truth, prepared, settings, signal)
        return (
            loop,
            CostParts(transient + transient_weight * error, steady + steady_weight * error),
        ), None

    start = begin(schedule, initial), CostParts(zero, zero)
    inputs = (scenario.time, scenario.sample, scenario.truth, weights.transient, weights.steady)
    (_, parts), _ = _scan(body, start, inputs)
    return parts


@jax.jit
def simulate(
    schedule: GainSchedule,
    scenario: Track,
    initial: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> Estimates:
    """The estimates of one simulation over all its samples."""
    prepared = schedule.prepare()

    def body(loop, inputs):
        time, sample, truth = inputs
        after, step = _advance(loop, time, sample, truth, prepared, settings, signal)
        return after, (loop.state, step)

    start = begin(schedule, initial)
    inputs = (scenario.time, scenario.sample, scenario.truth)
    _, (states, steps) = _scan(body, start, inputs)
    return Estimates(
        scenario.time,
        states.rotation,
        states.position,
        states.bias,
        steps.gain,
        steps.gain_used,
        steps.inputs.error,
        steps.inputs.rate,
    )


class ErrorTrack(NamedTuple):
    """True errors of one simulation over N samples, for judging it."""

    attitude: Array
    """(N,) ||R_err||_I in [0, 1]."""
    position: Array
    """(N,) ||P_err|| [m]."""
    gain: Array
    """(N,) the gain K that was used, after the limit [1/s]."""
    bias: Array
    """(6,) the last bias estimate [rad/s, m/s], body frame, angular first."""


def simulate_errors(
    schedule: GainSchedule,
    scenario: Track,
    initial: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> ErrorTrack:
    """The true errors of one simulation over all its samples (pure, jittable)."""
    prepared = schedule.prepare()

    def body(loop, inputs):
        time, sample, truth = inputs
        errors = pose_errors(loop.state, truth)
        loop, step = _advance(loop, time, sample, truth, prepared, settings, signal)
        return loop, (*errors, step.gain_used)

    inputs = (scenario.time, scenario.sample, scenario.truth)
    last, (attitude, position, gain) = _scan(body, begin(schedule, initial), inputs)
    return ErrorTrack(attitude, position, gain, last.state.bias)


def begin(schedule: GainSchedule, initial: FilterState) -> Loop:
    """The closed loop before its first sample, for `scheduled_step`.

    Raises:
        ArgumentError: an argument is of another type.
    """
    _check_schedule(schedule)
    check_type("initial", initial, FilterState)
    return Loop(initial, initial_memory(schedule, initial.place[0]))


def scheduled_step(
    loop: Loop,
    measurement: Measurements,
    schedule: GainSchedule,
    settings: FilterSettings,
    signal: SignalSettings,
    time: ArrayLike = 0.0,
) -> tuple[Loop, Array]:
    """One sample of the closed loop, for use on-line: error signal, gain and filter step.

    Args:
        loop: from `begin`, or from the last step; `loop.state` is the estimate.
        measurement: one sample, without a time axis (`measurements.at(k)`).
        schedule: e.g. a tuned result's.
        settings: the filter's.
        signal: the error signal's; "measured", since the truth is not known.
        time: since the first sample [s]; only schedules over time look at it.

    Returns:
        The loop with the estimate at the next sample, and the gain K [1/s] that was asked for.

    Raises:
        ArgumentError: an argument is of another type, or they do not fit together.
    """
    check_type("loop", loop, Loop)
    check_type("measurement", measurement, Measurements)
    _check_schedule(schedule)
    check_type("settings", settings, FilterSettings)
    check_type("signal", signal, SignalSettings)
    with fitting("scheduled_step"):
        return _scheduled_step(loop, measurement, schedule, settings, signal, time)


def _check_schedule(schedule: GainSchedule) -> None:
    if not (hasattr(schedule, "prepare") and hasattr(schedule, "initial_gain")):
        what = type(schedule).__name__
        raise ArgumentError(f"schedule: a {what}; allowed: ConstantGain, FuzzyGain or the like")


@jax.jit
def _scheduled_step(
    loop: Loop,
    measurement: Measurements,
    schedule: GainSchedule,
    settings: FilterSettings,
    signal: SignalSettings,
    time: ArrayLike,
) -> tuple[Loop, Array]:
    now = jnp.asarray(time, measurement.time_step.dtype)
    sample = prepare(measurement)
    after, step = _advance(loop, now, sample, None, schedule.prepare(), settings, signal)
    return after, step.gain


def run_filter(
    schedule: GainSchedule,
    measurements: Measurements,
    initial: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> Estimates:
    """Runs a gain schedule over a whole measurement sequence of a user's own.

    Args:
        schedule: e.g. `ConstantGain`, or `FuzzyGain` of a tuned controller.
        measurements: N samples (`posegsa.measurements`).
        initial: the estimate at the first sample (`posegsa.initial_state`).
        settings: the filter's.
        signal: the error signal's; "measured", since the truth is not known.

    Raises:
        ArgumentError: an argument is of another type, or the signal is "pose".
        MeasurementError: the measurements hold what `Measurements.from_arrays` refuses.
    """
    _check_schedule(schedule)
    check_type("measurements", measurements, Measurements)
    check_type("initial", initial, FilterState)
    check_type("settings", settings, FilterSettings)
    check_type("signal", signal, SignalSettings)
    with fitting("run_filter"):
        return simulate(schedule, track(measurements.checked()), initial, settings, signal)
