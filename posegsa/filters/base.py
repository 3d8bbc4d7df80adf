"""The interface of all filters: a pytree with a few pure functions.

Numbers are traced, so that a search can change them without recompilation; structure (laws,
switches, which quantities are states) is static. The same step serves a population of agents, a
stream and, traced once, the C header. So it is written by components: arrays without axes of their
own, in tuples. XLA fuses them into one vectorised kernel; small matrices cost ten times as much.

    prepared once, for all agents and samples:   sample = filter.prepare(measurements)
    prepared once, before the loop:              ready = filter.ready()
    the loop:                                    state = filter.start(initial, sensors)
                                                 state, record = ready.step(state, now)
                                                 ready.estimate(state)
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.arguments import check_type, refuse
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.sample import Sample
from posegsa.model.se3 import quaternion, unstack
from posegsa.model.signal import TruePose
from posegsa.model.vectors import VectorSamples


class Samples(NamedTuple):
    """The input of a filter, time-major and by components; inside the loop, one sample of it."""

    time: Array
    """(N,) time since the first sample [s]."""
    sample: Sample
    """Components (N,)."""
    truth: TruePose | None
    """Components (N,); None if only the measurements are known. Only filters for simulations may
    read it."""
    known: Any = None
    """What only the clairvoyant knows (`filters.clairvoyant.KnownMotion`); None for all others."""


class Sensors(NamedTuple):
    """How many sensors of each kind a filter reads."""

    vectors: int
    """Number of vectors in a sample; 0 if it holds only their sums (Wahba's)."""
    landmarks: int
    """Number of landmarks in a sample."""


def sensors_of(measurements: Measurements) -> Sensors:
    """The sensors of measurements, with or without a time axis."""
    each = (measurements.vector_weights, measurements.landmark_weights)
    return Sensors(*(np.shape(weights)[-1] for weights in each))


class Record(NamedTuple):
    """Gains and errors at a sample; None for a filter without them."""

    gain: Array | None = None
    """The gain K that the schedule requested [1/s]."""
    gain_used: Array | None = None
    """K after the gain limit, mean over the sub-steps [1/s]."""
    error: Array | None = None
    """The schedule's input scaled error, in [0, 1]."""
    rate: Array | None = None
    """The schedule's input scaled rate, in [0, 1]."""
    nis: Array | None = None
    """Normalised innovation squared of the sample's measurements; chi-squared with `scalars`
    degrees of freedom if the covariance is right."""
    scalars: Array | None = None
    """How many scalars were measured at this sample, three for each vector and landmark."""


class ReadyFilter(Protocol):
    """A filter with everything precomputed that depends only on its numbers."""

    def step(self, state: Any, now: Samples) -> tuple[Any, Record]:
        """The state at the next sample, from the state at this one (pure, by components)."""
        ...

    def estimate(self, state: Any) -> FilterState:
        """The pose and biases in a state.

        A filter that knows the covariance of its pose has a function `pose_covariance(state)` too,
        which returns a `filters.uncertainty.PoseCovariance`.
        """
        ...


@runtime_checkable
class Filter(Protocol):
    """A filter: a registered pytree (`jax.tree_util.register_dataclass`) with these functions.

    Its class may say `elementwise: ClassVar[bool] = True`: all its functions but `prepare` then
    work on numbers and components of any common shape, not only on scalars, and many simulations
    need no `vmap`, which takes longer to trace than the step itself.
    """

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The same filter with some of its numbers replaced, by name (pure).

        The name is the key in a configuration without `filter.`: "gamma", or "gain.smoothing".

        Raises:
            ArgumentError: The filter has no number with this key.
        """
        ...

    def prepare(self, measurements: Measurements) -> Sample:
        """The input of `step` from measurements, with or without a time axis (pure, jittable).

        Raises:
            ArgumentError: The filter's settings are for another number of sensors.
        """
        ...

    def start(self, initial: FilterState, sensors: Sensors) -> Any:
        """The state before the first sample.

        Args:
            initial: the estimate there. If it has no vector biases and the filter estimates them,
                they start at 0.
            sensors: how many vectors and landmarks are measured.

        Raises:
            ArgumentError: `initial` has biases of another number of vectors.
        """
        ...

    def ready(self) -> ReadyFilter:
        """The filter for the loop."""
        ...


def elementwise(filter: Filter) -> bool:
    """Whether a filter's own class says that it works on components of any common shape.

    A subclass says so itself: its functions may need scalars.
    """
    stated = "elementwise" in vars(type(filter))
    return stated and getattr(filter, "elementwise", False) is True  # not a traced field


def with_vector_biases(initial: FilterState, vectors: int) -> FilterState:
    """An initial estimate with biases of this number of vectors, 0 unless it has them already.

    Raises:
        ArgumentError: The estimate has biases of another number of vectors.
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
    """Measurements, and the truth if it is known, in the form of the loop (pure, jittable).

    Args:
        filter: its `prepare` is applied to the measurements.
        measurements: N samples.
        rotation: (N, 3, 3) true R, body to inertial.
        position: (N, 3) true P [m], inertial frame.
        time: (N,) [s]; by default the cumulative sum of the time steps, from 0.
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


def sensors_in(samples: Samples) -> Sensors:
    """The sensors whose measurements samples hold."""
    vectors = samples.sample.vectors
    each = len(vectors.each) if isinstance(vectors, VectorSamples) else 0
    return Sensors(each, len(samples.sample.landmarks))


def check_filter(name: str, value: Any, others: str = "") -> None:
    """Raise an ArgumentError unless a value has the functions of a filter.

    `others` says in the message what else is allowed.
    """
    words = (
        "a filter (Observer, KalmanFilter, AttitudeFilter, one of your own: "
        "posegsa.filters.base.Filter)"
    )
    check_type(name, value, Filter, allowed=f"{others}, {words}" if others else words)
    if isinstance(value, type):
        refuse(f"{name}: the class {value.__name__}", words)
    if jax.tree_util.all_leaves([value]):
        registered = "one under @jax.tree_util.register_dataclass"
        refuse(f"{name}: the class {type(value).__name__}, which JAX does not know", registered)
