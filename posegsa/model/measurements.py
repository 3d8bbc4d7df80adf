"""Measurements of the sensors, as arrays.

A sequence of N samples is one `Measurements`, time-major. Time steps and weights are per sample:
under uneven sampling the time step varies, and a missing vector or landmark has weight 0 (its value
is then arbitrary and may be NaN). Vectors are stored as measured; the filter decides whether they
are normalised and whether their cross product is added (`vectors`).
"""

import warnings
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from posegsa.arguments import check_dtype
from posegsa.errors import MeasurementError, PosegsaWarning
from posegsa.model import limits


class Measurements(NamedTuple):
    """N samples of all sensors, with n vectors and m landmarks.

    The first axis is time; without it the same type holds one sample (`measurements.at(k)`).
    """

    time_step: Array
    """(N,) time to the next sample [s]."""
    angular_velocity: Array
    """(N, 3) Omega_m, body frame [rad/s]."""
    velocity: Array
    """(N, 3) V_m, body frame [m/s]."""
    vectors: Array
    """(N, n, 3) v_i^B, body frame, in the unit of their sensor."""
    vector_references: Array
    """(N, n, 3) v_i^I, the same in the inertial frame."""
    vector_weights: Array
    """(N, n) factor on the filter's weight s_i^R, 0 where the vector is missing."""
    landmarks: Array
    """(N, m, 3) y_i, landmark positions in the body frame [m]."""
    landmark_references: Array
    """(N, m, 3) p_i, landmark positions in the inertial frame [m]."""
    landmark_weights: Array
    """(N, m) factor on the filter's weight s_i^L, 0 where the landmark is missing."""

    def at(self, k: int | slice) -> "Measurements":
        """Sample k, without the time axis, or a range of samples with it.

        Outside of jit the arrays of the result are NumPy views: indexing JAX arrays takes some
        forty times as long.

        Raises:
            IndexError: There is no sample k (outside of jit).
        """
        if any(isinstance(a, Tracer) for a in (*self, k)):
            return jax.tree.map(lambda a: a[k], self)
        views: Any = [np.asarray(a)[k, ...] for a in self]
        return Measurements(*views)

    @classmethod
    def from_arrays(
        cls,
        *,
        time_step: ArrayLike,
        angular_velocity: ArrayLike,
        velocity: ArrayLike,
        vectors: ArrayLike | None = None,
        vector_references: ArrayLike | None = None,
        vector_weights: ArrayLike | None = None,
        landmarks: ArrayLike | None = None,
        landmark_references: ArrayLike | None = None,
        landmark_weights: ArrayLike | None = None,
        dtype: np.dtype | type = np.float32,
    ) -> "Measurements":
        """Checked measurements from a user's arrays (on the host, not inside jit).

        Args:
            time_step: scalar or (N,), time to the next sample [s], positive.
            angular_velocity: (N, 3) gyroscope, body frame [rad/s].
            velocity: (N, 3) linear velocity, body frame [m/s].
            vectors: (N, n, 3) body-frame vectors; NaN marks a missing one.
            vector_references: (n, 3) or (N, n, 3) the same vectors in the inertial frame.
            vector_weights: scalar, (n,) or (N, n), factors on the filter's weights s_i^R, not
                negative; default 1.
            landmarks: (N, m, 3) landmark positions in the body frame [m]; NaN marks a missing one.
            landmark_references: (m, 3) or (N, m, 3), their inertial positions [m].
            landmark_weights: scalar, (m,) or (N, m), factors on the filter's weights s_i^L, not
                negative. The default, 1, suits landmarks within a few metres; for those farther
                away give about 1 / (distance in m)^2.
            dtype: floating type of the result.

        Returns:
            Measurements with all arrays in full shape; where a value was NaN the weight is 0.

        Raises:
            MeasurementError: an array has the wrong shape, holds NaN or infinity where it may not,
                a time step is not positive, a weight is negative, or a number is beyond those of
                `posegsa.model.limits`. The message names the argument.
        """
        check_dtype("dtype", dtype)
        values = checked_arrays(
            time_step=time_step,
            angular_velocity=angular_velocity,
            velocity=velocity,
            vectors=vectors,
            vector_references=vector_references,
            vector_weights=vector_weights,
            landmarks=landmarks,
            landmark_references=landmark_references,
            landmark_weights=landmark_weights,
        )
        return cls(**{name: jnp.asarray(a, dtype) for name, a in values.items()})

    def checked(self) -> "Measurements":
        """The same measurements, checked as by `from_arrays`; traced ones are not checked.

        Raises:
            MeasurementError: an array has the wrong shape or forbidden values; names the array.
        """
        if any(isinstance(a, Tracer) for a in self):
            return self
        dtype = jax.dtypes.canonicalize_dtype(np.result_type(np.float32, *map(np.asarray, self)))
        return Measurements.from_arrays(**self._asdict(), dtype=dtype)

    def at_least(self, dtype: np.dtype) -> "Measurements":
        """The same at the filter's precision; warns if fields of lower precision were converted.

        Args:
            dtype: floating type of the filter.
        """
        narrow = {
            name: a
            for name, a in self._asdict().items()
            if jnp.issubdtype(kind := getattr(a, "dtype", bool), jnp.floating)
            and jnp.finfo(kind).bits < jnp.finfo(dtype).bits
        }
        if narrow:
            name, first = next(iter(narrow.items()))
            others = f" (and {len(narrow) - 1} more fields)" if len(narrow) > 1 else ""
            warnings.warn(
                f"measurements.{name}{others}: {first.dtype}, but the filter computes in {dtype}: "
                f"the sensors' values were rounded; for {dtype} pass dtype=np.{dtype} to "
                "Measurements.from_arrays, under jax.enable_x64(True)",
                PosegsaWarning,
                stacklevel=3,
            )
        return self._replace(**{name: a.astype(dtype) for name, a in narrow.items()})


