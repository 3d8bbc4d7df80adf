"""Figures of a result, with their titles and captions."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from posegsa.figures.style import styled
from posegsa.judging.result import TuneResult

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
    """Draws the attribute of a `TuneResult` with the name of its argument; returns None if there is
    nothing to show."""

    def draw(self, result: TuneResult) -> Figure | None:
        """The figure of a result."""
        (shown,) = inspect.signature(self.plot).parameters
        return self.plot(getattr(result, shown))

    @property
    def alternative(self) -> str:
        """A description for readers who cannot see the figure."""
        return (self.plot.__doc__ or self.title).partition("\n")[0]


def captioned(figures: list[ResultFigure], **words: str) -> Callable[[Plot], Plot]:
    """Decorator: applies the common style to a plot, and adds it to `figures` with these words."""

    def add(plot: Plot) -> Plot:
        drawn = styled(plot)
        figures.append(ResultFigure(**words, plot=drawn))
        return drawn

    return add
