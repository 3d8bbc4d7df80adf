"""A whole simulation: `lax.scan` of gain and filter step over the samples.

One loop computes estimates, true errors, or the cost alone. The cost is accumulated, so its memory
does not grow with time.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.arguments import check_type, fitting
from posegsa.model.cost import (
    CostParts,
    CostWeights,
    RecordedCost,
    SquaredErrors,
    sample_error,
)
from posegsa.model.filter import FilterSettings, FilterState, observe, ready, see
from posegsa.model.loops import scan_rows, scan_together
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample, prepare
from posegsa.model.schedules import GainSchedule, PreparedSchedule, ScheduleInputs, check_schedule
from posegsa.model.se3 import (
    Vec3,
    clip_distance,
    dot,
    norm,
    quaternion,
    rotate,
    rows,
    subtract,
    unstack,
)
from posegsa.model.signal import (
    Measured,
    SignalMemory,
    SignalSettings,
    TruePose,
    initial_memory,
    known_pose,
    measured_errors,
    pose_errors,
    scheduled_gain,
)
from posegsa.model.vectors import VectorSettings
from posegsa.stored_programs import stored


class Samples(NamedTuple):
    """The inputs of one simulation, time-major and by components."""

    time: Array
    """(N,) [s]."""
    sample: Sample
    """Components (N,)."""
    truth: TruePose | None
    """Components (N,); None if only the measurements are known."""


class ClosedLoop(NamedTuple):
    """The state that is carried from sample to sample."""

    state: FilterState
    memory: SignalMemory


class StepRecord(NamedTuple):
    """What happened at a sample, besides the change of state."""

    inputs: ScheduleInputs
    """The inputs of the schedule."""
    gain: Array
    """The gain K that the schedule asked for [1/s]."""
    gain_used: Array
    """K after the gain limit, mean over the sub-steps [1/s]."""


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
    vector_bias: Array
    """(N, n, 3) c_i of each vector, body frame, in its unit; n is 0 if they are not estimated."""
    gain: Array
    """(N,) the gain K that the schedule asked for [1/s]."""
    gain_used: Array
    """(N,) K after the gain limit, mean over the sub-steps [1/s]."""
    error: Array
    """(N,) the scaled error, input of the schedule, in [0, 1]."""
    rate: Array
    """(N,) the scaled rate, input of the schedule, in [0, 1]."""


class ErrorTrack(NamedTuple):
    """True errors of a simulation over N samples; S simulations have a leading axis S."""

    attitude: Array
    """(N,) ||R_err||_I in [0, 1]."""
    position: Array
    """(N,) ||P_err|| [m], P_err = P_est - R_err P: the position error of the cost."""
    gain: Array
    """(N,) the gain K that was used, after the limit [1/s]."""
    distance: Array
    """(N,) |P_est - P| [m], the distance of the estimate from the body. It differs from `position`
    by the attitude error times the body's distance from the origin."""
    bias: Array
    """(6,) the last bias estimate [rad/s, m/s], body frame, angular first."""
    vector_bias: Array
    """(n, 3) the last estimate of the vectors' biases, body frame; n is 0 if none is estimated."""

    def select(self, scenarios: slice) -> "ErrorTrack":
        """Some of S simulations."""
        return ErrorTrack(*(leaf[scenarios] for leaf in self))


def samples_of(
    measurements: Measurements,
    vectors: VectorSettings,
    rotation: Array | None = None,
    position: Array | None = None,
    time: Array | None = None,
) -> Samples:
    """Measurements, and the truth where it is known, in the form of the loop (pure, jittable).

    Args:
        measurements: N samples.
        vectors: how the filter uses vectors.
        rotation: (N, 3, 3) true R.
        position: (N, 3) true P [m].
        time: (N,) [s]; by default the sum of the time steps, from 0.
    """
    if time is None:
        step = measurements.time_step
        time = jnp.cumsum(step) - step
    truth = None
    if rotation is not None and position is not None:
        w, x, y, z = unstack(quaternion(rotation))
        ox, oy, oz = unstack(jnp.einsum("nji,nj->ni", rotation, position, precision="highest"))
        truth = TruePose(attitude=(w, x, y, z), origin=(ox, oy, oz))
    return Samples(time, prepare(measurements, vectors), truth)


