"""The one loop: a filter over samples, and what is wanted of it.

One loop serves all filters and all that is asked of them: estimates, true errors, or a cost alone,
which is summed up on the way, so that its memory does not grow with time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.arguments import check_type, fitting, refuse
from posegsa.filters.base import (
    Filter,
    Record,
    Samples,
    check_filter,
    samples_of,
    vectors_in,
)
from posegsa.model.cost import (
    CostParts,
    CostWeights,
    RecordedCost,
    SquaredErrors,
    sample_error,
)
from posegsa.model.estimate import FilterState
from posegsa.model.loops import scan_rows, scan_together
from posegsa.model.measurements import Measurements
from posegsa.model.se3 import Vec3, clip_distance, dot, norm, rotate, rows, subtract
from posegsa.model.signal import known_pose, pose_errors


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
    """(N, n, 3) c_i of each vector, body frame, in its unit; n is 0 where they are not learnt."""
    gain: Array
    """(N,) the gain K that the schedule asked for [1/s]; NaN of a filter without one."""
    gain_used: Array
    """(N,) the same after the gain limit, mean over the sub-steps [1/s]."""
    error: Array
    """(N,) the scaled error that the schedule saw, in [0, 1]."""
    rate: Array
    """(N,) the scaled rate that it saw, in [0, 1]."""


class ErrorTrack(NamedTuple):
    """True errors of simulations over N samples, for judging them; the shapes are of one."""

    attitude: Array
    """(N,) ||R_err||_I in [0, 1]."""
    position: Array
    """(N,) ||P_err|| [m], P_err = P_est - R_err P: the position error of the cost."""
    gain: Array
    """(N,) the gain K that was used, after the limit [1/s]; NaN of a filter without one."""
    distance: Array
    """(N,) |P_est - P| [m]: how far the estimate is from the body. The two differ by what the
    attitude's error makes of the body's distance from the origin."""
    bias: Array
    """(6,) the last bias estimate [rad/s, m/s], body frame, angular first."""
    vector_bias: Array
    """(n, 3) the last estimate of the vectors' biases, body frame; n is 0 where none is learnt."""

    def select(self, scenarios: slice) -> "ErrorTrack":
        """Some of the scenarios, of leaves (S, ...)."""
        return ErrorTrack(*(leaf[scenarios] for leaf in self))

    def until(self, sample: int) -> "ErrorTrack":
        """The errors before a sample, of leaves (S, N)."""
        names = ("attitude", "position", "gain", "distance")
        return self._replace(**{name: getattr(self, name)[:, :sample] for name in names})


Look = Callable[[Any, FilterState, Record, Samples, Any], tuple[Any, Any]]
"""Maps what has been summed up, the estimate before a sample, the step, the sample and its entry of
`extra` to the new sum and to what is stored of the sample."""


def run(
    look: Look,
    filter: Filter,
    samples: Samples,
    state: Any,
    *,
    count: Array | None = None,
    together: bool = False,
    extra: Any = (),
    total: Any = (),
) -> tuple[Any, Any, Any]:
    """Run a filter on over samples; `look` says what is summed up and stored of each.

    Args:
        look: what is wanted.
        filter: any.
        samples: N of them.
        state: the filter's before the first of them.
        count: samples from this one on change nothing; by default all count.
        together: the samples and the state are those of S simulations: all leaves have one more
            axis (S, ...) in front.
        extra: leaves (N,), told to `look` sample by sample.
        total: the sum before the first sample.

    Returns:
        The state after the samples, the sum, and what `look` stored, stacked over time.
    """
    ready = filter.ready()

    def body(carry: Any, inputs: Any) -> tuple[Any, Any]:
        (state, total), (now, entry) = carry, inputs
        after, record = ready.step(state, now)
        total, stored = look(total, ready.estimate(state), record, now, entry)
        return (after, total), stored

    over_time = scan_together if together else scan_rows
    (last, total), stored = over_time(body, (state, total), (samples, extra), count)
    return last, total, stored


def simulate_cost(
    filter: Filter, samples: Samples, initial: FilterState, weights: CostWeights
) -> CostParts:
    """Cost of one simulation, summed up sample by sample; nothing else is stored (pure, jittable).

    Args:
        filter: any.
        samples: N of them, with the truth.
        initial: the estimate at the first.
        weights: of the cost, for N samples.
    """

    def look(
        total: CostParts, estimate: FilterState, record: Record, now: Samples, weight: Any
    ) -> tuple[CostParts, None]:
        transient, steady = weight
        error = sample_error(*pose_errors(estimate, now.truth), weights)
        return CostParts(total.transient + transient * error, total.steady + steady * error), None

    zero = jnp.zeros_like(initial.place[0])
    _, parts, _ = run(
        look,
        filter,
        samples,
        filter.start(initial, vectors_in(samples)),
        extra=(weights.transient, weights.steady),
        total=CostParts(zero, zero),
    )
    return parts


def simulate_recorded_cost(
    filter: Filter, samples: Samples, initial: FilterState, recorded: RecordedCost
) -> Array:
    """Cost on a recording, summed up sample by sample; nothing else is stored (pure, jittable)."""

    def look(
        total: SquaredErrors, estimate: FilterState, record: Record, now: Samples, entry: Any
    ) -> tuple[SquaredErrors, None]:
        weight, place = entry
        attitude, _ = pose_errors(estimate, now.truth)
        off = subtract(estimate.place, place)
        return SquaredErrors(
            total.attitude + weight * attitude, total.position + weight * dot(off, off)
        ), None

    zero = jnp.zeros_like(initial.place[0])
    _, squares, _ = run(
        look,
        filter,
        samples,
        filter.start(initial, vectors_in(samples)),
        extra=(recorded.weight, recorded.position),
        total=SquaredErrors(zero, zero),
    )
    return squares.cost(recorded.position_weight)


