"""The objective of a search, in the form that compiled programs use."""

from typing import NamedTuple

from posegsa import config
from posegsa.optimisers import Differentiable, forward_mode
from posegsa.search.candidates import SearchSpace
from posegsa.search.packing import Packed, packed
from posegsa.search.population import ScenarioBatch, TrackCost, population_costs


class SearchObjective(NamedTuple):
    """The objective without its scenarios and its parameter space."""

    objective: config.ObjectiveConfig
    axis: str | None
    """Mesh axis over which the simulations are divided, or None."""
    cost: TrackCost | None
    """A user's own cost of a simulation, instead of the configured one."""

    def __call__(
        self, training: Packed, space: SearchSpace, beside: Packed | None
    ) -> Differentiable:
        """The cost function of vectors (A, d) on training scenarios (packed `ScenarioBatch`es)."""
        simulated = None if beside is None else beside.unpacked()
        return forward_mode(
            lambda vectors: population_costs(
                vectors,
                training.unpacked(),
                space,
                self.objective,
                self.axis,
                self.cost,
                simulated,
            )
        )


def packed_batch(batch: ScenarioBatch | None) -> Packed | None:
    """Scenarios in the form that the compiled search takes."""
    return None if batch is None else packed(batch, batch.samples.time)
