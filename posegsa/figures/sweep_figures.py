"""The figures of a sweep: cost against the values of a varied key."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from posegsa.arguments import check_type, refuse
from posegsa.figures import style
from posegsa.judging.sweep_runs import Spread, Sweep, SweepRun, Values, shown_value, spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_CURVES = 6
"""Maximum number of curves, one for each setting of the other keys; more are merged into one."""
FEW = 6
"""Up to this many values, each gets a number on a linear axis."""
LOGARITHMIC = 10.0
"""Ratio of largest to smallest value from which the axis of a key is logarithmic."""


@style.styled
def plot_sweep(sweep: Sweep, key: str) -> Figure:
    """Held-out and training cost over the values of one key: means, and ranges over seeds.

    Each setting of the other keys has a curve; many settings are merged into one.
    """
    check_type("sweep", sweep, Sweep)
    if key not in sweep.keys:
        refuse(f"key = {key!r}", ", ".join(sweep.keys))
    curves = _curves(sweep, key)
    texts = dict.fromkeys(text for each in curves.values() for text in each)
    values = [json.loads(text) for text in texts]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    places = values if numeric else list(range(len(values)))
    at = dict(zip(texts, places, strict=True))
    figure, axes = style.panels(2, 5.4)
    shown = ("held_out_cost", "Held-out"), ("training_cost", "Training")
    for ax, (field, label) in zip(axes, shown, strict=True):
        for i, (name, each) in enumerate(curves.items()):
            found = [spread([getattr(run, field) for run in runs]) for runs in each.values()]
            aside = 0.0 if numeric else 0.12 * (i - 0.5 * (len(curves) - 1))
            x = np.array([at[text] for text in each], np.float64) + aside
            _draw(ax, x, found, name, i, joined=numeric)
        ax.set_ylabel(f"{label} cost [-]\nmean, min., max.")
    _scale(axes[-1], key, values, numeric=numeric)
    if list(curves) != [""]:
        style.legend_above(figure, axes[0])
    return figure


def _curves(sweep: Sweep, key: str) -> dict[str, dict[str, list[SweepRun]]]:
    """Runs by the settings of the other keys (in words), then by the value of this key (JSON)."""
    named: dict[str, dict[str, list[SweepRun]]] = {}
    others = {_others(run.values, key) for run in sweep.runs}
    for run in sweep.runs:
        name = _others(run.values, key) if len(others) <= MOST_CURVES else "all others"
        named.setdefault(name, {}).setdefault(json.dumps(run.values[key]), []).append(run)
    return named


def _others(values: Values, key: str) -> str:
    """The settings of the other keys in words."""
    return ", ".join(f"{name} = {shown_value(v)}" for name, v in values.items() if name != key)


def _draw(ax: Axes, x: np.ndarray, costs: list[Spread], name: str, i: int, *, joined: bool) -> None:
    """Means with bars from minimum to maximum."""
    mean, least, most = (
        style.finite(np.array([getattr(one, field) for one in costs]))
        for field in ("mean", "least", "most")
    )
    look = {**style.curve(i), "marker": "o", "markersize": 4}
    if not joined:
        look["linestyle"] = "none"
    bars = np.array([mean - least, most - mean])
    ax.errorbar(x, mean, yerr=bars, elinewidth=1, capsize=3, label=name, **look)


def _scale(ax: Axes, key: str, values: list, *, numeric: bool) -> None:
    """The axis of the key: one place per word, or a scale for numbers."""
    ax.set_xlabel(key)
    if not numeric:
        ax.set_xticks(range(len(values)), [shown_value(value) for value in values])
        ax.set_xlim(-0.5, len(values) - 0.5)
    elif min(values) > 0 and max(values) >= LOGARITHMIC * min(values):
        ax.set_xscale("log")
        ax.set_xticks(values, [f"{value:g}" for value in values])
        ax.minorticks_off()
    elif len(values) <= FEW:
        ax.set_xticks(values, [f"{value:g}" for value in values])
