"""A figure of a result, with the words that go with it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from posegsa.judging.result import TuneResult


@dataclass(frozen=True, kw_only=True)
class ResultFigure:
    """A figure of a result: how it is drawn, and what its reader is told."""

    name: str
    """Name of its file."""
    title: str
    caption: str
    """How to read it."""
    shows: str
    """The attribute of `TuneResult` that it shows."""
    plot: Callable[[Any], Figure | None]
    """Draws that attribute; None where there is nothing to see."""

    def draw(self, result: TuneResult) -> Figure | None:
        """The figure of a result."""
        return self.plot(getattr(result, self.shows))

    @property
    def alternative(self) -> str:
        """What is drawn, for who cannot see it."""
        return (self.plot.__doc__ or self.title).partition("\n")[0]
