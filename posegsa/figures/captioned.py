"""Figures of a result, with their titles and captions."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from posegsa.figures.style import styled
from posegsa.judging.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plot = TypeVar("Plot", bound="Callable[..., Figure | None]")


@dataclass(frozen=True, kw_only=True)
class ResultFigure:
    """A figure of a result, with its title and caption."""

    name: str
    """Name of its file."""
    title: str
    caption: str
    """How to read it."""
    plot: Callable[..., Figure | None]
    """Draws the parts of a `Result` with the names of its arguments (`_parts`), all but the first
    with a default; returns None if there is nothing to show."""

    def draw(self, result: Result) -> Figure | None:
        """The figure of a result; None if it has nothing to show."""
        shown, *more = inspect.signature(self.plot).parameters
        parts = _parts(result)
        if parts.get(shown) is None:
            return None
        return self.plot(parts[shown], **{name: parts[name] for name in more if name in parts})

    @property
    def alternative(self) -> str:
        """A description for readers who cannot see the figure."""
        return (self.plot.__doc__ or self.title).partition("\n")[0]


WHAT = {"unknown": "velocities' noise", "belief": "a sensor's variance"}
"""What each controller of a role multiplies; that of belief divides an observer's weight by it."""


_PARTS = (
    *("history", "unit", "recorded", "evaluation", "trajectory", "trust"),
    *("controller", "output"),
)
"""The arguments that a plot can have."""


def _parts(result: Result) -> dict[str, Any]:
    """The parts of a result that figures show, by their names in `_PARTS`."""
    judged = result.on_scenarios
    parts: dict[str, Any] = {"history": None if result.search is None else result.search.history}
    if result.search is not None and result.search.tuned_on == "recordings":
        parts["unit"] = "deg"
    parts["recorded"] = result.on_recordings
    if judged is not None:
        parts |= {"evaluation": judged.evaluation, "trajectory": judged.trajectory}
    if result.filter.kind == "fuzzy":
        parts |= {"trust": None if judged is None else judged.trust}
    for role, controller in [*result.controllers.items()][:1]:  # figures show the first one
        section = result.tuned.filter
        if role != "gain":
            largest, of = getattr(section, f"{role}_largest"), WHAT[role]
            base = f"{largest:.0f}" if largest >= 10 else f"{largest:.3g}"
            parts["output"] = f"$K$ [-]; {of} times ${base}^{{(K-1)/100}}$"
        parts["controller"] = controller
    return parts


def captioned(figures: list[ResultFigure], **words: str) -> Callable[[Plot], Plot]:
    """Decorator: applies the common style to a plot, and adds it to `figures` with these words.

    Raises:
        ValueError: The plot's first argument is no part of a result, so it would never be drawn.
    """

    def add(plot: Plot) -> Plot:
        shown, *_ = inspect.signature(plot).parameters
        if shown not in _PARTS:
            raise ValueError(f"{words['name']}: shows {shown!r}; allowed: one of {_PARTS}")
        drawn = styled(plot)
        figures.append(ResultFigure(**words, plot=drawn))
        return drawn

    return add
