"""A filter compiled to run sample by sample, on a few flat arrays.

`rollout.step` takes some fifty small arrays, and passing them costs more than the step. Here the
state and a sample travel as one array, all numbers of the filter as a second, and the result as a
third. The program is compiled once for all filters of one structure: their numbers are its
arguments.
"""

import pickle
import zlib
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.arguments import refuse
from posegsa.filters.base import Filter, Samples, Sensors
from posegsa.filters.calls import estimated, started, stepped
from posegsa.filters.covariance import matrix
from posegsa.filters.uncertainty import pose_covariance
from posegsa.model.elementwise import maximum
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements


class OnlineParameters(NamedTuple):
    """Everything that is constant from sample to sample."""

    filter: Filter
    vector_references: np.ndarray
    """(n, 3) v_i^I."""
    landmark_references: np.ndarray
    """(m, 3) p_i [m]."""


class OnlineRecord(NamedTuple):
    """The filter after a sample, and its gain there."""

    state: Any
    """The state of the filter."""
    estimate: FilterState
    """The estimate at the next sample."""
    rotation: Any
    """(3, 3) R_est of the estimate, as a matrix."""
    gain: Any
    """The gain K that the schedule requested [1/s]; None for a filter without a gain."""
    gain_used: Any
    """K after the gain limit [1/s]; None for a filter without a gain."""
    covariance: Any
    """(6, 6) of the pose at the next sample; None for a filter without one."""
    nis: Any
    """Normalised innovation squared over its degrees of freedom, 0 where nothing was measured; None
    for a filter without a covariance."""


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
        """The record from a flat array of NumPy or JAX; it holds views of a NumPy array."""
        leaves, start = [], 0
        for shape, size in zip(self._shapes, self._sizes, strict=True):
            leaves.append(flat[start : start + size].reshape(shape))
            start += size
        return jax.tree.unflatten(self._structure, leaves)


class OnlineLoop:
    """One filter, compiled to run sample by sample. Compilation takes a second or two.

    Args:
        parameters: All numbers, at the dtype of the filter.
        example: Any estimate; its dtype is the dtype of the filter.
    """

    def __init__(self, parameters: OnlineParameters, example: FilterState) -> None:
        self._made_of = parameters, example
        self._filter = parameters.filter
        self._sensors = Sensors(
            len(parameters.vector_references), len(parameters.landmark_references)
        )
        self.dtype = np.dtype(example.place[0].dtype)
        layout = Layout(parameters)
        sample = _sample_layout(*self._sensors)
        before = started(self._filter, example, self._sensors)
        for leaf in jax.tree.leaves(before):
            if not jnp.issubdtype(jnp.result_type(leaf), jnp.floating):
                given = jnp.result_type(leaf)
                refuse(f"filter: its state holds {given}", "floating numbers, to be streamed")
        state = Layout(before)
        self._program, after = _compiled(layout, state, sample, self.dtype.name)
        self.record: Layout = after
        self.parameters = layout.pack(parameters, self.dtype)
        """All numbers of the parameters, packed."""
        self.structure = zlib.crc32(str(jax.tree.structure(parameters)).encode())
        """Checksum of their structure: laws, switches, rules, sub-steps."""
        self._on_device = jnp.asarray(self.parameters)
        self._before = state.size
        self.sample_size = sample.size
        """Number of values in a packed sample."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments, because a compiled program cannot be pickled."""
        # They are pickled to bytes here: outside of enable_x64 JAX would turn float64 to float32.
        with jax.enable_x64(self.dtype == np.float64):
            return _made_again, (self.dtype.name, pickle.dumps(self._made_of))

    def start(self, initial: FilterState) -> np.ndarray:
        """The packed record before the first sample, at an initial estimate; its gains are NaN."""
        with jax.enable_x64(self.dtype == np.float64):
            state = started(self._filter, initial, self._sensors)
            ready = self._filter.ready()
            estimate, covariance = estimated(ready, state), pose_covariance(ready, state)
            unknown = self.record.unpack(np.full(self.record.size, np.nan, self.dtype))
            first = unknown._replace(
                state=state,
                estimate=estimate,
                rotation=estimate.rotation,
                covariance=None if covariance is None else matrix(covariance, 6),
            )
            return self.record.pack(first, self.dtype)

    def __call__(self, record: np.ndarray, sample: np.ndarray) -> np.ndarray:
        """The packed record after a packed sample (`_sample_layout`), from the record before it."""
        given = np.concatenate([record[: self._before], sample])
        with jax.enable_x64(self.dtype == np.float64):
            return np.asarray(self._program(given, self._on_device))


def _made_again(dtype: str, made_of: bytes) -> OnlineLoop:
    """The loop, rebuilt from its pickled arguments."""
    with jax.enable_x64(dtype == "float64"):
        return OnlineLoop(*pickle.loads(made_of))


def _sample_layout(vectors: int, landmarks: int) -> Layout:
    """The time since the first sample [s], then one sample of `Measurements` without references.

    A missing vector or landmark may hold any number but NaN.
    """
    each = (vectors, 3), None, (vectors,), (landmarks, 3), None, (landmarks,)
    arrays: Any = [None if shape is None else np.zeros(shape) for shape in ((), (3,), (3,), *each)]
    return Layout((np.zeros(()), Measurements(*arrays)))


@lru_cache(maxsize=32)
def _compiled(
    parameters: Layout, state: Layout, sample: Layout, dtype: str
) -> tuple[jax.stages.Compiled, Layout]:
    """The program for all filters whose arrays have these layouts, and the layout of its result."""

    def step(given: Array, numbers: Array) -> OnlineRecord:
        p = parameters.unpack(numbers)
        time, measured = sample.unpack(given[state.size :])
        measurement = measured._replace(
            vector_references=p.vector_references, landmark_references=p.landmark_references
        )
        ready = p.filter.ready()
        samples = Samples(time, p.filter.prepare(measurement), None)
        after, record = stepped(ready, state.unpack(given[: state.size]), samples)
        estimate = estimated(ready, after)
        covariance, nis = pose_covariance(ready, after), record.nis
        if nis is not None and record.scalars is not None:
            nis = nis / maximum(record.scalars, 1.0)
        return OnlineRecord(
            state=after,
            estimate=estimate,
            rotation=estimate.rotation,
            gain=record.gain,
            gain_used=record.gain_used,
            covariance=None if covariance is None else matrix(covariance, 6),
            nis=nis,
        )

    def program(given: Array, numbers: Array) -> Array:
        leaves = jax.tree.leaves(step(given, numbers))
        return jnp.concatenate([jnp.ravel(leaf) for leaf in leaves])

    with jax.enable_x64(dtype == "float64"):
        shapes = [
            jax.ShapeDtypeStruct((size,), dtype)
            for size in (state.size + sample.size, parameters.size)
        ]
        made = jax.eval_shape(step, *shapes)
        after = Layout(made)
        return jax.jit(program).lower(*shapes).compile(), after
