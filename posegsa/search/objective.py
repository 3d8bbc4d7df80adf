"""What a search minimises, for programs that are compiled for it."""

from typing import NamedTuple

from posegsa import config
from posegsa.optimisers import Differentiable, forward_mode
from posegsa.search.candidates import SearchSpace
from posegsa.search.packing import Packed, packed
from posegsa.search.population import ScenarioBatch, TrackCost, population_costs


class SearchObjective(NamedTuple):
    """What is minimised, but for its scenarios and its parameter space."""

    objective: config.ObjectiveConfig
    axis: str | None
    """Axis of the mesh over which the simulations are divided, if they are."""
    cost: TrackCost | None
    """A user's own cost of a simulation, instead of the configured one."""

    def __call__(
        self, training: Packed, space: SearchSpace, beside: Packed | None
    ) -> Differentiable:
        """As a function of vectors (A, d), on training scenarios, which are `ScenarioBatch`es."""
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
    """Scenarios as the compiled search takes them."""
    return None if batch is None else packed(batch, batch.samples.time)
