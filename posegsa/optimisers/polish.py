"""A search, and then a descent from the best position that it found."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from posegsa.errors import ConfigError
from posegsa.optimisers.adam import Adam, DescentSettings
from posegsa.optimisers.base import Optimiser
from posegsa.optimisers.gsa import GSA
from posegsa.settings.fields import Count


class Polish(DescentSettings, Optimiser):
    """A descent by Adam that follows a search; both share agents x iterations evaluations.

    A search of another kind is polished by a class of its own, made like `PolishedGSA`.
    """

    starts: Count = 8
    """Number of starts of the descent, at and around the best position found."""
    share: Annotated[float, Field(strict=True, gt=0, lt=1)] = 0.5
    """Share of the evaluations that the descent gets."""

    searching: ClassVar[type[Optimiser]]
    """The kind of the search, whose settings the class has as well."""
    fixed_length: ClassVar[str] = Adam.fixed_length

    @property
    def phases(self) -> tuple[Optimiser, ...]:
        """The search and the descent.

        Raises:
            ConfigError: The descent's evaluations are not enough for one step.
        """
        searched = max(1, round(self.iterations * (1 - self.share)))
        left = self.agents * (self.iterations - searched)
        step = self.starts * self.gradient_price
        if left < step:
            raise ConfigError(
                f"share = {self.share} of {self.optimiser} leaves {left} of {self.agents} x "
                f"{self.iterations} evaluations for the descent; allowed: at least {step}, one "
                "step, starts x gradient_price"
            )
        mine: dict[str, Any] = dict(self) | {"iterations": searched}
        search = {name: mine[name] for name in self.searching.model_fields if name != "optimiser"}
        descent = {name: mine[name] for name in DescentSettings.model_fields}
        steps = left // step
        return self.searching(**search), Adam(agents=self.starts, iterations=steps, **descent)


class PolishedGSA(Polish, GSA):
    """The gravitational search algorithm, and then gradient descent from what it found."""

    optimiser: Literal["gsa+adam"] = "gsa+adam"
    """Name of the optimiser."""

    searching: ClassVar[type[Optimiser]] = GSA
    title: ClassVar[str] = "The gravitational search algorithm, then gradient descent (Adam),"
