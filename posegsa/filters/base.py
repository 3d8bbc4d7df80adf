"""What every filter is: a pytree with a few pure functions.

Numbers are traced, so that a search can change them without compiling anew; structure (laws,
switches, what is a state) is static. The same step serves a population of agents, a stream, and,
traced once, the C header, so it is written on components: arrays without axes of their own, in
tuples. XLA makes one vectorised kernel of that; small matrices cost ten times as much.

    prepared once, for all agents and samples:   sample = filter.prepare(measurements)
    prepared once, before the loop:              ready = filter.ready()
    the loop:                                    state = filter.start(initial, vectors)
                                                 state, record = ready.step(state, now)
                                                 ready.estimate(state)
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import jax.numpy as jnp
from jax import Array

from posegsa.arguments import check_type, refuse
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample
from posegsa.model.se3 import quaternion, unstack
from posegsa.model.signal import TruePose
from posegsa.model.vectors import VectorSamples


class Samples(NamedTuple):
    """What a filter reads, time-major and by components; inside the loop, that of one sample."""

    time: Array
    """(N,) since the first sample [s]."""
    sample: Sample
    """Components (N,)."""
    truth: TruePose | None
    """Components (N,); None where only the measurements are known. No filter that can be used
    outside a simulation looks at it."""


class Record(NamedTuple):
    """What happened at a sample, beside the change of state; None where a filter has none."""

    gain: Array | None = None
    """The gain K that a schedule asked for [1/s]."""
    gain_used: Array | None = None
    """The same after the gain limit, mean over the sub-steps [1/s]."""
    error: Array | None = None
    """The scaled error that the schedule saw, in [0, 1]."""
    rate: Array | None = None
    """The scaled rate that it saw, in [0, 1]."""


class ReadyFilter(Protocol):
    """A filter with everything computed that depends on its numbers alone."""

    def step(self, state: Any, now: Samples) -> tuple[Any, Record]:
        """The state at the next sample, from this one's (pure, by components)."""
        ...

    def estimate(self, state: Any) -> FilterState:
        """The pose and biases that a state holds."""
        ...


@runtime_checkable
class Filter(Protocol):
    """A filter: a registered pytree (`jax.tree_util.register_dataclass`) with these functions."""

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with some of its numbers replaced, by key (pure).

        Raises:
            ArgumentError: It has no number of such a key.
        """
        ...

    def prepare(self, measurements: Measurements) -> Sample:
        """What the step reads of measurements, with and without a time axis (pure, jittable).

        Raises:
            ArgumentError: The filter's settings are for another number of sensors.
        """
        ...

    def start(self, initial: FilterState, vectors: int) -> Any:
        """The state before the first sample.

        Args:
            initial: the estimate there; its vector biases, if it has none and the filter learns
                them, begin at 0.
            vectors: how many vectors are measured.

        Raises:
            ArgumentError: `initial` has biases of another number of vectors.
        """
        ...

    def ready(self) -> ReadyFilter:
        """The filter for the loop."""
        ...


def with_vector_biases(initial: FilterState, vectors: int) -> FilterState:
    """An initial estimate with biases of so many vectors, 0 unless it has them already.

    Raises:
        ArgumentError: It has those of another number of vectors.
    """
    if len(initial.vector_biases) == vectors:
        return initial
    if initial.vector_biases:
        refuse(f"vector_biases: of {len(initial.vector_biases)} vectors", f"{vectors}, or ()")
    zero = jnp.zeros_like(initial.place[0])
    return initial._replace(vector_biases=((zero, zero, zero),) * vectors)


def samples_of(
    filter: Filter,
    measurements: Measurements,
    rotation: Array | None = None,
    position: Array | None = None,
    time: Array | None = None,
) -> Samples:
    """Measurements, and the truth where it is known, in the form of the loop (pure, jittable).

    Args:
        filter: whose `prepare` says what it reads.
        measurements: N samples.
        rotation: (N, 3, 3) true R, body to inertial.
        position: (N, 3) true P [m], inertial frame.
        time: (N,) [s]; by default the time steps' sum, from 0.
    """
    if time is None:
        step = measurements.time_step
        time = jnp.cumsum(step) - step
    truth = None
    if rotation is not None and position is not None:
        w, x, y, z = unstack(quaternion(rotation))
        ox, oy, oz = unstack(jnp.einsum("nji,nj->ni", rotation, position, precision="highest"))
        truth = TruePose(attitude=(w, x, y, z), origin=(ox, oy, oz))
    return Samples(time, filter.prepare(measurements), truth)


def vectors_in(samples: Samples) -> int:
    """How many vectors samples hold one by one; 0 where only Wahba's sums of them are there."""
    vectors = samples.sample.vectors
    return len(vectors.each) if isinstance(vectors, VectorSamples) else 0


def check_filter(name: str, value: Any, others: str = "") -> None:
    """Raise an ArgumentError unless a value has the functions of a filter; `others` is allowed."""
    words = "a filter (Observer, KalmanFilter, one of your own: posegsa.filters.base.Filter)"
    check_type(name, value, Filter, allowed=f"{others}, {words}" if others else words)
    if isinstance(value, type):
        refuse(f"{name}: the class {value.__name__}", words)
