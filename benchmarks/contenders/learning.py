"""The limit for configs/observer.toml: `learning_filter.c`, with posegsa's own arrays."""

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from contenders.c import FLOATS, in_body
from contenders.scene import RULES
from posegsa.config import ObserverConfig
from posegsa.filters.observer import FilterSettings, Observer
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.signal import SignalSettings
from posegsa.model.vectors import VectorSamples
from posegsa.search.problem import TuningProblem


class _Settings(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_float)
        for name in (
            "gain_limit",
            "rate_scale",
            "cost_position",
            "initial_gain",
            "leak",
            "per_bound",
            "per_turning",
        )
    )


class Packed(NamedTuple):
    """What the C code reads."""

    samples: np.ndarray
    """(S, N, numbers of a sample), its `Sample`."""
    start: np.ndarray
    """(S, 13) quaternion, R^T P, biases."""
    inputs: np.ndarray
    """(A, 5, 3) input terms."""
    outputs: np.ndarray
    """(A, 5, 3) output terms."""
    numbers: np.ndarray
    """(A, 8) numbers of each agent."""
    settings: _Settings


def packed(task: TuningProblem, vectors: jax.Array) -> Packed:
    """A task's training scenarios and the candidates of search vectors (A, d).

    Raises:
        ValueError: the experiment is not one that the C code computes.
    """
    e, training = task.experiment, task.training
    section = e.filter
    if not isinstance(section, ObserverConfig):
        raise ValueError("the filter is not the observer")
    if (section.law, section.gamma_law, section.substeps) != ("gradient", "quadratic", 2):
        raise ValueError("law, gamma's law or sub-steps are not those of configs/observer.toml")
    if (e.gain.signal, e.fuzzy.centroid, e.fuzzy.no_rule) != ("measured", "exact", "hold"):
        raise ValueError("signal, centroid or no_rule are not those of configs/observer.toml")
    controller, settings, signal = _candidates(task, vectors)
    learning, sensors = settings.vector_bias, training.samples.sample.vectors
    known = task.space.schedules.rules == RULES and training.end is None
    plain = settings.per_angular_bias_bound is None and settings.per_linear_bias_bound is None
    if learning is None or not isinstance(sensors, VectorSamples) or not (known and plain):
        raise ValueError("rules, bounds or vector bias law are not those of configs/observer.toml")
    if learning.law != "linear" or not section.normalise_vectors or len(sensors.each) != 2:
        raise ValueError("the C code needs two vectors, normalised, whose bias gain follows K")
    limits = (
        settings.gain_limit,
        signal.rate_scale,
        training.weights.position,
        controller.initial_gain(),
        learning.leak,
        learning.per_bound,
        learning.per_turning,
    )
    weights = settings.landmark_weights or (jnp.ones(len(vectors)),)
    length = jnp.ones(()) if settings.length is None else settings.length
    unit = jnp.broadcast_to(length * length, len(vectors))
    numbers = np.stack(
        [
            0.5 * weights[0],
            unit,
            settings.gamma_angular,
            settings.gamma_linear,
            learning.gain,
            signal.position_weight,
            signal.smoothing,
            1 / signal.error_scale,
        ],
        axis=-1,
    )
    initial = training.initial
    q, P = _joined(initial.attitude), _joined(initial.place)
    biases = _joined(initial.bias_angular + initial.bias_linear)
    start = np.concatenate([q, in_body(q, P), biases], axis=-1)
    return Packed(
        samples=_samples(task, settings, sensors),
        start=np.ascontiguousarray(start, np.float32),
        inputs=np.ascontiguousarray(controller.input_terms, np.float32),
        outputs=np.ascontiguousarray(controller.output_terms, np.float32),
        numbers=np.ascontiguousarray(numbers, np.float32),
        settings=_Settings(*map(_alike, limits)),
    )


def _candidates(
    task: TuningProblem, vectors: jax.Array
) -> tuple[FuzzyController, FilterSettings, SignalSettings]:
    """Controllers and settings of the agents, leaves (A, ...)."""

    def one(vector: jax.Array) -> Any:
        controller = task.space.schedules.controller(vector[: task.space.schedules.lower.shape[0]])
        shared = cast(Observer, task.training.filter)
        observer = task.space.candidate(vector).applied(shared)
        return controller, observer.settings, observer.signal

    return jax.jit(jax.vmap(one))(vectors)


