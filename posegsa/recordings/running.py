"""Runs gain schedules over recordings, in parts, so that device memory stays bounded."""

from dataclasses import replace
from typing import overload

import jax
import jax.numpy as jnp
import numpy as np

from posegsa.arguments import check_type, fitting, refuse
from posegsa.errors import ArgumentError
from posegsa.model import rollout
from posegsa.model.filter import FilterSettings, FilterState, initial_state, ready
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import Estimates, Samples, begin, samples_of, simulate_part
from posegsa.model.schedules import GainSchedule, check_schedule
from posegsa.model.signal import SignalSettings
from posegsa.recordings.recording import Recording
from posegsa.recordings.start import Start
from posegsa.stored_programs import stored

PART = 2**12
"""Number of samples on the device at once."""


@overload
def run_filter(
    schedule: GainSchedule,
    measurements: Measurements,
    initial: FilterState,
    settings: FilterSettings | None = None,
    signal: SignalSettings | None = None,
) -> Estimates: ...


@overload
def run_filter(
    schedule: GainSchedule,
    measurements: Recording,
    initial: FilterState | None = None,
    settings: FilterSettings | None = None,
    signal: SignalSettings | None = None,
) -> Estimates: ...


def run_filter(
    schedule: GainSchedule,
    measurements: Measurements | Recording,
    initial: FilterState | None = None,
    settings: FilterSettings | None = None,
    signal: SignalSettings | None = None,
) -> Estimates:
    """Run a gain schedule over a sequence of measurements or a recording.

    The time is linear in the number of samples. A recording is processed in parts of PART samples,
    and its estimates are NumPy arrays.

    Args:
        schedule: e.g. `ConstantGain`, or `FuzzyGain` of a tuned controller.
        measurements: N samples (`posegsa.Measurements`), or a recording.
        initial: the estimate at the first sample (`posegsa.initial_state`); by default that of the
            recording. Estimates of the vectors' biases, if the filter has them, start at 0.
        settings: of the filter; for a tuned result `filter_settings(result.tuned)`.
        signal: of the error signal; "measured", since the truth is not known.

    Returns:
        The estimates; in an attitude-only recording the positions are NaN.

    Raises:
        ArgumentError: an argument has the wrong type, the signal is "pose", or measurements are
            given without an initial estimate.
        MeasurementError: the measurements contain what `Measurements.from_arrays` refuses.
    """
    check_type("measurements", measurements, Measurements, Recording)
    settings = FilterSettings() if settings is None else settings
    signal = SignalSettings() if signal is None else signal
    if not isinstance(measurements, Recording):
        if initial is None:
            refuse("initial: None", "a FilterState, or None with a Recording")
        check_type("initial", initial, FilterState)
        measurements = measurements.at_least(initial.place[0].dtype)
        return rollout.run_filter(schedule, measurements, initial, settings, signal)
    check_schedule(schedule)
    check_type("settings", settings, FilterSettings)
    check_type("signal", signal, SignalSettings)
    if signal.signal == "pose":
        raise ArgumentError('signal "pose" looks at the true pose; allowed: "measured"')
    recording = measurements
    state = state_of(recording.initial()) if initial is None else initial
    check_type("initial", state, FilterState)
    with fitting("run_filter"):
        state = ready(state, recording.measurements, settings)
        return _run_in_parts(schedule, recording, state, settings, signal)


def state_of(start: Start, learnt_vectors: int = 0) -> FilterState:
    """The filter's state at a start, in JAX's current precision."""
    arrays = (jnp.asarray(a) for a in start)
    return initial_state(*arrays, learnt_vectors=learnt_vectors)


@stored
def _prepared(measurements: Measurements, settings: FilterSettings) -> Samples:
    return samples_of(measurements, settings.vectors)


def _run_in_parts(
    schedule: GainSchedule,
    recording: Recording,
    state: FilterState,
    settings: FilterSettings,
    signal: SignalSettings,
) -> Estimates:
    count, loop, parts = recording.samples, begin(schedule, state), []
    length = min(PART, count)
    for first in range(0, count, length):
        # All parts have the same length, so that one program serves them: the last part is padded
        # with its last sample, and the results of the padding are cut off.
        index = np.minimum(np.arange(first, first + length), count - 1)
        own = _settings_at(settings, index)
        samples = _part(recording, index, own)
        loop, found = simulate_part(schedule, samples, loop, own, signal)
        parts.append(jax.device_get(found))
    joined = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *parts)
    if recording.attitude_only:
        return joined._replace(position=np.full_like(joined.position, np.nan))
    return joined


def _settings_at(settings: FilterSettings, index: np.ndarray) -> FilterSettings:
    """The settings for some samples: of gammas given per sample, those of these samples."""
    gammas = settings.gamma_angular, settings.gamma_linear
    angular, linear = (np.asarray(g)[index] if np.ndim(g) else g for g in gammas)
    return replace(settings, gamma_angular=angular, gamma_linear=linear)


def _part(recording: Recording, index: np.ndarray, settings: FilterSettings) -> Samples:
    arrays = (jnp.asarray(np.asarray(a)[index]) for a in recording.measurements)
    samples = _prepared(Measurements(*arrays), settings)
    return samples._replace(time=jnp.asarray(recording.time[index]))