def checked_arrays(
    *,
    time_step: ArrayLike,
    angular_velocity: ArrayLike,
    velocity: ArrayLike,
    vectors: ArrayLike | None = None,
    vector_references: ArrayLike | None = None,
    vector_weights: ArrayLike | None = None,
    landmarks: ArrayLike | None = None,
    landmark_references: ArrayLike | None = None,
    landmark_weights: ArrayLike | None = None,
) -> dict[str, Any]:
    """The fields of `Measurements`, as float64 NumPy arrays, from the arguments of `from_arrays`.

    Raises:
        MeasurementError: as in `Measurements.from_arrays`.
    """
    omega = finite_array("angular_velocity", angular_velocity, (None, 3))
    samples = omega.shape[0]
    steps = np.full(samples, time_step) if np.ndim(time_step) == 0 else time_step
    step = finite_array("time_step", steps, (samples,))
    if samples == 0:
        raise MeasurementError("angular_velocity: at least one sample is needed, got none")
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        raise MeasurementError(f"time_step: must be positive, got {step[k]:g} s at sample {k}")
    limits.TIME_STEP.checked("time_step", step)
    limits.ANGULAR_VELOCITY.checked("angular_velocity", omega)
    moves = finite_array("velocity", velocity, (samples, 3))
    limits.VELOCITY.checked("velocity", moves)
    v, v_ref, v_weight = _sightings("vector", vectors, vector_references, vector_weights, samples)
    y, y_ref, y_weight = _sightings(
        "landmark", landmarks, landmark_references, landmark_weights, samples
    )
    return {
        "time_step": step,
        "angular_velocity": omega,
        "velocity": moves,
        "vectors": v,
        "vector_references": v_ref,
        "vector_weights": v_weight,
        "landmarks": y,
        "landmark_references": y_ref,
        "landmark_weights": y_weight,
    }


_LIMITS = {
    "vector": (limits.VECTOR, limits.VECTOR),
    "landmark": (limits.LANDMARK, limits.POSITION),
}
"""Limits of measurements and references, by sensor."""


