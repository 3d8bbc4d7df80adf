"""Checks of the arguments of public functions. An error names the argument."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from numbers import Integral, Real
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import ArgumentError, PosegsaError

MAX_INTEGER = 2**31 - 1
"""The largest value of JAX's default integers, int32."""


def refuse(problem: str, allowed: str) -> NoReturn:
    """Raise the ArgumentError that says what was given and what is allowed."""
    raise ArgumentError(f"{problem}; allowed: {allowed}")


def check_type(name: str, value: object, *kinds: type, allowed: str = "") -> None:
    """Raise an ArgumentError unless a value has one of these types; `allowed` describes them."""
    if not isinstance(value, kinds):
        words = allowed or " or ".join(f"a {kind.__name__}" for kind in kinds)
        refuse(f"{name}: a {'class' if isinstance(value, type) else type(value).__name__}", words)


def check_callable(name: str, value: object) -> None:
    """Raise an ArgumentError unless a value is a callable or None."""
    if value is not None and not callable(value):
        refuse(f"{name}: a {type(value).__name__}", "a function, or None")


def several(name: str, values: Any, kind: type, allowed: str) -> list[Any]:
    """A user's values of one type, as a list. Anything else is refused, also a single string."""
    if isinstance(values, str):
        refuse(f"{name} = {values!r}", f"{allowed}, as in [{values!r}]")
    check_type(name, values, Iterable, allowed=allowed)
    found = list(values)
    for value in found:
        check_type(name, value, kind, allowed=allowed)
    return found


def check_whole(name: str, value: Any, minimum: int, maximum: int = MAX_INTEGER) -> None:
    """Raise an ArgumentError unless a value is a whole number in [minimum, maximum]."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and minimum <= int(value) <= maximum):
        refuse(f"{name} = {value!r}", f"a whole number from {minimum} to {maximum}")


def check_number(
    name: str, value: Any, minimum: float = -math.inf, maximum: float = math.inf
) -> None:
    """Raise an ArgumentError unless a value is a finite number in [minimum, maximum]."""
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):  # an integer of hundreds of digits
            number = float(value)
    if not (math.isfinite(number) and minimum <= number <= maximum):
        bounds = f" of at least {minimum:g}" if minimum > -math.inf else ""
        if maximum < math.inf:
            bounds = f" from {minimum:g} to {maximum:g}"
        refuse(f"{name} = {value!r}", f"a finite number{bounds}")


def check_dtype(name: str, dtype: Any) -> None:
    """Raise an ArgumentError unless this is a floating-point dtype."""
    try:
        floating = jnp.issubdtype(jnp.dtype(dtype), jnp.floating)
    except TypeError:
        floating = False
    if not floating:
        refuse(f"{name} = {dtype!r}", "a floating type, float32 or float64")


def real_array(name: str, value: ArrayLike | Sequence[float]) -> np.ndarray:
    """A user's real numbers as an array. Anything else is refused."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        refuse(f"{name}: rows of unequal length", "numbers (dimensions,)")
    if array.dtype.kind not in "iuf" and array.dtype != jnp.bfloat16:
        refuse(f"{name}: holds {array.dtype}", "real numbers")
    return array


@contextmanager
def fitting(function: str) -> Iterator[None]:
    """Turn JAX's errors about arguments that do not fit together into an ArgumentError."""
    try:
        yield
    except PosegsaError:
        raise
    except (TypeError, ValueError) as error:
        what = str(error).split("\n", 1)[0]
        raise ArgumentError(f"{function}: the arguments do not fit together: {what}") from error


@contextmanager
def made_of_jax(function: str, values: str) -> Iterator[None]:
    """Turn JAX's errors about a user's function that it can't compile into an ArgumentError.

    `values` are those that the function is given, in words.
    """
    try:
        yield
    except (
        jax.errors.TracerArrayConversionError,
        jax.errors.TracerIntegerConversionError,
        jax.errors.ConcretizationTypeError,
    ) as error:
        raise ArgumentError(
            f"{function}: uses {values} outside JAX, as NumPy functions and Python's if and float "
            "do; allowed: jax.numpy, and jnp.where in place of an if "
            f"({str(error).splitlines()[0]})"
        ) from error
