"""The search: the optimiser, its size, and a section of settings for each optimiser."""

from typing import Annotated, Literal

from pydantic import Field

from posegsa.optimisers.particle_swarm import INERTIA, PULL
from posegsa.settings.fields import MAX_COUNT, Count, NonNegative, Positive, Section

OptimiserName = Literal[
    "gsa", "random_search", "pso", "de", "adam", "gsa+adam", "cma_es", "evosax", "pycma"
]
Share = Annotated[float, Field(strict=True, ge=0, le=1)]


class SearchConfig(Section):
    """[search]: the optimiser and its size."""

    optimiser: OptimiserName = "gsa"
    """What searches: the gravitational search algorithm; points drawn at random; particle swarm;
    differential evolution; gradient descent from many starts; the first and then the last of these;
    or, from other libraries (the extra `posegsa[compare]`), "cma_es" and "evosax" for CMA-ES and
    the strategy named in [evosax], "pycma" for the CMA-ES of its author."""
    agents: Annotated[int, Field(strict=True, ge=2, le=MAX_COUNT)] = 100
    """Number of agents N: parameter vectors that are evaluated at once."""
    iterations: Count = 250
    """Number of iterations T. Gradient descent makes as many as agents x iterations evaluations
    pay for, at adam.gradient_price."""


class GsaConfig(Section):
    """[gsa]: the gravitational search algorithm (Rashedi 2009); agents move in the unit box."""

    g0: Positive = 100.0
    """Gravitational constant at the start, G0, relative to the width of the box."""
    alpha: NonNegative = 20.0
    """Decay of the gravitational constant, G = G0 exp(-alpha it / T), no unit."""
    force_power: Positive = 1.0
    """Power p of the distance in the force, M / (R^p + eps); the paper prints 2."""
    random: Literal["dimension", "agent"] = "dimension"
    """Whether random factors are drawn per dimension, or one per agent, as the paper prints."""
    bounds: Literal["redraw", "clip", "reflect"] = "redraw"
    """What happens to a coordinate that leaves the box."""
    final_percent: Annotated[float, Field(strict=True, gt=0, le=100)] = 2.0
    """Share of the agents that still attract others at the end [%]."""
    decay_iterations: Count | Literal["all"] = "all"
    """T in G and in the number of agents that attract, both of which hold their final values past
    it; "all" is search.iterations. A run that was resumed for more iterations keeps its first T, so
    that it is not the longer run."""


class PsoConfig(Section):
    """[pso]: particle swarm (Clerc and Kennedy 2002); agents move in the unit box."""

    inertia: NonNegative = INERTIA
    """Share w of its velocity that a particle keeps, no unit."""
    cognitive: NonNegative = PULL
    """Pull c1 of a particle's own best place, no unit."""
    social: NonNegative = PULL
    """Pull c2 of the best place of all, no unit."""


class DeConfig(Section):
    """[de]: differential evolution (Storn and Price 1997)."""

    strategy: Literal["rand/1/bin", "best/1/bin"] = "rand/1/bin"
    """Where a mutant starts from: a random agent, or the best."""
    factor: Annotated[float, Field(strict=True, ge=0, le=2)] = 0.5
    """Weight F of the difference of two agents, no unit."""
    crossover: Share = 0.9
    """Probability CR that a coordinate comes from the mutant."""


class AdamConfig(Section):
    """[adam]: gradient descent (Kingma and Ba 2015) in the unit box."""

    starts: Count = 8
    """Number of starts that descend side by side."""
    learning_rate: Positive = 0.03
    """Length of the first steps of each coordinate, in widths of the box; it falls to 0."""
    gradient_price: Count = 23
    """How many evaluations a cost with its gradient counts as: 1 and 22 for the parameters."""
    share: Annotated[float, Field(strict=True, gt=0, lt=1)] = 0.5
    """Of "gsa+adam": share of the evaluations that the descent gets."""
    spread: Share = 0.05
    """Of "gsa+adam": how far from the best agent the other starts lie, in widths of the box."""


class EvosaxConfig(Section):
    """[evosax]: a strategy of the evosax library, in the unit box."""

    strategy: Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_]+$")] = "CMA_ES"
    """Its name there."""
    sigma: Positive = 0.3
    """Standard deviation at the start, in widths of the box, of strategies that have one."""


class PycmaConfig(Section):
    """[pycma]: CMA-ES of the pycma library, in the unit box."""

    sigma: Positive = 0.3
    """Standard deviation at the start, in widths of the box."""
