"""The closed loop compiled for streams: one sample per call, on a few flat arrays.

`rollout.scheduled_step` takes some fifty small arrays, and passing them takes longer than the step.
Here loop and sample are packed into one array, all numbers of filter, signal and schedule into a
second, and the result into a third. The numbers are arguments, so the program is compiled once for
all filters with the same structure.
"""

import pickle
import zlib
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.model.filter import FilterSettings, FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import ClosedLoop, Samples, begin, closed_loop_step
from posegsa.model.sample import prepare
from posegsa.model.schedules import GainSchedule
from posegsa.model.signal import SignalSettings


class OnlineParameters(NamedTuple):
    """Everything that is constant from sample to sample."""

    schedule: GainSchedule
    settings: FilterSettings
    signal: SignalSettings
    vector_references: np.ndarray
    """(n, 3) v_i^I."""
    landmark_references: np.ndarray
    """(m, 3) p_i [m]."""


class OnlineSample(NamedTuple):
    """One sample, as in `Measurements`, and its time."""

    time: np.ndarray
    """Since the first sample [s]."""
    time_step: np.ndarray
    """To the next sample [s]."""
    angular_velocity: np.ndarray
    """(3,) [rad/s], body frame."""
    velocity: np.ndarray
    """(3,) [m/s], body frame."""
    vectors: np.ndarray
    """(n, 3), body frame; any number except NaN where the weight is 0."""
    vector_weights: np.ndarray
    """(n,)"""
    landmarks: np.ndarray
    """(m, 3) [m], body frame; any number except NaN where the weight is 0."""
    landmark_weights: np.ndarray
    """(m,)"""


class OnlineRecord(NamedTuple):
    """The closed loop after a sample, with results of the step."""

    loop: ClosedLoop
    """With the estimate at the next sample."""
    rotation: Any
    """(3, 3) R_est of that estimate."""
    gain_used: Any
    """K after the gain limit [1/s]; before it, it is `loop.memory.gain`."""


class Layout:
    """The positions of a record's arrays in one flat array.

    Args:
        record: An example: any pytree of arrays of one dtype.
    """

    def __init__(self, record: Any) -> None:
        leaves, self._structure = jax.tree.flatten(record)
        self._shapes = tuple(np.shape(leaf) for leaf in leaves)
        self._sizes = tuple(int(np.prod(shape)) for shape in self._shapes)
        self.size = sum(self._sizes)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple:
        return self._structure, self._shapes

    def pack(self, record: Any, dtype: np.dtype) -> np.ndarray:
        """The record as a flat NumPy array."""
        flat = [np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(record)]
        return np.concatenate([np.zeros(0), *flat]).astype(dtype)

    def unpack(self, flat: Any) -> Any:
        """The record from a flat array of NumPy or JAX; of a NumPy array it holds views."""
        leaves, start = [], 0
        for shape, size in zip(self._shapes, self._sizes, strict=True):
            leaves.append(flat[start : start + size].reshape(shape))
            start += size
        return jax.tree.unflatten(self._structure, leaves)


class OnlineLoop:
    """The closed loop of one filter, compiled (which takes a second or two).

    Args:
        parameters: All numbers in the dtype of the filter.
        example: Any state of the filter, in its dtype, with biases of all vectors if the filter
            estimates them.
    """

    def __init__(self, parameters: OnlineParameters, example: FilterState) -> None:
        loop = begin(parameters.schedule, example)
        self._made_of = parameters, example
        self._schedule = parameters.schedule
        self.dtype = np.dtype(example.place[0].dtype)
        self.record = Layout(_first_record(loop))
        layout, before = Layout(parameters), Layout(loop)
        sample = _sample_layout(
            len(parameters.vector_references), len(parameters.landmark_references)
        )
        self.parameters = layout.pack(parameters, self.dtype)
        """All numbers of the parameters, packed."""
        self.structure = zlib.crc32(str(jax.tree.structure(parameters)).encode())
        """Checksum of their structure: laws, switches, rules, sub-steps."""
        self._on_device = jnp.asarray(self.parameters)
        self._before = before.size
        self.sample_size = sample.size
        """Numbers in a packed sample."""
        self._program = _compiled(layout, before, sample, self.dtype.name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments, because a compiled program cannot be pickled."""
        # As bytes pickled here: outside of enable_x64 JAX would make float32 of float64.
        with jax.enable_x64(self.dtype == np.float64):
            return _made_again, (self.dtype.name, pickle.dumps(self._made_of))

    def start(self, initial: FilterState) -> np.ndarray:
        """The packed record before the first sample, at an estimate."""
        with jax.enable_x64(self.dtype == np.float64):
            return self.record.pack(_first_record(begin(self._schedule, initial)), self.dtype)

    def __call__(self, record: np.ndarray, sample: np.ndarray) -> np.ndarray:
        """The packed record after one packed `OnlineSample`, from the one before it."""
        given = np.concatenate([record[: self._before], sample])
        with jax.enable_x64(self.dtype == np.float64):
            return np.asarray(self._program(given, self._on_device))


def _made_again(dtype: str, made_of: bytes) -> OnlineLoop:
    """The loop from its pickled arguments."""
    with jax.enable_x64(dtype == "float64"):
        return OnlineLoop(*pickle.loads(made_of))


def _first_record(loop: ClosedLoop) -> OnlineRecord:
    """The record before the first sample; as gain it has the initial one."""
    rotation, gain = np.asarray(loop.state.rotation), np.asarray(loop.memory.gain)
    return OnlineRecord(loop, rotation, gain)


def _sample_layout(vectors: int, landmarks: int) -> Layout:
    number, vector = np.zeros(()), np.zeros(3)
    return Layout(
        OnlineSample(
            time=number,
            time_step=number,
            angular_velocity=vector,
            velocity=vector,
            vectors=np.zeros((vectors, 3)),
            vector_weights=np.zeros(vectors),
            landmarks=np.zeros((landmarks, 3)),
            landmark_weights=np.zeros(landmarks),
        )
    )


@lru_cache(maxsize=32)
def _compiled(parameters: Layout, loop: Layout, sample: Layout, dtype: str) -> jax.stages.Compiled:
    """The program for all filters whose arrays have these layouts."""

    def program(given: Array, numbers: Array) -> Array:
        p = parameters.unpack(numbers)
        before = loop.unpack(given[: loop.size])
        now = sample.unpack(given[loop.size :])
        measurement = Measurements(
            time_step=now.time_step,
            angular_velocity=now.angular_velocity,
            velocity=now.velocity,
            vectors=now.vectors,
            vector_references=p.vector_references,
            vector_weights=now.vector_weights,
            landmarks=now.landmarks,
            landmark_references=p.landmark_references,
            landmark_weights=now.landmark_weights,
        )
        samples = Samples(now.time, prepare(measurement, p.settings.vectors), None)
        after, step = closed_loop_step(before, samples, p.schedule.prepare(), p.settings, p.signal)
        record = OnlineRecord(after, after.state.rotation, step.gain_used)
        return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(record)])

    with jax.enable_x64(dtype == "float64"):
        shapes = (
            jax.ShapeDtypeStruct((size,), dtype)
            for size in (loop.size + sample.size, parameters.size)
        )
        return jax.jit(program).lower(*shapes).compile()
