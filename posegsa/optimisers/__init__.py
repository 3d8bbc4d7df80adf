"""Optimisers that minimise any batched function over a box.

An optimiser is a set of checked settings with three pure methods, `init`, `ask` and `tell`, that
work in the unit box. `minimise` runs one on an objective; `start` and `advance` are its two halves,
for use inside a compiled function of one's own; `ask` and `tell` are one step taken apart.
"""

from posegsa.optimisers.adam import Adam
from posegsa.optimisers.base import Optimiser
from posegsa.optimisers.differential_evolution import DifferentialEvolution
from posegsa.optimisers.driver import in_chunks, runner
from posegsa.optimisers.evosax import CMAES, Evosax
from posegsa.optimisers.gradient import Differentiable, forward_mode, reverse_mode
from posegsa.optimisers.gsa import GSA
from posegsa.optimisers.loop import History, Search, Until, advance, ask, lengthened, start, tell
from posegsa.optimisers.minimisation import minimise
from posegsa.optimisers.particle_swarm import ParticleSwarm
from posegsa.optimisers.polish import Polish, PolishedGSA
from posegsa.optimisers.pycma import PyCMA
from posegsa.optimisers.random_search import RandomSearch
from posegsa.optimisers.registry import OPTIMISERS
from posegsa.optimisers.search_box import Box, box, from_unit

__all__ = [
    "CMAES",
    "GSA",
    "OPTIMISERS",
    "Adam",
    "Box",
    "Differentiable",
    "DifferentialEvolution",
    "Evosax",
    "History",
    "Optimiser",
    "ParticleSwarm",
    "Polish",
    "PolishedGSA",
    "PyCMA",
    "RandomSearch",
    "Search",
    "Until",
    "advance",
    "ask",
    "box",
    "forward_mode",
    "from_unit",
    "in_chunks",
    "lengthened",
    "minimise",
    "reverse_mode",
    "runner",
    "start",
    "tell",
]
