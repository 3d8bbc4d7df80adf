"""The figures of a tuned schedule: terms, control surface and use of the rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jax import Array

from posegsa.arguments import check_type
from posegsa.config import INPUT_RANGE, TERMS
from posegsa.figures import style
from posegsa.figures.captioned import ResultFigure, captioned
from posegsa.figures.style import Style
from posegsa.judging.trust import Trust
from posegsa.model.fuzzy import FuzzyController, gains_over

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURES: list[ResultFigure] = []

GAIN = "Gain $K$ [1/s]"
_RESOLUTION = 401  # points along each side of the control surface
_SQUARE_ROOT = (
    lambda x: np.copysign(np.sqrt(np.abs(x)), x),
    lambda x: np.copysign(np.square(x), x),
)
"""An axis scale and its inverse."""


@captioned(
    FIGURES,
    name="control_surface",
    title="Control surface",
    caption="The output as a function of the error and its rate of change. Both axes are stretched "
    "towards 0, where a filter spends most of its time. No rule fires in hatched regions.",
)
def plot_surface(controller: FuzzyController, output: str = GAIN) -> Figure:
    """Control surface: gain K [1/s] over the scaled error and rate, 0 to 1.

    Where no rule fires the surface is blank, and the legend states the gain.

    Args:
        controller: The controller.
        output: Label of K, with its unit; in a Kalman filter a factor on noises follows from K.
    """
    check_type("controller", controller, FuzzyController)
    figure, (ax,) = style.panels(1, 4.3)
    axis = np.linspace(0.0, 1.0, _RESOLUTION) ** 2
    gain = np.asarray(gains_over(controller, axis), np.float64)
    idle = np.zeros(axis.shape, bool)
    for start, end in _gaps(controller):
        idle |= (start <= axis) & (axis <= end)
    gain = np.ma.masked_array(gain, idle | idle[:, None])
    for scale in (ax.set_xscale, ax.set_yscale):
        scale("function", functions=_SQUARE_ROOT)
    ax.set(xlim=(0, 1), ylim=(0, 1))
    mesh = ax.pcolormesh(axis, axis, gain, cmap="cividis", shading="nearest", rasterized=True)
    style.colour_bar(figure, mesh, ax, output)
    low, high = controller.output_range
    unit, last = (" 1/s", "gain") if output == GAIN else ("", "$K$")
    middle = f"$K$ = {controller.offset + 0.5 * (low + high):g}{unit}"
    meaning = f"the last {last} is held" if controller.no_rule == "hold" else middle
    _hatch(figure, ax, [ax.axvspan, ax.axhspan], controller, f"no rule fires: {meaning}")
    for side in (ax.xaxis, ax.yaxis):
        side.set_ticks((0, 0.01, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1))
        side.set_major_formatter("{x:g}")
    ax.set(xlabel="Scaled error [-]", ylabel="Scaled rate [-]")
    return figure


@captioned(
    FIGURES,
    name="rules",
    title="Use of the rules",
    caption="Rules that never fire had little or no influence on the cost, so their outputs are "
    "largely arbitrary.",
)
def plot_rules(trust: Trust) -> Figure:
    """Mean firing strength [-] of each rule over a held-out trajectory, by the terms of its inputs.

    Colours distinguish small strengths better than large ones, because the rules of small errors
    fire most of the time. A rule that never fires is blank.
    """
    from matplotlib.colors import PowerNorm

    weights = np.asarray(trust.rule_weights, np.float64)
    figure, (ax,) = style.panels(1, 4.0)
    top = max(float(np.max(weights)), 1e-9)
    shown = np.ma.masked_array(weights, ~(weights > 0))
    image = ax.imshow(
        shown, cmap="cividis", norm=PowerNorm(0.5, 0, top), origin="lower", aspect="auto"
    )
    for (rate, error), weight in np.ndenumerate(weights):
        dark = 0 < weight < 0.3 * top
        text = f"{weight:.2g}" if weight > 0 else "never"
        colour = "white" if dark else "black" if weight > 0 else "0.5"
        ax.text(error, rate, text, ha="center", va="center", color=colour, size=style.TICK_SIZE)
    names = _term_names(len(weights))
    ax.set_xticks(range(len(weights)), names)
    ax.set_yticks(range(len(weights)), names)
    ax.tick_params(length=0)
    ax.set(xlabel="Term of the scaled error [-]", ylabel="Term of the scaled rate [-]")
    style.colour_bar(figure, image, ax, "Mean firing strength [-]")
    return figure


@captioned(
    FIGURES,
    name="input_terms",
    title="Input terms",
    caption="Membership of the scaled error and its rate in the terms very small (VS) to very "
    "large (VL).",
)
def plot_input_terms(controller: FuzzyController) -> Figure:
    """Input terms VS to VL over the scaled error and rate, 0 to 1; gaps between them are marked."""
    check_type("controller", controller, FuzzyController)
    figure, ax = _plot_terms(controller.input_terms, INPUT_RANGE, "Scaled error, scaled rate [-]")
    _hatch(figure, ax, [ax.axvspan], controller, "no rule fires")
    return figure


@captioned(
    FIGURES,
    name="output_terms",
    title="Output terms",
    caption="The outputs of the rules. The gain is the offset plus the centroid of the union of "
    "these terms, each clipped at its firing strength.",
)
def plot_output_terms(controller: FuzzyController, output: str = GAIN) -> Figure:
    """Output terms VS to VL over the output k_op [1/s]; the gain is offset + centroid.

    Args:
        controller: The controller.
        output: Label of K, as for `plot_surface`.
    """
    check_type("controller", controller, FuzzyController)
    gain = f"$K = {controller.offset:g} + $ centroid"
    unit, what = ("1/s", "gain ") if output == GAIN else ("-", "")
    label = rf"Output $k_\mathrm{{op}}$ [{unit}];  {what}{gain}"
    figure, _ = _plot_terms(controller.output_terms, controller.output_range, label)
    return figure


def _plot_terms(triangles: Array, universe: tuple[float, float], label: str) -> tuple[Figure, Axes]:
    """Triangles (n, 3) over their universe, with names above the peaks."""
    figure, (ax,) = style.panels(1, 3.2)
    terms, (low, high) = np.asarray(triangles), universe
    names = _term_names(len(terms))
    order = np.argsort(terms[:, 1], kind="stable")
    places = np.empty(len(terms))
    places[order] = _apart(terms[order, 1], 0.055 * (high - low))
    for i, ((a, b, c), name, place) in enumerate(zip(terms, names, places, strict=True)):
        look = style.curve(i)
        ax.plot([a, b, c], [0, 1, 0], clip_on=False, linewidth=1.8, **look)
        ax.annotate(
            name,
            (b, 1.01),
            (place, 1.09),
            annotation_clip=False,
            ha="center",
            color=look["color"],
            arrowprops={"arrowstyle": "-", "linewidth": 0.7, "color": "0.5", "shrinkB": 0},
        )
    margin = 0.015 * (high - low)
    ax.set(xlim=(low - margin, high + margin), ylim=(0, 1), xlabel=label, ylabel="Membership [-]")
    return figure, ax


def _term_names(count: int) -> list[str]:
    """Names of the terms of a fuzzy variable: VS to VL, or numbers if there are not five."""
    return list(TERMS) if count == len(TERMS) else [str(i + 1) for i in range(count)]


def _apart(places: np.ndarray, distance: float) -> np.ndarray:
    """Ascending places, moved as little as needed to be at least `distance` apart."""
    steps = distance * np.arange(len(places))
    right = np.maximum.accumulate(places - steps) + steps
    left = np.minimum.accumulate((places - steps)[::-1])[::-1] + steps
    return 0.5 * (right + left)


def _gaps(controller: FuzzyController) -> list[tuple[float, float]]:
    """Intervals of [0, 1] that no input term covers.

    Every pair of input terms has a rule, so no rule fires exactly where error or rate is in a gap.
    """
    terms = np.clip(np.asarray(controller.input_terms, np.float64), 0, 1)
    gaps, covered = [], 0.0
    for foot, _, end in sorted(terms.tolist()):
        if foot > covered:
            gaps.append((covered, foot))
        covered = max(covered, end)
    if covered < 1:
        gaps.append((covered, 1.0))
    return gaps


def _hatch(
    figure: Figure,
    ax: Axes,
    spans: Sequence[Callable[..., object]],
    controller: FuzzyController,
    label: str,
) -> None:
    """Hatch the intervals where no rule fires, and explain them in a legend."""
    look: Style = {"facecolor": "white", "edgecolor": "0.35", "hatch": "////", "linewidth": 0.6}
    gaps = _gaps(controller)
    for start, end in gaps:
        for span in spans:
            span(start, end, label=label, zorder=3, **look)
    if gaps:
        style.legend_above(figure, ax)