@jax.jit
def simulate(filter: Filter, samples: Samples, initial: FilterState) -> Estimates:
    """The estimates of one simulation over all its samples."""
    state = filter.start(initial, vectors_in(samples))
    _, _, stored = run(_everything, filter, samples, state)
    return _estimates(samples, *stored)


@jax.jit
def simulate_part(filter: Filter, samples: Samples, state: Any) -> tuple[Any, Estimates]:
    """The estimates over a part of a sequence, and the state before the next part."""
    last, _, stored = run(_everything, filter, samples, state)
    return last, _estimates(samples, *stored)


def _everything(
    total: tuple[()], estimate: FilterState, record: Record, now: Samples, entry: tuple[()]
) -> tuple[tuple[()], tuple[FilterState, Record]]:
    """Stores all that `Estimates` are made of."""
    return total, (estimate, record)


def _estimates(samples: Samples, states: FilterState, records: Record) -> Estimates:
    of_gain = {
        name: jnp.full_like(samples.time, jnp.nan) if values is None else values
        for name, values in records._asdict().items()
    }
    return Estimates(
        time=samples.time,
        rotation=states.rotation,
        position=states.position,
        bias=states.bias,
        vector_bias=states.vector_bias,
        **of_gain,
    )


def simulate_errors(filter: Filter, samples: Samples, initial: FilterState) -> ErrorTrack:
    """The true errors of one simulation over all its samples (pure, jittable)."""
    state = filter.start(initial, vectors_in(samples))
    last, _, errors = run(_true_errors, filter, samples, state)
    return _error_track(samples, filter.ready().estimate(last), errors)


def simulate_errors_together(
    filter: Filter, samples: Samples, initial: FilterState, count: Array
) -> ErrorTrack:
    """The true errors of S simulations, all leaves (S, ...) (pure, jittable).

    Samples from `count` on change nothing, and what is stored of them means nothing: so samples of
    any number can be filled up, to be run by one program.
    """
    vectors = vectors_in(samples)
    state = jax.vmap(lambda one: filter.start(one, vectors))(initial)
    last, _, errors = run(_true_errors, filter, samples, state, count=count, together=True)
    return _error_track(samples, jax.vmap(filter.ready().estimate)(last), errors)


def _true_errors(
    total: tuple[()], estimate: FilterState, record: Record, now: Samples, entry: tuple[()]
) -> tuple[tuple[()], tuple[Array, Array, Array | None, Vec3]]:
    """Stores what an `ErrorTrack` is made of."""
    return total, (*pose_errors(estimate, now.truth), record.gain_used, estimate.place)


def _error_track(
    samples: Samples, last: FilterState, errors: tuple[Array, Array, Array | None, Vec3]
) -> ErrorTrack:
    attitude, position, gain, place = errors
    return ErrorTrack(
        attitude=clip_distance(attitude),
        position=position,
        gain=jnp.full_like(attitude, jnp.nan) if gain is None else gain,
        distance=distances(place, samples),
        bias=last.bias,
        vector_bias=last.vector_bias,
    )


def distances(place: Vec3, samples: Samples) -> Array:
    """|P_est - P| (N,) [m] of estimated positions by components (N,) (pure, jittable).

    Made after the loop, whose arithmetic stays what it is without it.

    Raises:
        ArgumentError: The samples do not hold the true pose.
    """
    truth = known_pose(samples.truth)
    return norm(subtract(place, rotate(rows(truth.attitude), truth.origin)))


def step(
    filter: Filter, state: Any, measurement: Measurements, time: ArrayLike = 0.0
) -> tuple[Any, Record]:
    """One sample, for use on-line in a JAX program of one's own.

        state = filter.start(posegsa.initial_state(R, P), vectors=2)
        state, record = posegsa.step(filter, state, measurements.at(k))
        filter.ready().estimate(state).rotation

    Args:
        filter: any.
        state: from `filter.start`, or from the last step.
        measurement: one sample, without a time axis (`measurements.at(k)`).
        time: since the first sample [s]; only schedules over time look at it.

    Returns:
        The state at the next sample, and what happened at this one.

    Raises:
        ArgumentError: An argument is of another type, or they do not fit together.
    """
    check_filter("filter", filter)
    check_type("measurement", measurement, Measurements)
    if isinstance(state, FilterState):
        refuse("state: a FilterState", "what filter.start(initial, vectors) returns")
    with fitting("step"):
        return _step(filter, state, measurement, time)


@jax.jit
def _step(
    filter: Filter, state: Any, measurement: Measurements, time: ArrayLike
) -> tuple[Any, Record]:
    since_start = jnp.asarray(time, measurement.time_step.dtype)
    return filter.ready().step(state, Samples(since_start, filter.prepare(measurement), None))


def run_filter(filter: Filter, measurements: Measurements, initial: FilterState) -> Estimates:
    """Run a filter over a whole measurement sequence of a user's own.

    Args:
        filter: e.g. `Observer` of a schedule.
        measurements: N samples (`posegsa.model.measurements`).
        initial: the estimate at the first sample (`posegsa.initial_state`); the vectors' biases, if
            they are learnt, begin at 0.

    Raises:
        ArgumentError: An argument is of another type, or the filter looks at the true pose.
        MeasurementError: The measurements hold what `Measurements.from_arrays` refuses.
    """
    check_filter("filter", filter)
    check_type("measurements", measurements, Measurements)
    check_type("initial", initial, FilterState)
    with fitting("run_filter"):
        measurements = measurements.checked()
        vectors = np.shape(measurements.vector_weights)[-1]
        filter.start(initial, vectors)
        return simulate(filter, samples_of(filter, measurements), initial)
