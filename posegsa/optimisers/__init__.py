"""Optimisers that minimise any batched function over a box.

An optimiser is a frozen dataclass of settings with three pure methods, `init`, `ask` and `tell`,
that work in the unit box. `minimise` runs one on an objective; `start` and `advance` are its two
halves, for use inside a compiled function of one's own; `ask` and `tell` are one step taken apart.
"""

from posegsa.optimisers.adam import Adam
from posegsa.optimisers.base import Box, GradientOptimiser, Optimiser, box, from_unit
from posegsa.optimisers.differential_evolution import DifferentialEvolution
from posegsa.optimisers.gradient import Differentiable, forward_mode, reverse_mode
from posegsa.optimisers.gsa import GSA
from posegsa.optimisers.loop import (
    AnyOptimiser,
    History,
    Search,
    Until,
    advance,
    ask,
    evaluations_spent,
    lengthened,
    start,
    tell,
)
from posegsa.optimisers.minimisation import advance_on_host, minimise
from posegsa.optimisers.particle_swarm import ParticleSwarm
from posegsa.optimisers.polish import Polish
from posegsa.optimisers.random_search import RandomSearch

__all__ = [
    "GSA",
    "Adam",
    "AnyOptimiser",
    "Box",
    "Differentiable",
    "DifferentialEvolution",
    "GradientOptimiser",
    "History",
    "Optimiser",
    "ParticleSwarm",
    "Polish",
    "RandomSearch",
    "Search",
    "Until",
    "advance",
    "advance_on_host",
    "ask",
    "box",
    "evaluations_spent",
    "forward_mode",
    "from_unit",
    "lengthened",
    "minimise",
    "reverse_mode",
    "start",
    "tell",
]
