"""The optimisers that a configuration can name; to add one, add its class to the list."""

from posegsa.optimisers.adam import Adam
from posegsa.optimisers.ask_tell import Optimiser
from posegsa.optimisers.cma_es import CMAES
from posegsa.optimisers.differential_evolution import DifferentialEvolution
from posegsa.optimisers.gsa import GSA
from posegsa.optimisers.particle_swarm import ParticleSwarm
from posegsa.optimisers.polish import PolishedGSA
from posegsa.optimisers.random_search import RandomSearch

_KINDS = (
    GSA,
    RandomSearch,
    ParticleSwarm,
    DifferentialEvolution,
    CMAES,
    Adam,
    PolishedGSA,
)
OPTIMISERS: dict[str, type[Optimiser]] = {
    kind.model_fields["optimiser"].default: kind for kind in _KINDS
}
"""Optimisers by name, the paper's first."""
