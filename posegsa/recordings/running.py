"""Runs filters over recordings, in parts, so that device memory stays bounded."""

from dataclasses import replace
from functools import partial
from typing import Any, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from posegsa.arguments import check_type, fitting, refuse
from posegsa.errors import ArgumentError
from posegsa.filters.base import Filter, check_filter, samples_of, sensors_of
from posegsa.filters.calls import started
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.observer import Observer
from posegsa.filters.rollout import Estimates, simulate, simulate_part
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.recordings.bridging import refuse_gaps
from posegsa.recordings.recording import Recording
from posegsa.recordings.start import Start

PART = 2**12
"""Number of samples on the device at once."""


@overload
def run_filter(filter: Filter, measurements: Measurements, initial: FilterState) -> Estimates: ...


@overload
def run_filter(
    filter: Filter, measurements: Recording, initial: FilterState | None = None
) -> Estimates: ...


def run_filter(
    filter: Filter,
    measurements: Measurements | Recording,
    initial: FilterState | None = None,
) -> Estimates:
    """Run a filter over a sequence of measurements or a recording.

    The time is linear in the number of samples. A recording is processed in parts of PART samples,
    the last one padded: recordings of any length run one program, but a short one takes as long as
    PART samples. Its estimates are NumPy arrays.

    Args:
        filter: e.g. `Observer(FuzzyGain(controller), settings, signal)`, or that of a tuned result,
            `result.filter_for(vectors, landmarks)`.
        measurements: N samples (`posegsa.Measurements`), or a recording.
        initial: the estimate at the first sample (`posegsa.initial_state`); by default that of the
            recording. Estimates of the vectors' biases, if the filter has them, start at 0.

    Returns:
        The estimates; in an attitude-only recording the positions are NaN.

    Raises:
        ArgumentError: an argument has the wrong type, the filter looks at the true pose (signal
            "pose"), or measurements are given without an initial estimate.
        MeasurementError: the measurements contain what `Measurements.from_arrays` refuses.
    """
    check_type("measurements", measurements, Measurements, Recording)
    if not isinstance(measurements, Recording):
        if initial is None:
            refuse("initial: None", "a FilterState, or None with a Recording")
        check_type("initial", initial, FilterState)
        check_filter("filter", filter)
        own = (a.dtype for a in jax.tree.leaves((filter, initial)) if hasattr(a, "dtype"))
        dtype = np.result_type(np.float32, *(kind for kind in own if kind.kind == "f"))
        measurements = measurements.at_least(dtype)
        dtype = jax.dtypes.canonicalize_dtype(measurements.time_step.dtype)
        widened = jax.tree.map(lambda a: jnp.asarray(a, dtype), initial)
        with fitting("run_filter"):
            measurements = measurements.checked()
            started(filter, widened, sensors_of(measurements))
            return simulate(filter, samples_of(filter, measurements), widened)
    check_filter("filter", filter)
    if isinstance(filter, Observer) and filter.signal.signal == "pose":
        raise ArgumentError('signal "pose" looks at the true pose; allowed: "measured"')
    recording = as_seen(filter, measurements)
    state = state_of(recording.initial()) if initial is None else initial
    check_type("initial", state, FilterState)
    with fitting("run_filter"):
        return _run_in_parts(filter, recording, state)


def as_seen(filter: Filter, recording: Recording) -> Recording:
    """A recording as a filter reads it: only for an observer do weights follow the sensors' rates.

    The observer's gains do not follow from the data, so that a slow sensor needs a larger weight to
    correct as much per second. A Kalman filter takes each weight above 0 as 1, and any other filter
    the weights as they were given: in a stream and in C it has the same.
    """
    if isinstance(filter, Observer | KalmanFilter):
        refuse_gaps(recording.name, recording.time)
    if isinstance(filter, Observer):
        return recording
    m = recording.measurements._asdict()
    for kind in ("vector", "landmark"):
        weights = np.asarray(m[f"{kind}_weights"])
        m[f"{kind}_weights"] = (
            (weights > 0).astype(float)
            if isinstance(filter, KalmanFilter)
            else weights / getattr(recording, f"{kind}_interval")
        )
    return replace(recording, measurements=Measurements(**m))


def state_of(start: Start) -> FilterState:
    """A start as an estimate, in JAX's current precision."""
    return initial_state(*(jnp.asarray(a) for a in start))


def _run_in_parts(filter: Filter, recording: Recording, initial: FilterState) -> Estimates:
    count, measured = recording.samples, recording.measurements
    state = started(filter, initial, sensors_of(measured))
    whole: Any = None
    for first in range(0, count, PART):
        # All parts of all recordings have one length, so that one program serves them: the last
        # part is padded with its last sample, and the results of the padding are cut off.
        part = jax.tree.map(partial(_padded, first), (measured, recording.time))
        state, found = _run_part(filter, *part, state)
        found = jax.device_get(found)
        if whole is None:
            whole = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), found)
        for to, of in zip(jax.tree.leaves(whole), jax.tree.leaves(found), strict=True):
            to[first : first + PART] = of[: count - first]
    if recording.attitude_only:
        return whole._replace(position=np.full_like(whole.position, np.nan))
    return whole


@jax.jit
def _run_part(
    filter: Filter, measurements: Measurements, time: ArrayLike, state: Any
) -> tuple[Any, Estimates]:
    """The state after a part of a recording, and the estimates over it."""
    samples = samples_of(filter, measurements)
    return simulate_part(filter, samples._replace(time=jnp.asarray(time)), state)


def _padded(first: int, values: ArrayLike) -> np.ndarray:
    """Values (PART, ...) of an array (K, ...) from `first` on, the last of them repeated."""
    part = np.asarray(values)[first : first + PART]
    return np.concatenate([part, np.repeat(part[-1:], PART - len(part), axis=0)])
