"""A search, followed by a gradient descent from the best position found."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from posegsa.optimisers.adam import Adam, DescentSettings
from posegsa.optimisers.ask_tell import Optimiser
from posegsa.optimisers.gsa import GSA
from posegsa.settings.fields import MAX_COUNT, Count
from posegsa.settings.violations import Violation


class Polish(DescentSettings, Optimiser):
    """A descent by Adam after a search; subclass it with the search, as `PolishedGSA` does."""

    iterations: Count = 250
    """Iterations of the search if there were no descent: search and descent together make at most
    agents x iterations evaluations."""
    starts: Count = 8
    """Number of starts of the descent, at and around the best position found."""
    share: Annotated[float, Field(strict=True, gt=0, lt=1)] = 0.5
    """Share of the evaluations that the descent gets."""

    searching: ClassVar[type[Optimiser]]
    """The class of the search, whose settings this class has too."""
    fixed_length: ClassVar[str] = Adam.fixed_length

    @property
    def phases(self) -> tuple[Optimiser, ...]:
        """The search and the descent."""
        searched, left, step = self._divided()
        mine: dict[str, Any] = dict(self) | {"iterations": searched}
        search = {name: mine[name] for name in self.searching.model_fields if name != "optimiser"}
        descent = {name: mine[name] for name in DescentSettings.model_fields}
        steps = min(left // step, MAX_COUNT)
        return self.searching(**search), Adam(agents=self.starts, iterations=steps, **descent)

    def _divided(self) -> tuple[int, int, int]:
        """Iterations of the search, evaluations left for the descent, evaluations of one step."""
        searched = max(1, round(self.iterations * (1 - self.share)))
        left = self.agents * (self.iterations - searched)
        return searched, left, self.starts * self.gradient_price

    def _conflicts(self) -> Iterator[Violation]:
        _, left, step = self._divided()
        if left < step:
            reason = (
                f"leaves {left} of {self.agents} x {self.iterations} evaluations for the descent; "
                f"allowed: at least {step}, one step, starts x gradient_price"
            )
            yield Violation("share", reason, self.share)


class PolishedGSA(Polish, GSA):
    """The gravitational search algorithm, then gradient descent from its best position."""

    optimiser: Literal["gsa+adam"] = "gsa+adam"
    """Name of the optimiser."""

    searching: ClassVar[type[Optimiser]] = GSA
    title: ClassVar[str] = "The gravitational search algorithm, then gradient descent (Adam),"
