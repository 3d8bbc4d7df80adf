"""What every optimiser is: settings with three pure methods."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Self

import jax.numpy as jnp
import numpy as np
from jax import Array, random
from jax.typing import DTypeLike

from posegsa.errors import ConfigError
from posegsa.settings.fields import Count, Section
from posegsa.settings.violations import Refused, Violation
from posegsa.words import counted

Objective = Callable[[Array], Array]
"""Maps positions (agents, dimensions), in the box's coordinates, to costs (agents,)."""

FailureCost = Literal["largest", "worst so far", "worst now"]
"""What an optimiser is told of a position whose cost is not finite, so that it never passes for a
good one, now or later:

    "largest": the largest finite number, for one that does nothing but compare costs.
    "worst so far": a little more than the worst finite cost of the whole search, and before any
        some 1e15 (in float64 1e123), for one that keeps costs and calculates with them.
    "worst now": the worst finite cost of the iteration, for one that keeps none: an old, high cost
        would make all of these look alike. Where they are equal it is a little more.
"""


class Optimiser(Section):
    """Settings of an optimiser, and its three pure methods over an immutable state.

    A subclass adds its settings as fields, `init` and `tell`, and `ask` if its state has no
    `position` to ask for. They see positions in the unit box, and finite costs: the loop
    (`posegsa.optimisers.loop`) sees to both. Settings are checked, frozen and hashable, so that
    they can be static in a compiled function. What is registered (`posegsa.optimisers.registry`)
    can be named in a configuration, whose [search] it then is.
    """

    optimiser: str = "own"
    """Name of the optimiser."""
    agents: Count = 100
    """Number of positions that are evaluated at once."""
    iterations: Count = 250
    """Number of iterations of a whole search."""

    title: ClassVar[str] = "An optimiser"
    """What it is, as the beginning of a sentence."""
    agent_noun: ClassVar[str] = "agent"
    """What one of its agents is called."""
    iteration_noun: ClassVar[str] = "iteration"
    """What one of its iterations is called."""
    on_host: ClassVar[bool] = False
    """Whether `ask` and `tell` are ordinary Python, which JAX can't compile."""
    wants_gradients: ClassVar[bool] = False
    """Whether `tell` is given the gradients of the costs as well."""
    failure_cost: ClassVar[FailureCost] = "worst so far"
    """What it is told of a cost that is not finite."""
    fixed_length: ClassVar[str] = ""
    """Why a search can't go on past its iterations; empty where it can."""
    compared_by_default: ClassVar[bool] = True
    """Whether `compare` runs it unless other names are asked for."""

    @abstractmethod
    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> Any:
        """Return the state before the first `ask`; it carries the key."""

    def ask(self, state: Any) -> Array:
        """Return the positions (agents, dimensions) in [0, 1] whose costs are wanted next."""
        return state.position

    @abstractmethod
    def tell(self, state: Any, costs: Array, *gradients: Array) -> Any:
        """Return the state after learning the costs (agents,) of the positions asked for.

        Gradients (agents, dimensions), where they are wanted, are with respect to the positions in
        the unit box.
        """

    def begin_at(self, state: Any, position: Array) -> Any:
        """Return the state moved to a position (dimensions,) that an earlier phase has found."""
        raise NotImplementedError(f"{type(self).__name__} can't begin at a given position")

    def check_usable(self) -> None:
        """See that it can run here.

        Raises:
            ConfigError: It can't, because another library is not installed or does not know it.
        """

    def price(self, dimensions: int) -> str:
        """What its own steps cost, in words, where that is worth saying before; else nothing."""
        return ""

    @property
    def phases(self) -> tuple["Optimiser", ...]:
        """The optimisers that run one after the other, each from the best that was found before."""
        return (self,)

    @property
    def evaluations_per_agent(self) -> int:
        """How many evaluations the cost of one agent, with its gradient if wanted, counts as."""
        return 1

    @property
    def total_iterations(self) -> int:
        """Number of iterations of all phases together."""
        return sum(phase.iterations for phase in self.phases)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of a whole search."""
        return int(self.evaluations_spent()[-1])

    def evaluations_spent(self) -> np.ndarray:
        """Number of evaluations made after each iteration, (total_iterations,)."""
        prices = [phase.agents * phase.evaluations_per_agent for phase in self.phases]
        return np.cumsum(np.repeat(prices, [phase.iterations for phase in self.phases]))

    def changed(self, **settings: Any) -> Self:
        """A copy with other values for some settings, checked."""
        return type(self)(**dict(self) | settings)

    def within(self, evaluations: int) -> Self:
        """A copy with as many iterations as so many evaluations pay for.

        Raises:
            ConfigError: They don't pay for one.
        """
        each = self.agents * self.evaluations_per_agent
        if evaluations < each:
            allowed = f"at least {each}, one iteration of {self.optimiser}"
            raise ConfigError(f"evaluations = {evaluations}; allowed: {allowed}")
        return self.changed(iterations=evaluations // each)

    def resumed(self, asked: "Optimiser") -> Self:
        """The settings with which a search that was begun with these goes on.

        Raises:
            Refused: Those that are asked for now differ in more than a larger number of iterations.
        """
        keys = dict(self) if type(asked) is type(self) else ("optimiser",)
        problems = [
            Violation(key, f"the run has {getattr(self, key)}; allowed: the same", value)
            for key in keys
            if key != "iterations" and (value := getattr(asked, key)) != getattr(self, key)
        ]
        more = asked.iterations - self.iterations
        if more < 0 or (more > 0 and self.fixed_length):
            fixed = self.fixed_length and f"the same, as {self.fixed_length}"
            reason = f"the run has {self.iterations}; allowed: {fixed or 'as many or more'}"
            problems.append(Violation("iterations", reason, asked.iterations))
        if problems:
            raise Refused(*problems)
        return self.changed(iterations=asked.iterations)

    def size_in_words(self, between: str = " x ") -> str:
        """Agents and iterations of all phases, such as "100 agents x 250 iterations"."""
        return ", then ".join(
            f"{counted(phase.agents, phase.agent_noun)}{between}"
            f"{counted(phase.iterations, phase.iteration_noun)}"
            for phase in self.phases
        )


def uniform(key: Array, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Draw from [0, 1) in float32 and cast, so that a key means the same in every dtype."""
    return random.uniform(key, shape, jnp.float32).astype(dtype)