def finite_array(
    name: str, value: ArrayLike, shape: tuple[int | None, ...], *, finite: bool = True
) -> np.ndarray:
    """The argument as a float64 array, checked for its shape (None: any length)."""
    array = _numbers(name, value)
    fits = array.ndim == len(shape) and all(
        w in (None, h) for w, h in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("N" if s is None else str(s) for s in shape) + ")"
        raise MeasurementError(f"{name}: must have the shape {wanted}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise MeasurementError(f"{name}: must be finite, got {array[where]} at {where}")
    return array


def finite_rows(values: np.ndarray) -> np.ndarray:
    """Whether all components (..., d) are finite, as (...).

    One component after the other: NumPy's `all` over so short an axis takes five times as long.
    """
    return _every(np.isfinite(values))


def known_means(parts: np.ndarray) -> np.ndarray:
    """Means (n, d) of the finite rows of each part (n, k, d); NaN where there is none."""
    known = finite_rows(parts)[..., None]
    count = known.sum(axis=1)
    return np.where(known, parts, 0.0).sum(axis=1) / np.where(count > 0, count, np.nan)


def _every(rows: np.ndarray) -> np.ndarray:
    return reduce(np.logical_and, np.moveaxis(rows, -1, 0))


def numeric_array(name: str, value: ArrayLike | None, shape: tuple[int, ...]) -> None:
    """Raise a MeasurementError unless this is an array of numbers, traced or not, of this shape."""
    if value is None:
        raise MeasurementError(f"{name}: must be an array of numbers, got None")
    if not isinstance(value, jax.Array):
        _numbers(name, value)
        if np.asarray(value).dtype.kind == "O":
            raise MeasurementError(f"{name}: must be an array of numbers, got one of objects")
    if np.shape(value) != shape:
        raise MeasurementError(f"{name}: must have the shape {shape}, got {np.shape(value)}")


def unmasked(value: Any) -> Any:
    """A masked array with NaN where it is masked; anything else as it is.

    Masked arrays inside lists, such as the rows of an array, are converted too.
    """
    if isinstance(value, np.ma.MaskedArray):
        return np.ma.filled(value.astype(np.float64), np.nan)
    if isinstance(value, list | tuple):
        return [unmasked(one) for one in value]
    return value


def _numbers(name: str, value: ArrayLike) -> np.ndarray:
    """The argument as a float64 array of any shape, NaN where it is masked."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "cSUMm":  # NumPy would convert them
            raise TypeError(f"these are {array.dtype}")
        return np.asarray(unmasked(value)).astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise MeasurementError(f"{name}: must be an array of numbers ({error})") from None


def _sightings(
    name: str,
    body: ArrayLike | None,
    references: ArrayLike | None,
    weights: ArrayLike | None,
    samples: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Body values, references and weights of vectors or of landmarks, in full shape."""
    if body is None and references is None:
        if weights is not None:
            raise MeasurementError(f"{name}_weights: given without {name}s")
        return np.zeros((samples, 0, 3)), np.zeros((samples, 0, 3)), np.zeros((samples, 0))
    if body is None or references is None:
        raise MeasurementError(f"{name}s and {name}_references: give both or neither")
    values = finite_array(f"{name}s", body, (samples, None, 3), finite=False)
    count = values.shape[1]
    known = _numbers(f"{name}_references", references)
    known = finite_array(
        f"{name}_references", known, (count, 3) if known.ndim == 2 else (samples, count, 3)
    )
    of_body, of_known = _LIMITS[name]
    of_known.checked(f"{name}_references", known)
    weight = _numbers(f"{name}_weights", 1.0 if weights is None else weights)
    if weight.shape not in ((), (count,), (samples, count)):
        raise MeasurementError(
            f"{name}_weights: must be a scalar or have the shape ({count},) or "
            f"({samples}, {count}), got {weight.shape}"
        )
    bad = ~(np.isfinite(weight) & (weight >= 0))
    if bad.any():
        raise MeasurementError(
            f"{name}_weights: must be finite and not negative, got {weight[bad][0]}"
        )
    weight = np.broadcast_to(weight, (samples, count))
    infinite = np.isinf(values) & (weight > 0)[..., None]
    if infinite.any():
        where = tuple(int(i) for i in np.argwhere(infinite)[0])
        raise MeasurementError(f"{name}s: must not be infinite, got {values[where]} at {where}")
    limits.WEIGHT.checked(f"{name}_weights", weight)
    seen = finite_rows(values) & (weight > 0)
    values[~seen] = 0.0
    of_body.checked(f"{name}s", values)
    if name == "vector":
        # A zero vector has no direction: as a reference it is refused, as a measurement missing.
        if (_every(known == 0) & (weight > 0)).any():
            raise MeasurementError("vector_references: must not be zero where the weight is not")
        seen &= ~_every(values == 0)
    known = np.broadcast_to(known, (samples, count, 3))
    return values, known, np.where(seen, weight, 0.0)
