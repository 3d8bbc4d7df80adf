"""Checks of what users hand to an optimiser, outside jit."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from numbers import Integral, Real
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from posegsa.errors import ArgumentError

MOST = 10**8
"""What counts may be: with more, the history of a search alone would not fit a machine."""
SMALLEST_EPSILON = float(np.finfo(np.float32).tiny)
"""What is added against division by zero: a smaller number would be 0 in float32."""
SMALLEST_SIGMA = 1e-12
"""Standard deviation at the start of a search, in widths of the box; from 0 none gets away."""


def real_array(name: str, value: ArrayLike | Sequence[float]) -> np.ndarray:
    """Numbers from a user."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        refuse(f"{name}: rows of unequal length", "numbers (dimensions,)")
    if array.dtype.kind not in "iuf" and array.dtype != jnp.bfloat16:
        refuse(f"{name}: holds {array.dtype}", "real numbers")
    return array


def refuse_unreal(name: str, found: Any) -> None:
    """Raise an ArgumentError unless a function has returned an array of real numbers."""
    if not hasattr(found, "dtype") or not jnp.issubdtype(found.dtype, jnp.number):
        refuse(f"{name}: returns a {type(found).__name__}", "an array of numbers")
    if jnp.issubdtype(found.dtype, jnp.complexfloating):
        refuse(f"{name}: returns {found.dtype}", "real numbers")


def check_callable(name: str, value: Any) -> None:
    """Raise an ArgumentError unless this is a function."""
    if not callable(value):
        refuse(f"{name}: a {type(value).__name__}", "a function")


def check_key(key: Any) -> None:
    """Raise an ArgumentError unless this is one random key, of the new style or the old."""
    new = isinstance(key, Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    old = isinstance(key, Array) and key.dtype == jnp.uint32
    if not (new and key.ndim == 0) and not (old and key.ndim == 1):
        what = f"{key.dtype} {key.shape}" if isinstance(key, Array) else type(key).__name__
        refuse(f"key: {what}", "a random key, jax.random.key(seed)")


def check_count(name: str, value: Any, least: int = 1) -> None:
    """Raise an ArgumentError unless `value` is an integer in [least, MOST]."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and least <= int(value)):
        refuse(f"{name} = {value!r}", f"an integer of at least {least}")
    if int(value) > MOST:
        refuse(f"{name} = {value!r}", f"an integer of at most {MOST}")


def check_number(name: str, value: Any, least: float = 0, most: float = math.inf) -> None:
    """Raise an ArgumentError unless `value` is a finite number in [least, most]."""
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):  # a whole number of hundreds of digits
            number = float(value)
    if not (math.isfinite(number) and least <= number <= most):
        most_words = "" if most == math.inf else f" and at most {most:g}"
        refuse(f"{name} = {value!r}", f"a finite number of at least {least:g}{most_words}")


def check_choice(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Raise an ArgumentError unless `value` is one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        refuse(f"{name} = {value!r}", " or ".join(map(repr, choices)))


def refuse(problem: str, allowed: str) -> NoReturn:
    """Raise the ArgumentError that says what was given and what is allowed."""
    raise ArgumentError(f"{problem}; allowed: {allowed}")


@contextmanager
def made_of_jax() -> Iterator[None]:
    """An objective that leaves JAX is refused in words."""
    try:
        yield
    except (
        jax.errors.TracerArrayConversionError,
        jax.errors.TracerIntegerConversionError,
        jax.errors.ConcretizationTypeError,
    ) as error:
        raise ArgumentError(
            "objective: uses the values of its positions outside JAX, as NumPy functions and "
            f"Python's if and float do; allowed: jax.numpy ({str(error).splitlines()[0]})"
        ) from error