def closed_loop_step(
    loop: ClosedLoop,
    now: Samples,
    schedule: PreparedSchedule,
    settings: FilterSettings,
    signal: SignalSettings,
) -> tuple[ClosedLoop, StepRecord]:
    """One sample of the closed loop: signal, gain, filter step."""
    seen = see(loop.state, now.sample, settings)
    if signal.signal == "pose":
        errors = Measured(*pose_errors(loop.state, now.truth), True, True)
    else:
        errors = measured_errors(loop.state, now.sample, seen)
    gains, inputs, memory = scheduled_gain(
        schedule, loop.memory, errors, now.time, now.sample.time_step, signal
    )
    state, used = observe(loop.state, now.sample, seen, gains, settings)
    return ClosedLoop(state, memory), StepRecord(inputs, gains.gain, used)


Look = Callable[[Any, FilterState, StepRecord, Samples, Any], tuple[Any, Any]]
"""Maps the sum so far, the estimate before a sample, the step, the sample and its entry of `extra`
to the new sum and to what is stored for the sample."""


def _simulate(
    look: Look,
    schedule: GainSchedule,
    samples: Samples,
    loop: ClosedLoop,
    settings: FilterSettings,
    signal: SignalSettings,
    *,
    count: Array | None = None,
    together: bool = False,
    extra: Any = (),
    total: Any = (),
) -> tuple[ClosedLoop, Any, Any]:
    """Run the closed loop over the samples; `look` defines what is summed and stored.

    Samples from `count` on, if given, change nothing. With `together`, S simulations run at once
    and all leaves have a leading axis S.

    Returns:
        The loop after the samples, the sum, which starts as `total`, and what `look` stored,
        stacked over time.
    """
    prepared, gammas = schedule.prepare(), _gammas_by_sample(settings, samples)

    def body(carry: Any, inputs: Any) -> tuple[Any, Any]:
        (loop, total), (now, entry, gamma) = carry, inputs
        after, record = closed_loop_step(loop, now, prepared, replace(settings, **gamma), signal)
        total, stored = look(total, loop.state, record, now, entry)
        return (after, total), stored

    over_time = scan_together if together else scan_rows
    (last, total), stored = over_time(body, (loop, total), (samples, extra, gammas), count)
    return last, total, stored


def _gammas_by_sample(settings: FilterSettings, samples: Samples) -> dict[str, Array]:
    """Those gammas that are given per sample, (N,) each, by name."""
    time = samples.time
    given = {name: getattr(settings, name) for name in ("gamma_angular", "gamma_linear")}
    return {name: jnp.asarray(g, time.dtype) for name, g in given.items() if np.ndim(g)}


def simulate_cost(
    schedule: GainSchedule,
    samples: Samples,
    initial: FilterState,
    weights: CostWeights,
    settings: FilterSettings,
    signal: SignalSettings,
) -> CostParts:
    """Cost of one simulation, accumulated over samples; nothing else is stored (pure, jittable)."""

    def look(
        total: CostParts, state: FilterState, record: StepRecord, now: Samples, weight: Any
    ) -> tuple[CostParts, None]:
        transient, steady = weight
        error = sample_error(*pose_errors(state, now.truth), weights)
        return CostParts(total.transient + transient * error, total.steady + steady * error), None

    zero = jnp.zeros_like(initial.place[0])
    _, parts, _ = _simulate(
        look,
        schedule,
        samples,
        begin(schedule, initial),
        settings,
        signal,
        extra=(weights.transient, weights.steady),
        total=CostParts(zero, zero),
    )
    return parts