def _samples(task: TuningProblem, settings: FilterSettings, sensors: VectorSamples) -> np.ndarray:
    """The samples as the C code reads them, (S, N, numbers)."""
    training = task.training
    sample, truth = training.samples.sample, training.samples.truth
    (landmark,), learning = sample.landmarks, settings.vector_bias
    factors = [landmark.factor, *(vector.factor for vector in sensors.each)]
    if truth is None or learning is None or not all(np.all(np.equal(f, 1)) for f in factors):
        raise ValueError("the C code needs the truth, and all vectors and the landmark throughout")
    given = settings.vectors.weights or (jnp.ones(1), jnp.ones(1))
    s = [_alike(weight) for weight in (*given, settings.vectors.cross_weight)]
    references = [*(vector.reference for vector in sensors.each), sensors.cross_reference]
    weighted = [weight * _joined(v) for weight, v in zip(s, references, strict=True)]
    dt = np.asarray(sample.time_step, np.float64)
    turn, y, p = (
        _joined(sample.angular_velocity),
        _joined(landmark.body),
        _joined(landmark.inertial),
    )
    counted = np.asarray(training.weights.transient, np.float64) + np.asarray(
        training.weights.steady, np.float64
    )
    total = sum(s)
    columns = [
        *(_joined(vector.measured) for vector in sensors.each),
        *(_joined(vector.known) for vector in sensors.each),
        *weighted,
        np.full_like(dt, 0.75),
        np.full_like(dt, 0.75 / total),
        np.full_like(dt, 0.5 * total),
        y,
        p,
        np.linalg.norm(p, axis=-1),
        np.sum(y * y, axis=-1),
        dt[..., None] * turn,
        dt[..., None] * _joined(sample.velocity),
        _low_passed(turn, dt / (_alike(learning.excitation_time) + dt)),
        _joined(truth.attitude),
        _joined(truth.origin),
        np.broadcast_to(counted, dt.shape),
        dt,
        np.concatenate([dt[:, :1], dt[:, :-1]], axis=1),
    ]
    columns = [a[..., None] if a.ndim == 2 else a for a in columns]
    return np.ascontiguousarray(np.concatenate(columns, axis=-1), np.float32)


def _low_passed(values: np.ndarray, new: np.ndarray) -> np.ndarray:
    """First-order low-pass filter from 0 of values (S, N, 3) by the weights (S, N) of the new."""
    passed, state = np.empty_like(values), np.zeros_like(values[:, 0])
    for k in range(values.shape[1]):
        state = state + new[:, k, None] * (values[:, k] - state)
        passed[:, k] = state
    return passed


def _joined(components: tuple[jax.Array, ...]) -> np.ndarray:
    return np.stack([np.asarray(a, np.float64) for a in components], axis=-1)


def _alike(values: Any) -> float:
    """The common number of all agents."""
    found = np.unique(np.asarray(values, np.float64))
    if found.size != 1:
        raise ValueError("a number that is common to all agents in the C code differs between them")
    return float(found[0])


def prepare(given: Packed, library: Path, threads: int = 1) -> Callable[[], np.ndarray]:
    """A function of no arguments that computes the costs (S, A), float32.

    Raises:
        RuntimeError: the library was built from another source.
    """
    loaded = ctypes.CDLL(str(library))
    made = loaded.learning_filter_sample_numbers(), loaded.learning_filter_agent_numbers()
    if made != (given.samples.shape[-1], given.numbers.shape[-1]):
        raise RuntimeError(f"{library}: its samples and agents have {made} numbers")
    run = loaded.learning_filter_costs
    run.argtypes = [ctypes.c_int] * 3 + [FLOATS] * 5
    run.argtypes = [*run.argtypes, ctypes.POINTER(_Settings), ctypes.c_int, FLOATS]
    out = np.empty((len(given.samples), len(given.inputs)), np.float32)
    sizes = *given.samples.shape[:2], len(given.inputs)

    def costs() -> np.ndarray:
        if run(*sizes, *given[:5], ctypes.byref(given.settings), threads, out):
            raise RuntimeError("learning_filter.c: a group of blocks is larger than its array")
        return out

    return costs
