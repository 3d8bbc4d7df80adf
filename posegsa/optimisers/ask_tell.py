"""The base class of all optimisers: settings with three pure methods."""

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
"""The cost that an optimiser gets for a position whose cost is not finite, so that the position is
never taken for a good one, now or later:

    "largest": the largest finite number, for optimisers that only compare costs.
    "worst so far": a little more than the worst finite cost of the whole search, or about 1e15 (in
        float64 1e123) before the first, for optimisers that store costs and calculate with them.
    "worst now": the worst finite cost of the iteration, or a little more if all finite costs are
        equal, for optimisers that store no costs; an old, high cost would make the present ones
        look alike.
"""


class Optimiser(Section):
    """Settings of an optimiser, and its three pure methods over an immutable state.

    A subclass adds its settings as fields, `init` and `tell`, and `ask` if its state has no
    `position`. The methods get positions in the unit box and finite costs; the loop
    (`posegsa.optimisers.loop`) ensures both. Settings are checked, frozen and hashable, so that
    they can be static in a compiled function. Those in `posegsa.optimisers.OPTIMISERS` can be named
    in the [search] section of a configuration, which then has their settings.
    """

    optimiser: str = "own"
    """Name of the optimiser."""
    agents: Count = 100
    """Number of positions that are evaluated at once."""
    iterations: Count = 250
    """Number of iterations of a whole search."""

    title: ClassVar[str] = "An optimiser"
    """Its title, to start a sentence with."""
    agent_noun: ClassVar[str] = "agent"
    """Name of one of its agents."""
    iteration_noun: ClassVar[str] = "iteration"
    """Name of one of its iterations."""
    wants_gradients: ClassVar[bool] = False
    """Whether `tell` also gets the gradients of the costs."""
    failure_cost: ClassVar[FailureCost] = "worst so far"
    """The cost that it gets instead of a cost that is not finite."""
    fixed_length: ClassVar[str] = ""
    """Why a search can't be extended to more iterations; empty if it can."""

    @abstractmethod
    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> Any:
        """Return the state before the first `ask`; the state holds the key."""

    def ask(self, state: Any) -> Array:
        """Return the positions (agents, dimensions) in [0, 1] to evaluate next."""
        return state.position

    @abstractmethod
    def tell(self, state: Any, costs: Array, *gradients: Array) -> Any:
        """Return the state updated with the costs (agents,) of the positions of `ask`.

        Gradients (agents, dimensions), if the optimiser wants them, are with respect to the
        positions in the unit box.
        """

    def begin_at(self, state: Any, position: Array) -> Any:
        """Return the state moved to the best position (dimensions,) of the earlier phases."""
        raise NotImplementedError(f"{type(self).__name__} can't begin at a given position")

    def check_usable(self) -> None:
        """Check that the optimiser can run here.

        Raises:
            ConfigError: A library that it needs is not installed.
        """

    def price(self, dimensions: int) -> str:
        """A warning about the time of the optimiser's own steps, or an empty string."""
        return ""

    @property
    def phases(self) -> tuple["Optimiser", ...]:
        """The optimisers that run in sequence, each from the best position found before."""
        return (self,)

    @property
    def evaluations_per_agent(self) -> int:
        """Evaluations that the cost of one agent counts as, with its gradient if wanted."""
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
        """A checked copy with other values for some settings."""
        return type(self)(**dict(self) | settings)

    def within(self, evaluations: int) -> Self:
        """A copy with as many iterations as a number of evaluations allows.

        Raises:
            ConfigError: The evaluations are not enough for one iteration.
        """
        each = self.agents * self.evaluations_per_agent
        if evaluations < each:
            allowed = f"at least {each}, one iteration of {self.optimiser}"
            raise ConfigError(f"evaluations = {evaluations}; allowed: {allowed}")
        return self.changed(iterations=evaluations // each)

    def resumed(self, asked: "Optimiser") -> Self:
        """The settings for resuming a search that was started with these.

        Raises:
            Refused: The settings asked for differ in more than a larger number of iterations.
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
        """Agents and iterations of all phases, for example "100 agents x 250 iterations"."""
        return ", then ".join(
            f"{counted(phase.agents, phase.agent_noun)}{between}"
            f"{counted(phase.iterations, phase.iteration_noun)}"
            for phase in self.phases
        )


def uniform(key: Array, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Draw from [0, 1) in float32 and cast, so that a key gives the same in every dtype."""
    return random.uniform(key, shape, jnp.float32).astype(dtype)
