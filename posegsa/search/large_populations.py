"""Large populations: an iteration made by several compiled calls, one after the other.

A compiled call can't be stopped, and a large population may take minutes for one iteration. So its
costs are made in pieces of bounded work, and the optimiser's own step, where that takes long too,
in its parts (`Optimiser.parts`). Between two of them signals are answered and progress is told.
A search by costs is the same in pieces, to the last bit, with 64 agents or more; with fewer, and by
gradients, a simulation may be rounded otherwise in a piece (`population.partition`).
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh
from jax.typing import ArrayLike

from posegsa.optimisers import Differentiable, Optimiser
from posegsa.search.build import TuningProblem
from posegsa.search.candidates import Candidate, SearchSpace
from posegsa.search.devices import collect, on_each, spread
from posegsa.search.objective import SearchObjective, packed_batch
from posegsa.search.packing import Packed
from posegsa.search.population import PIECE, ScenarioBatch, agent_costs, costs_of_agents

WORK = 50_000_000
"""Most samples that one compiled call simulates on CPUs, agents x scenarios x samples; measured
with the recommended filter on two busy cores of 2.5 GHz, these take 1 to 1.4 s."""
WORK_ACCELERATED = 10 * WORK
"""The same on other devices, which small pieces would leave idle; not measured."""


def is_large(problem: TuningProblem) -> bool:
    """Whether an iteration of a problem's search goes in pieces."""
    return work(problem) > most_work() or any(
        phase.parts(_dimensions(problem)) > 1 for phase in problem.experiment.search.phases
    )


def work(problem: TuningProblem) -> int:
    """Samples that an iteration of a problem's search simulates, of the phase with the most."""
    each = samples(problem)
    return max(
        phase.agents * each * simulations(phase, _dimensions(problem))
        for phase in problem.experiment.search.phases
    )


def most_work() -> int:
    """Most samples that a compiled call is to simulate on the devices that there are."""
    return WORK if jax.default_backend() == "cpu" else WORK_ACCELERATED


def samples(problem: TuningProblem) -> int:
    """Samples that the cost of one agent needs, over all scenarios."""
    return sum(batch.samples.time.size for batch in _batches(problem))


def simulations(phase: Optimiser, dimensions: int) -> int:
    """Simulations of an agent on a scenario; a gradient, by forward mode, takes one for each."""
    return dimensions if phase.wants_gradients else 1


