"""Runs a filter over samples.

One loop serves all filters and all outputs: estimates, true errors, or a cost alone. The cost is
summed up inside the loop, so that its memory does not grow with time.
"""

from collections.abc import Callable, Sequence
from functools import partial
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
    elementwise,
    sensors_in,
    sensors_of,
)
from posegsa.filters.calls import estimated, of_shape, started, stepped
from posegsa.filters.covariance import matrix
from posegsa.filters.uncertainty import (
    PoseCovariance,
    attitude_deviations,
    nees,
    pose_covariance,
)
from posegsa.model.cost import (
    CostParts,
    CostWeights,
    RecordedCost,
    SquaredErrors,
    sample_error,
)
from posegsa.model.estimate import FilterState
from posegsa.model.loops import batched_alike, scan_lanes, scan_rows, scan_together
from posegsa.model.measurements import Measurements
from posegsa.model.se3 import Vec3, clip_distance, dot, norm, rotate, rows, subtract
from posegsa.model.signal import known_pose, pose_errors
from posegsa.words import counted


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
    """(N,) the gain K that the schedule requested [1/s]; NaN for a filter without a gain."""
    gain_used: Array
    """(N,) K after the gain limit, mean over the sub-steps [1/s]."""
    error: Array
    """(N,) the schedule's input scaled error, in [0, 1]."""
    rate: Array
    """(N,) the schedule's input scaled rate, in [0, 1]."""
    nis: Array | None = None
    """(N,) normalised innovation squared of each sample's measurements over its degrees of freedom,
    1 on average if the filter's noises are right, NaN where nothing was measured; None for a filter
    without a covariance."""
    covariance: Array | None = None
    """(N, 6, 6) covariance of the pose error xi = [theta; rho] (rad, m), body frame, with T =
    T_est exp(xi^); None for a filter without one. R_est Sigma_rho R_est^T is the position's in the
    inertial frame."""
    heading_deviation: Array | None = None
    """(N,) standard deviation of the heading [rad], from a filter that states it without a
    `covariance`."""
    inclination_deviation: Array | None = None
    """(N,) the same of the inclination."""

    def __repr__(self) -> str:
        return f"<Estimates of {counted(jnp.shape(self.time)[-1], 'sample')}>"


class ErrorTrack(NamedTuple):
    """True errors of a simulation over N samples; for S simulations all shapes start with S."""

    attitude: Array
    """(N,) ||R_err||_I in [0, 1]."""
    position: Array
    """(N,) ||P_err|| [m], P_err = P_est - R_err P: the position error of the cost."""
    gain: Array
    """(N,) the gain K after the limit [1/s]; NaN for a filter without a gain."""
    distance: Array
    """(N,) |P_est - P| [m], the distance of the estimate from the body. It differs from ||P_err||
    because an attitude error rotates P in P_err."""
    bias: Array
    """(6,) the last bias estimate [rad/s, m/s], body frame, angular first."""
    vector_bias: Array
    """(n, 3) the last estimate of the vectors' biases, body frame; n is 0 if none is estimated."""
    nees: Array | None = None
    """(N,) normalised estimation error squared of the pose, 6 on average if the filter's covariance
    is right; None for a filter without one."""
    nis: Array | None = None
    """(N,) as in `Estimates`."""

    def select(self, scenarios: slice) -> "ErrorTrack":
        """Some of the scenarios, of leaves (S, ...)."""
        return jax.tree.map(lambda leaf: leaf[scenarios], self)

    def waiting(self, time: Array, begin: Array | None) -> "ErrorTrack":
        """The errors, with those at `begin` [s], the start, at all samples before it.

        Before a start from the sensors nothing is estimated. `time` is (N,) [s]; None changes
        nothing.
        """
        if begin is None:
            return self
        index = jnp.arange(time.shape[0])
        index = jnp.maximum(index, jnp.argmax(time >= begin))
        return self._over_time(lambda leaf: leaf[index])

    def until(self, sample: int) -> "ErrorTrack":
        """The errors before a sample, of leaves (S, N)."""
        return self._over_time(lambda leaf: leaf[:, :sample])

    @staticmethod
    def joined(parts: Sequence["ErrorTrack"]) -> "ErrorTrack":
        """The errors of several parts, one after another in time; NumPy leaves (S, ...)."""
        whole = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=1), *parts)
        return whole._replace(bias=parts[-1].bias, vector_bias=parts[-1].vector_bias)

    def _over_time(self, change: Callable[[Array], Array]) -> "ErrorTrack":
        """The same with a change applied to every field that has a value at each sample."""
        changed = jax.tree.map(change, self._replace(bias=(), vector_bias=()))
        return changed._replace(bias=self.bias, vector_bias=self.vector_bias)


class View(NamedTuple):
    """What `run` offers to `look` at each sample; what is not used costs nothing."""

    estimate: FilterState
    """The estimate before the sample."""
    covariance: PoseCovariance | None
    """The covariance of its pose; None for a filter without one."""
    deviations: tuple[Array, Array] | None
    """Standard deviations of heading and inclination [rad]; None for a filter without them."""
    record: Record
    """The record of the step."""
    now: Samples
    """The sample itself."""


