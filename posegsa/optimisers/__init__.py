"""Optimisers that minimise any batched function over a box.

An optimiser is a set of checked settings with three pure methods, `init`, `ask` and `tell`, that
work in the unit box. `minimise` runs an optimiser on an objective. `start` and `advance` are its
two halves, for use inside your own compiled function. `ask` and `tell` are the halves of one step.
"""

from posegsa.optimisers.adam import Adam as Adam
from posegsa.optimisers.ask_tell import Optimiser as Optimiser
from posegsa.optimisers.cma_es import CMAES as CMAES
from posegsa.optimisers.differential_evolution import DifferentialEvolution as DifferentialEvolution
from posegsa.optimisers.driver import in_chunks as in_chunks
from posegsa.optimisers.driver import runner as runner
from posegsa.optimisers.gradient import Differentiable as Differentiable
from posegsa.optimisers.gradient import forward_mode as forward_mode
from posegsa.optimisers.gradient import reverse_mode as reverse_mode
from posegsa.optimisers.gsa import GSA as GSA
from posegsa.optimisers.loop import History as History
from posegsa.optimisers.loop import Search as Search
from posegsa.optimisers.loop import Until as Until
from posegsa.optimisers.loop import advance as advance
from posegsa.optimisers.loop import ask as ask
from posegsa.optimisers.loop import lengthened as lengthened
from posegsa.optimisers.loop import start as start
from posegsa.optimisers.loop import tell as tell
from posegsa.optimisers.minimisation import minimise as minimise
from posegsa.optimisers.particle_swarm import ParticleSwarm as ParticleSwarm
from posegsa.optimisers.polish import Polish as Polish
from posegsa.optimisers.polish import PolishedGSA as PolishedGSA
from posegsa.optimisers.random_search import RandomSearch as RandomSearch
from posegsa.optimisers.search_box import Box as Box
from posegsa.optimisers.search_box import box as box
from posegsa.optimisers.search_box import from_unit as from_unit

OPTIMISERS: dict[str, type[Optimiser]] = {
    kind.model_fields["optimiser"].default: kind
    for kind in (GSA, RandomSearch, ParticleSwarm, DifferentialEvolution, CMAES, Adam, PolishedGSA)
}
"""The optimisers that a configuration can name, by name, the paper's first; to add one, add its
class."""