def agents_in_piece(agents: int, each: int, most: int, least: int) -> int:
    """Agents in a piece, all pieces about alike, if one agent is so much work.

    A multiple of `least`, where that many may be more than the most work.
    """
    if agents <= least:
        return agents
    pieces = math.ceil(agents / (max(1, most // (least * each)) * least))
    return min(agents, math.ceil(agents / (pieces * least)) * least)


def scenarios_in_piece(agents: int, scenarios: int, length: int, most: int, least: int) -> int:
    """Scenarios in a piece of so many agents, on S scenarios of N samples: all, if they fit.

    At least `least`, or all, which may be more than the most work.
    """
    pieces = math.ceil(scenarios / max(1, most // (agents * length)))
    return min(scenarios, max(least, math.ceil(scenarios / pieces)))


def places(count: int, size: int) -> list[int]:
    """Where pieces of a size begin that cover so many; the last overlaps the one before it."""
    return [min(begin, count - size) for begin in range(0, count, size)]


Leaves = list[Array]
"""Leaves (A, ...) of the candidates of A agents."""
Agents = Any
"""Search vectors (A, d), or `Leaves` that were made of them; of the host or traced."""


class PiecewiseCosts:
    """The costs of a problem's population, made by several compiled calls."""

    def __init__(
        self,
        problem: TuningProblem,
        objective: SearchObjective,
        mesh: Mesh | None,
        told: Callable[[float], object],
    ) -> None:
        """Make ready.

        Args:
            problem: Its scenarios, its parameter space and its optimiser.
            objective: What is minimised.
            mesh: The devices that share each call.
            told: Called after each call with the share of the iteration that is done; what it
                raises stops the search.
        """
        self._phases = problem.experiment.search.phases
        self._dimensions, self._each = _dimensions(problem), samples(problem)
        self._scenarios = _batches(problem)
        self._space, self._mesh = spread(problem.space, mesh), mesh
        self._objective, self._told = objective, told
        self._packed: dict[tuple[int, int, int], Packed] = {}
        # A compiled loop of one turn is none: its numbers may be rounded otherwise.
        self._turns = 2 * (1 if mesh is None else mesh.size)
        self._done = self._calls = 0

    @property
    def objective(self) -> Differentiable:
        """Both functions below, as `optimisers.advance` takes them."""
        return Differentiable(self.costs, self.costs_and_gradients)

    def costs(self, vectors: ArrayLike) -> Array:
        """Costs (A,) of search vectors (A, d)."""
        given = np.asarray(vectors)
        size = self._agents(len(given), gradients=False)
        begins = places(len(given), size)
        own = (phase.parts(self._dimensions) for phase in self._phases)
        self._done, self._calls = 0, sum(parts for parts in own if parts > 1)
        self._calls += len(begins) * sum(len(groups) for groups in self._groups(size))
        costs = np.empty(len(given), given.dtype)
        agents = self._made(given, size)
        for begin in begins:
            here = slice(begin, begin + size)
            costs[here] = self._costs(given[here], jax.tree.map(lambda a, i=here: a[i], agents))
        return jnp.asarray(costs)

    def _made(self, vectors: np.ndarray, size: int) -> Agents:
        """The agents of vectors (A, d) as a piece of so many takes them.

        A compiled search makes those of a small population where it simulates them, which may round
        otherwise: then the vectors are taken as they are.
        """
        if len(vectors) <= size:
            return vectors
        return jax.tree.map(np.asarray, collect(_candidates(vectors, self._space)))

    def costs_and_gradients(self, vectors: ArrayLike) -> tuple[Array, Array]:
        """Costs (A,) of search vectors (A, d), and their gradients (A, d)."""
        given = np.asarray(vectors)
        size = self._agents(len(given), gradients=True)
        begins = places(len(given), size)
        self._done, self._calls = 0, len(begins)
        costs, gradients = np.empty(len(given), given.dtype), np.empty_like(given)
        for begin in begins:
            here = slice(begin, begin + size)
            costs[here], gradients[here] = self._gradients(given[here])
            self.between()
        return jnp.asarray(costs), jnp.asarray(gradients)

    def between(self) -> None:
        """Say that one more call is done, here or of the optimiser's own step."""
        self._done += 1
        self._told(min(self._done / self._calls, 1.0))

    def compile(self) -> None:
        """Make one piece of each kind, for the time that it takes to compile it."""
        for phase in self._phases:
            size = self._agents(phase.agents, gradients=phase.wants_gradients)
            vectors = np.zeros((phase.agents, self._dimensions), self._space.box.lower.dtype)
            if phase.wants_gradients:
                self._gradients(vectors[:size])
                continue
            agents = jax.tree.map(lambda a, size=size: a[:size], self._made(vectors, size))
            for first, *_ in self._groups(size):
                self._simulated(agents, first)

    def _agents(self, agents: int, *, gradients: bool) -> int:
        """Agents in a piece."""
        if gradients:
            return agents_in_piece(agents, self._each * self._dimensions, most_work(), 1)
        return agents_in_piece(agents, self._each, most_work(), self._turns * PIECE)

    def _groups(self, agents: int) -> list[list[tuple[int, int, int]]]:
        """How each batch of scenarios is cut for pieces of so many agents.

        A group is the number of its batch, its first scenario and the one after its last.
        """
        groups = []
        for number, batch in enumerate(self._scenarios):
            count, length = batch.samples.time.shape
            least = self._turns if agents <= self._turns * PIECE else 1
            size = scenarios_in_piece(agents, count, length, most_work(), least)
            groups.append([(number, begin, begin + size) for begin in places(count, size)])
        return groups

    def _given(self, group: tuple[int, int, int]) -> Packed:
        """The scenarios of a group as programs take them."""
        if group not in self._packed:
            number, begin, end = group
            batch = self._scenarios[number]
            whole = (begin, end) == (0, batch.samples.time.shape[0])
            some = batch if whole else batch.select(slice(begin, end))
            self._packed[group] = spread(packed_batch(some), self._mesh)
        return self._packed[group]

    def _costs(self, vectors: np.ndarray, agents: Agents) -> np.ndarray:
        """Costs (a,) of the vectors (a, d) of a piece, and the agents made of them."""
        found = []
        for batch, groups in zip(self._scenarios, self._groups(len(vectors)), strict=True):
            costs = np.empty((batch.samples.time.shape[0], len(vectors)), vectors.dtype)
            for group in groups:
                costs[slice(*group[1:])] = self._simulated(agents, group)
                self.between()
            found.append(costs)
        training, *beside = found
        further = beside[0] if beside else None
        together = _together(self._objective, vectors, training, further, self._space)
        return np.asarray(collect(together))

    def _simulated(self, agents: Agents, group: tuple[int, int, int]) -> np.ndarray:
        """Costs (s, a) of agents on the scenarios of a group."""
        static = self._objective, self._mesh
        return np.asarray(collect(_simulated(*static, agents, self._given(group), self._space)))

    def _gradients(self, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Costs (a,) and gradients (a, d) of vectors (a, d)."""
        training, *beside = (
            self._given((number, 0, batch.samples.time.shape[0]))
            for number, batch in enumerate(self._scenarios)
        )
        further = beside[0] if beside else None
        static = self._objective, self._mesh
        found = collect(_with_gradients(*static, vectors, training, self._space, further))
        return np.asarray(found[0]), np.asarray(found[1])


@jax.jit
def _candidates(vectors: Any, space: SearchSpace) -> Leaves:
    """The agents of vectors (A, d)."""
    return jax.tree.leaves(jax.vmap(space.candidate)(vectors))


def _candidate_of(leaves: Leaves, space: SearchSpace) -> Candidate:
    """The candidate of leaves (a, ...), inside a compiled function."""
    structure = jax.tree.structure(jax.eval_shape(space.candidate, space.box.lower))
    return jax.tree.unflatten(structure, leaves)


@partial(jax.jit, static_argnums=(0, 1))
def _simulated(
    objective: SearchObjective,
    mesh: Mesh | None,
    agents: Agents,
    packed: Packed,
    space: SearchSpace,
) -> Array:
    """Costs (S, a) of agents, or of vectors (a, d), on S scenarios."""

    def on_device(agents: Agents, packed: Packed, space: SearchSpace) -> Array:
        if isinstance(agents, list):
            made = _candidate_of(agents, space)
        else:
            made = jax.vmap(space.candidate)(agents)
        return agent_costs(made, packed.unpacked(), objective.axis, objective.cost)

    return on_each(mesh)(on_device)(agents, packed, space)


@partial(jax.jit, static_argnums=(0,))
def _together(
    objective: SearchObjective,
    vectors: Any,
    costs: Array,
    further: Array | None,
    space: SearchSpace,
) -> Array:
    """Costs (a,) of vectors (a, d) from those on all scenarios."""
    return costs_of_agents(vectors, costs, further, space, objective.objective)


@partial(jax.jit, static_argnums=(0, 1))
def _with_gradients(
    objective: SearchObjective,
    mesh: Mesh | None,
    vectors: Any,
    training: Packed,
    space: SearchSpace,
    beside: Packed | None,
) -> tuple[Array, Array]:
    """Costs (a,) of vectors (a, d), and their gradients (a, d)."""

    def on_device(
        vectors: Any, training: Packed, space: SearchSpace, beside: Packed | None
    ) -> tuple[Array, Array]:
        return objective(training, space, beside).costs_and_gradients(vectors)

    return on_each(mesh)(on_device)(vectors, training, space, beside)


def _batches(problem: TuningProblem) -> list[ScenarioBatch]:
    """The scenarios of a problem, and those beside them if there are any."""
    return [problem.training, *([] if problem.beside is None else [problem.beside])]


def _dimensions(problem: TuningProblem) -> int:
    return problem.space.box.lower.shape[-1]