Look = Callable[[Any, View, Any], tuple[Any, Any]]
"""Maps the sum so far, the view of a sample, and the sample's entry of `extra` to the new
sum and to the values stored for the sample."""


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
    """Run a filter over samples; `look` sums up and stores values at each.

    Args:
        look: called at each sample.
        filter: any filter.
        samples: N samples; or (S, N), each sequence for A simulations of an elementwise filter:
            the leaves of state and sum are (S A,), those of `extra` (S, N), without a `count`.
        state: state of the filter before the first sample.
        count: number of samples to use; later ones change nothing. By default all are used.
        together: whether samples and state belong to S simulations; then all leaves have one more
            axis (S, ...) in front, and `look` stores a pair: what is kept of each simulation and
            what is kept of the first one only.
        extra: leaves (N,), passed to `look` sample by sample.
        total: the sum before the first sample.

    Returns:
        The state after the last sample, the sum, and the values that `look` stored, stacked over
        time.
    """
    ready, shape = filter.ready(), ()
    if elementwise(filter):
        shapes = map(jnp.shape, jax.tree.leaves((state, total)))
        shape = jnp.broadcast_shapes(samples.time.shape[:-1] if together else (), *shapes)
        state = of_shape(state, shape)

    def body(carry: Any, inputs: Any) -> tuple[Any, Any]:
        (state, total), (now, entry) = carry, inputs
        after, record = stepped(ready, state, now, shape)
        known = pose_covariance(ready, state), attitude_deviations(state)
        view = View(*of_shape((estimated(ready, state), *known), shape), record, now)
        total, stored = look(total, view, entry)
        return (after, total), stored

    carry = (state, total)
    if together:
        step = body if elementwise(filter) else jax.vmap(body)
        (last, total), stored = scan_together(step, carry, (samples, extra), count)
    elif samples.time.ndim > 1:
        (last, total), stored = scan_lanes(body, carry, (samples, extra))
    else:
        carry = batched_alike(carry, (filter, samples))
        (last, total), stored = scan_rows(body, carry, (samples, extra), count)
    return last, total, stored


def simulate_cost(
    filter: Filter, samples: Samples, initial: FilterState, weights: CostWeights
) -> CostParts:
    """Cost of one simulation, summed up sample by sample; nothing else is stored (pure, jittable).

    Args:
        filter: any filter.
        samples: N samples, with the truth; or (S, N), as in `run`.
        initial: the estimate at the first sample.
        weights: weights of the cost, over time as the samples.
    """

    def look(total: CostParts, view: View, weight: Any) -> tuple[CostParts, None]:
        transient, steady = weight
        error = sample_error(*pose_errors(view.estimate, view.now.truth), weights)
        return CostParts(total.transient + transient * error, total.steady + steady * error), None

    extra = weights.transient, weights.steady
    return _summed(look, filter, samples, initial, extra, CostParts)


def simulate_recorded_cost(
    filter: Filter, samples: Samples, initial: FilterState, recorded: RecordedCost
) -> Array:
    """Cost on a recording, summed up sample by sample; nothing else is stored (pure, jittable).

    `samples` and `recorded` may be of S recordings, (S, N), as in `run`.
    """

    def look(total: SquaredErrors, view: View, entry: Any) -> tuple[SquaredErrors, None]:
        weight, place = entry
        attitude, _ = pose_errors(view.estimate, view.now.truth)
        off = subtract(view.estimate.place, place)
        return SquaredErrors(
            total.attitude + weight * attitude, total.position + weight * dot(off, off)
        ), None

    extra = recorded.weight, recorded.position
    squares = _summed(look, filter, samples, initial, extra, SquaredErrors)
    return squares.cost(recorded.position_weight)


def _summed(
    look: Look, filter: Filter, samples: Samples, initial: FilterState, extra: Any, kind: Any
) -> Any:
    """The sum of two numbers, of this kind, over all samples."""
    zero = jnp.zeros_like(initial.place[0])
    state = started(filter, initial, sensors_in(samples))
    return run(look, filter, samples, state, extra=extra, total=kind(zero, zero))[1]


@jax.jit
def simulate(filter: Filter, samples: Samples, initial: FilterState) -> Estimates:
    """The estimates of one simulation over all its samples."""
    state = started(filter, initial, sensors_in(samples))
    _, _, stored = run(_everything, filter, samples, state)
    return _estimates(samples.time, stored)


@jax.jit
def simulate_part(filter: Filter, samples: Samples, state: Any) -> tuple[Any, Estimates]:
    """The estimates over a part of a sequence, and the state before the next part."""
    last, _, stored = run(_everything, filter, samples, state)
    return last, _estimates(samples.time, stored)


def _everything(total: tuple[()], view: View, entry: tuple[()]) -> tuple[tuple[()], View]:
    """Store everything that `Estimates` needs."""
    return total, view._replace(now=())


