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
    plot: Callable[[Any], Figure | None]
    """Draws the part of a `Result` with the name of its argument (`_parts`); returns None if there
    is nothing to show."""

    def draw(self, result: Result) -> Figure | None:
        """The figure of a result; None if it has nothing to show."""
        (shown,) = inspect.signature(self.plot).parameters
        part = _parts(result).get(shown)
        return None if part is None else self.plot(part)

    @property
    def alternative(self) -> str:
        """A description for readers who cannot see the figure."""
        return (self.plot.__doc__ or self.title).partition("\n")[0]


def _parts(result: Result) -> dict[str, Any]:
    """What figures show of a result, by the name of their argument."""
    judged = result.on_scenarios
    parts: dict[str, Any] = {"history": None if result.search is None else result.search.history}
    if judged is not None:
        parts |= {"evaluation": judged.evaluation, "trajectory": judged.trajectory}
    if result.filter.kind == "fuzzy":
        parts |= {"controller": result.controller}
        parts |= {"trust": None if judged is None else judged.trust}
    return parts


def captioned(figures: list[ResultFigure], **words: str) -> Callable[[Plot], Plot]:
    """Decorator: applies the common style to a plot, and adds it to `figures` with these words."""

    def add(plot: Plot) -> Plot:
        drawn = styled(plot)
        figures.append(ResultFigure(**words, plot=drawn))
        return drawn

    return add