def squared_errors(
    total: SquaredErrors, state: FilterState, now: Samples, weight: Array, place: Vec3
) -> SquaredErrors:
    """The sums after one more sample with this weight and true position [m]."""
    attitude, _ = pose_errors(state, now.truth)
    off = subtract(state.place, place)
    return SquaredErrors(
        total.attitude + weight * attitude, total.position + weight * dot(off, off)
    )


def simulate_recorded_cost(
    schedule: GainSchedule,
    samples: Samples,
    initial: FilterState,
    recorded: RecordedCost,
    settings: FilterSettings,
    signal: SignalSettings,
) -> Array:
    """Cost on a recording, accumulated over samples; nothing else is stored (pure, jittable)."""

    def look(
        total: SquaredErrors, state: FilterState, record: StepRecord, now: Samples, entry: Any
    ) -> tuple[SquaredErrors, None]:
        return squared_errors(total, state, now, *entry), None

    zero = jnp.zeros_like(initial.place[0])
    _, squares, _ = _simulate(
        look,
        schedule,
        samples,
        begin(schedule, initial),
        settings,
        signal,
        extra=(recorded.weight, recorded.position),
        total=SquaredErrors(zero, zero),
    )
    return squares.cost(recorded.position_weight)


@stored
def simulate(
    schedule: GainSchedule,
    samples: Samples,
    initial: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> Estimates:
    """The estimates of one simulation over all its samples."""
    loop = begin(schedule, initial)
    _, _, stored = _simulate(_everything, schedule, samples, loop, settings, signal)
    return _estimates(samples, *stored)


@stored
def simulate_part(
    schedule: GainSchedule,
    samples: Samples,
    loop: ClosedLoop,
    settings: FilterSettings,
    signal: SignalSettings,
) -> tuple[ClosedLoop, Estimates]:
    """The closed loop after a part of a sequence, and the estimates over that part."""
    last, _, stored = _simulate(_everything, schedule, samples, loop, settings, signal)
    return last, _estimates(samples, *stored)


def _everything(
    total: tuple[()], state: FilterState, record: StepRecord, now: Samples, entry: tuple[()]
) -> tuple[tuple[()], tuple[FilterState, StepRecord]]:
    """A `Look` that stores what `Estimates` needs."""
    return total, (state, record)


def _estimates(samples: Samples, states: FilterState, records: StepRecord) -> Estimates:
    return Estimates(
        time=samples.time,
        rotation=states.rotation,
        position=states.position,
        bias=states.bias,
        vector_bias=states.vector_bias,
        gain=records.gain,
        gain_used=records.gain_used,
        error=records.inputs.error,
        rate=records.inputs.rate,
    )


def simulate_errors(
    schedule: GainSchedule,
    samples: Samples,
    initial: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> ErrorTrack:
    """The true errors of one simulation over all its samples (pure, jittable)."""
    loop = begin(schedule, initial)
    last, _, errors = _simulate(_true_errors, schedule, samples, loop, settings, signal)
    return _error_track(samples, last, errors)


def errors_onward(
    schedule: GainSchedule,
    samples: Samples,
    loop: ClosedLoop,
    settings: FilterSettings,
    signal: SignalSettings,
    count: Array,
) -> tuple[ClosedLoop, ErrorTrack]:
    """Continue S simulations: their loops after more samples, and their true errors there.

    All leaves have a leading axis S. Samples from `count` on change nothing, and the errors there
    are meaningless: so pieces of any length run as one program (pure, jittable).
    """
    last, _, errors = _simulate(
        _true_errors, schedule, samples, loop, settings, signal, count=count, together=True
    )
    return last, _error_track(samples, last, errors)


def _true_errors(
    total: tuple[()], state: FilterState, record: StepRecord, now: Samples, entry: tuple[()]
) -> tuple[tuple[()], tuple[Array, Array, Array, Vec3]]:
    """A `Look` that stores what `ErrorTrack` needs."""
    return total, (*pose_errors(state, now.truth), record.gain_used, state.place)


def _error_track(
    samples: Samples, last: ClosedLoop, errors: tuple[Array, Array, Array, Vec3]
) -> ErrorTrack:
    attitude, position, gain, place = errors
    return ErrorTrack(
        attitude=clip_distance(attitude),
        position=position,
        gain=gain,
        distance=distances(place, samples),
        bias=last.state.bias,
        vector_bias=last.state.vector_bias,
    )


def distances(place: Vec3, samples: Samples) -> Array:
    """|P_est - P| (N,) [m] of estimated positions by components (N,) (pure, jittable).

    Computed after the loop, so that the loop's rounding stays the same.

    Raises:
        ArgumentError: The samples do not include the true pose.
    """
    truth = known_pose(samples.truth)
    return norm(subtract(place, rotate(rows(truth.attitude), truth.origin)))


def begin(schedule: GainSchedule, initial: FilterState) -> ClosedLoop:
    """The closed loop before its first sample, for `scheduled_step`.

    Raises:
        ArgumentError: an argument is of another type.
    """
    check_schedule(schedule)
    check_type("initial", initial, FilterState)
    return ClosedLoop(initial, initial_memory(schedule, initial.place[0]))


def scheduled_step(
    loop: ClosedLoop,
    measurement: Measurements,
    schedule: GainSchedule,
    settings: FilterSettings,
    signal: SignalSettings,
    time: ArrayLike = 0.0,
) -> tuple[ClosedLoop, Array]:
    """One sample of the closed loop, for use on-line: error signal, gain and filter step.

    Args:
        loop: from `begin`, or from the last step; `loop.state` is the estimate.
        measurement: one sample, without a time axis (`measurements.at(k)`).
        schedule: e.g. that of a tuned result.
        settings: of the filter.
        signal: of the error signal; "measured", since the truth is not known.
        time: since the first sample [s]; only schedules over time use it.

    Returns:
        The loop with the estimate at the next sample, and the gain K [1/s] that the schedule asked
        for.

    Raises:
        ArgumentError: an argument has the wrong type, or they do not fit together.
    """
    check_type("loop", loop, ClosedLoop)
    check_type("measurement", measurement, Measurements)
    check_schedule(schedule)
    check_type("settings", settings, FilterSettings)
    check_type("signal", signal, SignalSettings)
    with fitting("scheduled_step"):
        loop = loop._replace(state=ready(loop.state, measurement, settings))
        return _scheduled_step(loop, measurement, schedule, settings, signal, time)


@jax.jit
def _scheduled_step(
    loop: ClosedLoop,
    measurement: Measurements,
    schedule: GainSchedule,
    settings: FilterSettings,
    signal: SignalSettings,
    time: ArrayLike,
) -> tuple[ClosedLoop, Array]:
    since_start = jnp.asarray(time, measurement.time_step.dtype)
    now = Samples(since_start, prepare(measurement, settings.vectors), None)
    after, record = closed_loop_step(loop, now, schedule.prepare(), settings, signal)
    return after, record.gain


def run_filter(
    schedule: GainSchedule,
    measurements: Measurements,
    initial: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> Estimates:
    """Run a gain schedule over a sequence of measurements.

    Args:
        schedule: e.g. `ConstantGain`, or `FuzzyGain` of a tuned controller.
        measurements: N samples (`posegsa.model.measurements`).
        initial: the estimate at the first sample (`posegsa.initial_state`); estimates of the
            vectors' biases, if the filter has them, start at 0.
        settings: of the filter; for a tuned result `filter_settings(result.tuned)`.
        signal: of the error signal; "measured", since the truth is not known.

    Raises:
        ArgumentError: an argument has the wrong type, or the signal is "pose".
        MeasurementError: the measurements contain what `Measurements.from_arrays` refuses.
    """
    check_schedule(schedule)
    check_type("measurements", measurements, Measurements)
    check_type("initial", initial, FilterState)
    check_type("settings", settings, FilterSettings)
    check_type("signal", signal, SignalSettings)
    with fitting("run_filter"):
        measurements = measurements.checked()
        initial = ready(initial, measurements, settings)
        return simulate(
            schedule,
            samples_of(measurements, settings.vectors),
            initial,
            settings,
            signal,
        )