def _estimates(time: Array, stored: View) -> Estimates:
    states, covariance = stored.estimate, stored.covariance
    heading, inclination = stored.deviations or (None, None)
    of_gain = {
        name: jnp.full_like(time, jnp.nan) if values is None else values
        for name, values in stored.record._asdict().items()
        if name in Estimates._fields and name != "nis"
    }
    return Estimates(
        time=time,
        rotation=states.rotation,
        position=states.position,
        bias=states.bias,
        vector_bias=states.vector_bias,
        nis=_nis(stored.record),
        covariance=None if covariance is None else matrix(covariance, 6),
        heading_deviation=heading,
        inclination_deviation=inclination,
        **of_gain,
    )


def _nis(record: Record) -> Array | None:
    """NIS over its degrees of freedom, from stored records."""
    if record.nis is None or record.scalars is None:
        return None
    return jnp.where(record.scalars > 0, record.nis / jnp.maximum(record.scalars, 1), jnp.nan)


def simulate_errors(filter: Filter, samples: Samples, initial: FilterState) -> ErrorTrack:
    """The true errors of one simulation over all its samples (pure, jittable)."""
    state = started(filter, initial, sensors_in(samples))
    last, _, errors = run(_true_errors, filter, samples, state)
    return _error_track(samples, estimated(filter.ready(), last), errors)


def simulate_errors_together(
    filter: Filter, samples: Samples, states: Any, count: Array
) -> tuple[Any, ErrorTrack, Estimates]:
    """The true errors of S simulations, all leaves (S, ...) (pure, jittable).

    Args:
        filter: any filter.
        samples: S times N samples, with the truth.
        states: the filter's states before the first samples.
        count: number of samples to use; later ones change nothing, and their errors are
            meaningless. So sequences of any length can be padded and run by one program.

    Returns:
        The states after the last sample, the errors, and the estimates of the first simulation.
    """

    def look(total: tuple[()], view: View, entry: tuple[()]) -> tuple[tuple[()], Any]:
        return total, (_true_errors(total, view, entry)[1], _everything(total, view, entry)[1])

    last, _, stored = run(look, filter, samples, states, count=count, together=True)
    errors, of_first = stored
    estimate = partial(estimated, filter.ready())
    if elementwise(filter):
        ends = of_shape(estimate(last), samples.time.shape[:-1])
    else:
        ends = jax.vmap(estimate)(last)
    return last, _error_track(samples, ends, errors), _estimates(samples.time[0], of_first)


def _true_errors(total: tuple[()], view: View, entry: tuple[()]) -> tuple[tuple[()], Any]:
    """Store what `ErrorTrack` needs."""
    estimate, covariance, _, record, now = view
    known = known_pose(now.truth)
    off = None if covariance is None else nees(estimate, covariance, known)
    return total, (*pose_errors(estimate, known), record, estimate.place, off)


def _error_track(samples: Samples, last: FilterState, errors: Any) -> ErrorTrack:
    attitude, position, record, place, nees = errors
    gain = record.gain_used
    return ErrorTrack(
        attitude=clip_distance(attitude),
        position=position,
        gain=jnp.full_like(attitude, jnp.nan) if gain is None else gain,
        distance=distances(place, samples),
        bias=last.bias,
        vector_bias=last.vector_bias,
        nees=nees,
        nis=_nis(record),
    )


def distances(place: Vec3, samples: Samples) -> Array:
    """|P_est - P| (N,) [m] of estimated positions by components (N,) (pure, jittable).

    Computed after the loop, so that the arithmetic of the loop does not change.

    Raises:
        ArgumentError: The samples do not hold the true pose.
    """
    truth = known_pose(samples.truth)
    return norm(subtract(place, rotate(rows(truth.attitude), truth.origin)))


def step(
    filter: Filter, state: Any, measurement: Measurements, time: ArrayLike = 0.0
) -> tuple[Any, Record]:
    """Process one sample, for use on-line in your own JAX program.

    ::

        state = filter.start(posegsa.initial_state(R, P), posegsa.Sensors(vectors=2, landmarks=1))
        state, record = posegsa.step(filter, state, measurements.at(k))
        filter.ready().estimate(state).rotation

    Args:
        filter: any filter.
        state: the state from `filter.start` or from the last step.
        measurement: one sample, without a time axis (`measurements.at(k)`).
        time: time since the first sample [s]; only schedules over time use it.

    Returns:
        The state at the next sample, and the record of this one.

    Raises:
        ArgumentError: An argument has the wrong type, or the arguments do not fit together.
    """
    check_filter("filter", filter)
    check_type("measurement", measurement, Measurements)
    with fitting("step"):
        if isinstance(state, FilterState):  # which is the state of some filters
            sensors = sensors_of(measurement)
            if not isinstance(started(filter, state, sensors), FilterState):
                refuse("state: a FilterState", "what filter.start(initial, sensors) returns")
        return _step(filter, state, measurement, time)


@jax.jit
def _step(
    filter: Filter, state: Any, measurement: Measurements, time: ArrayLike
) -> tuple[Any, Record]:
    since_start = jnp.asarray(time, measurement.time_step.dtype)
    now = Samples(since_start, filter.prepare(measurement), None)
    return stepped(filter.ready(), state, now)
