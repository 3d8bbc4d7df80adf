"""Numbers for readers: a minus sign, an infinity sign, a dash for a missing value."""

import math

import numpy as np

from posegsa.judging.evaluation import Interval

MINUS, DASH, INFINITE = "\u2212", "\u2013", "\u221e"


def number(value: float | np.floating, form: str = ".2f") -> str:
    """A number in a Python format."""
    value = float(value)
    if math.isnan(value):
        return DASH
    if math.isinf(value):
        return INFINITE if value > 0 else MINUS + INFINITE
    text = format(abs(value), form).lstrip("+")
    if float(text) == 0:
        return text
    return (MINUS if value < 0 else "+" if form.startswith("+") else "") + text


def percent(share: float | np.floating, form: str = ".1f") -> str:
    """A share as a percentage."""
    return f"{number(100 * share, form)} %"


def cost(value: float | np.floating, form: str = ".2f") -> str:
    """A cost: two decimals, or four digits from 10 000."""
    large = math.isfinite(value) and abs(value) >= 1e4
    return number(value, form.replace(".2f", ".4g") if large else form)


def interval(of: Interval, form: str = "+.2f") -> str:
    """Both ends of an interval of costs; dashes if there is none."""
    return " to ".join(cost(end, form) for end in of.ends)


def plus_minus(of: Interval) -> str:
    """Half the length of an interval of costs; empty if it is not finite."""
    half = 0.5 * (of.high - of.low)
    return f"\u00b1 {cost(half)}" if math.isfinite(half) else ""
