"""Checks of what users hand to public functions: what can't be used is refused by its name."""

from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Integral
from typing import Any

import jax.numpy as jnp

from posegsa.errors import ArgumentError, PosegsaError


def check_type(name: str, value: object, *kinds: type, allowed: str = "") -> None:
    """Raise an ArgumentError unless a value is of one of these types.

    Args:
        name: The argument's name.
        value: What was given.
        kinds: The types.
        allowed: What is allowed, in words; by default the types' names.
    """
    if not isinstance(value, kinds):
        words = allowed or " or ".join(f"a {kind.__name__}" for kind in kinds)
        raise ArgumentError(f"{name}: a {type(value).__name__}; allowed: {words}")


def check_callable(name: str, value: object) -> None:
    """Raise an ArgumentError unless a value can be called, or is None."""
    if value is not None and not callable(value):
        raise ArgumentError(f"{name}: a {type(value).__name__}; allowed: a function, or None")


def check_whole(name: str, value: Any, least: int, most: int) -> None:
    """Raise an ArgumentError unless a value is a whole number in [least, most]."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (whole and least <= int(value) <= most):
        raise ArgumentError(f"{name} = {value!r}; allowed: a whole number from {least} to {most}")


def check_dtype(name: str, dtype: Any) -> None:
    """Raise an ArgumentError unless this is a floating dtype."""
    try:
        floating = jnp.issubdtype(jnp.dtype(dtype), jnp.floating)
    except TypeError:
        floating = False
    if not floating:
        raise ArgumentError(f"{name} = {dtype!r}; allowed: a floating type, float32 or float64")


@contextmanager
def fitting(function: str) -> Iterator[None]:
    """What JAX says of arguments that don't fit together comes as an ArgumentError."""
    try:
        yield
    except PosegsaError:
        raise
    except (TypeError, ValueError) as error:
        what = str(error).split("\n", 1)[0]
        raise ArgumentError(f"{function}: the arguments do not fit together: {what}") from error
