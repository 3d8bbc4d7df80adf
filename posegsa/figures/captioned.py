"""A figure of a result, with the words that go with it."""

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
    """A figure of a result: how it is drawn, and what its reader is told."""

    name: str
    """Name of its file."""
    title: str
    caption: str
    """How to read it."""
    plot: Callable[[Any], Figure | None]
    """Draws the attribute of a `TuneResult` that its argument is named after, if there is anything
    to see."""

    def draw(self, result: TuneResult) -> Figure | None:
        """The figure of a result."""
        (shown,) = inspect.signature(self.plot).parameters
        return self.plot(getattr(result, shown))

    @property
    def alternative(self) -> str:
        """What is drawn, for readers who cannot see it."""
        return (self.plot.__doc__ or self.title).partition("\n")[0]


def captioned(figures: list[ResultFigure], **words: str) -> Callable[[Plot], Plot]:
    """Decorator: gives a plot the common style, and adds it to figures with its name and words."""

    def add(plot: Plot) -> Plot:
        drawn = styled(plot)
        figures.append(ResultFigure(**words, plot=drawn))
        return drawn

    return add
