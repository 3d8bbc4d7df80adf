"""The gravitational search algorithm: agents attract each other, better ones more strongly.

Source: E. Rashedi, H. Nezamabadi-pour, S. Saryazdi, "GSA: A Gravitational Search Algorithm",
Information Sciences 179 (2009) 2232-2248, and the authors' own code (version 1.1) for details that
the article leaves open. Equation numbers are those of the article; the pose filter paper prints the
algorithm, with changes, as its Eqs. 10 to 16.

Positions are in the unit box, so the gravitational constant is relative to the box: G0 = 100 here
is the same as G0 = 100 (high - low) in a box from low to high. Choose this setting first: the
article's G0 = 100 in [-100, 100] is G0 = 0.5 here, which converges to much smaller costs if the
optimum is at the centre of the box, and stalls if it is not.
"""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import jax.numpy as jnp
import numpy as np
from jax import Array, lax, random
from jax.typing import ArrayLike, DTypeLike
from pydantic import Field

from posegsa.optimisers.ask_tell import FailureCost, Optimiser, uniform
from posegsa.settings.fields import Count, Epsilon, NonNegative

PULL_SECONDS = 1.4e-9
"""Time of one pull in one dimension, on one core of 2.5 GHz [s], measured with 1000 to 8000
agents."""
LONG_STEP = 1.0
"""A longer step is announced by a warning [s]."""

Random = Literal["dimension", "agent"]
Bounds = Literal["redraw", "clip", "reflect"]


class GSAState(NamedTuple):
    """State of the search between two iterations."""

    position: Array  # x (agents, dimensions) in the unit box
    velocity: Array  # v (agents, dimensions) in widths of the box per iteration
    iteration: Array  # it () int32, iterations done
    key: Array  # random key for the next draws


class GSA(Optimiser):
    """The gravitational search algorithm (Rashedi 2009); agents move in the unit box."""

    optimiser: Literal["gsa"] = "gsa"
    """Name of the optimiser."""
    agents: Annotated[Count, Field(ge=2)] = 100
    """Number of agents N."""
    g0: NonNegative = 100.0
    """Gravitational constant at the start, G0, relative to the width of the box."""
    alpha: NonNegative = 20.0
    """Decay of the gravitational constant, G = G0 exp(-alpha it / T), it = 1..T, no unit."""
    force_power: NonNegative = 1.0
    """Power p of the distance in the force, M / (R^p + epsilon): 1 is the authors' choice, 2 is
    Newton's law as the pose filter paper prints it."""
    random: Random = "dimension"
    """Random factors: "dimension" draws one for each pair and dimension in the force and one for
    each agent and dimension in the velocity; "agent" draws one for each agent in the force and one
    in the velocity, as the pose filter paper prints it."""
    bounds: Bounds = "redraw"
    """What happens to a coordinate that leaves the box: "redraw" draws it again uniformly, "clip"
    puts it on the bound, "reflect" mirrors it and reverses its velocity. The first two keep the
    velocity."""
    final_percent: Annotated[float, Field(strict=True, ge=0, le=100)] = 2.0
    """Share of the agents that still attract others in the last iteration [%], at least one agent.
    Their number K_best decreases to it linearly, from all agents."""
    epsilon: Epsilon | Literal["spacing"] = "spacing"
    """Added to R^p, to avoid division by zero; "spacing" is the spacing of floating-point numbers
    at 1, as in the authors' code (which uses float64)."""
    decay_iterations: Count | Literal["all"] = "all"
    """T, after which G and K_best keep their final values; "all" is `iterations`. A run resumed for
    more iterations keeps its first T, so it differs from a run started with as many."""

    title: ClassVar[str] = "The gravitational search algorithm"
    failure_cost: ClassVar[FailureCost] = "worst now"

    def resumed(self, asked: Optimiser) -> Self:
        """As in `Optimiser`; after the original iterations G and K_best stay constant."""
        if isinstance(asked, GSA) and asked.decay_iterations == "all":
            asked = asked.changed(decay_iterations=self.decay_iterations)
        longer = super().resumed(asked)
        if longer.decay_iterations == "all" and longer.iterations > self.iterations:
            return longer.changed(decay_iterations=self.iterations)
        return longer

    def price(self, dimensions: int) -> str:
        """As in `Optimiser`: each of the K_best agents pulls all agents."""
        _, k_best = self.schedule()
        each = PULL_SECONDS * self.agents * dimensions
        first, whole = each * k_best[0], each * k_best.sum()
        if first < LONG_STEP:
            return ""
        return (
            f"search.agents = {self.agents}: GSA's own step takes some {first:.0f} s in the first "
            f"iterations, {whole / 60:.0f} min of the search, without simulations. It grows "
            "with the square of the agents; that of other optimisers, such as de, does not"
        )

    def init(self, key: Array, dimensions: int, dtype: DTypeLike) -> GSAState:
        """Draw the agents uniformly over the unit box, with velocity 0."""
        key, key_position = random.split(key)
        position = uniform(key_position, (self.agents, dimensions), dtype)
        return GSAState(
            position=position,
            velocity=jnp.zeros_like(position),
            iteration=jnp.asarray(0, jnp.int32),
            key=key,
        )

    def tell(self, state: GSAState, costs: Array) -> GSAState:
        """Move the agents under each other's gravity."""
        x, v = state.position, state.velocity
        key, key_force, key_velocity, key_bounds = random.split(state.key, 4)
        now = jnp.minimum(state.iteration, self.iterations - 1)
        gravity, k_best = self.schedule()
        pull = pulls(
            x,
            masses(costs.astype(x.dtype)),
            k_best=jnp.asarray(k_best, jnp.int32)[now],
            rand=self._force_rand(key_force, x),
            force_power=self.force_power,
            epsilon=(float(jnp.finfo(x.dtype).eps) if self.epsilon == "spacing" else self.epsilon),
        )
        a = jnp.asarray(gravity, x.dtype)[now] * pull.T
        columns = 1 if self.random == "agent" else x.shape[1]
        v = uniform(key_velocity, (self.agents, columns), x.dtype) * v + a  # Eq. 11
        x = x + v  # Eq. 12
        x, v = confine(x, v, self.bounds, key_bounds)
        return GSAState(position=x, velocity=v, iteration=state.iteration + 1, key=key)

    def schedule(self) -> tuple[np.ndarray, np.ndarray]:
        """Return G and K_best of each iteration, (iterations,) each.

        Both are computed in float64, in the order of the authors' code, so that K_best is rounded
        the same way for every dtype and device.
        """
        T = self.iterations if self.decay_iterations == "all" else self.decay_iterations
        t = np.minimum(np.arange(1, self.iterations + 1), T) / T
        gravity = self.g0 * np.exp(-self.alpha * t)  # Eq. 28
        percent = self.final_percent + (1 - t) * (100 - self.final_percent)
        k_best = np.floor(self.agents * percent / 100 + 0.5)  # rounds halves up
        return gravity, np.maximum(1, k_best).astype(int)

    def _force_rand(self, key: Array, x: Array) -> Callable[[Array], Array]:
        """Return rand_ij of `pulls`, as a function of the attractor j."""
        agents, dimensions = x.shape
        if self.random == "agent":
            rand = uniform(key, (1, agents), x.dtype)
            return lambda j: rand
        return lambda j: coarse_uniform(random.fold_in(key, j), (dimensions, agents), x.dtype)


def masses(costs: Array) -> Array:
    """Return masses M (agents,) that add up to 1, from finite costs (agents,) (Eqs. 15, 16).

    Better agents are heavier and the worst has mass 0. If all costs are equal, so are the masses.
    """
    costs = costs / 16  # so that no difference overflows and no reciprocal of one underflows
    worst = costs.max()
    spread = worst - costs.min()
    m = jnp.where(spread > 0, (worst - costs) / jnp.where(spread > 0, spread, 1), 1)
    return m / m.sum()


def pulls(
    x: Array,
    mass: Array,
    k_best: ArrayLike,
    rand: Callable[[Array], Array],
    force_power: float,
    epsilon: float,
) -> Array:
    """Sum the pulls of the heaviest agents on every agent (Eqs. 7, 10 and 21, without G).

        a_i / G = sum_{j in K_best} rand_ij M_j (x_j - x_i) / (R_ij^p + epsilon)

    An agent's own mass cancels between force and acceleration, so the worst agent, with mass 0,
    moves too. The sum runs over the attractors one by one, in order of their mass: it stops after
    K_best, and no array of agents x agents x dimensions is stored.

    Args:
        x: Positions (agents, dimensions).
        mass: Masses (agents,).
        k_best: Number of the heaviest agents, which pull.
        rand: Maps an attractor's index j to the random weights rand_ij of its pull on all agents,
            (dimensions, agents) or (1, agents).
        force_power: p.
        epsilon: Added to R^p.

    Returns:
        The sum (dimensions, agents).
    """
    xt = x.T  # agents along the fast axis
    heaviest = jnp.argsort(mass, descending=True)

    def add_pull(rank: Array, total: Array) -> Array:
        j = heaviest[rank]
        towards_j = xt[:, j, None] - xt
        distance = jnp.sqrt(jnp.sum(towards_j**2, axis=0))
        strength = mass[j] / (distance**force_power + epsilon)
        return total + rand(j) * strength[None, :] * towards_j

    return lax.fori_loop(0, k_best, add_pull, jnp.zeros_like(xt))


def confine(x: Array, v: Array, bounds: Bounds, key: Array) -> tuple[Array, Array]:
    """Bring coordinates of x (agents, dimensions) that have left the unit box back into it.

    `GSA.bounds` defines how, and what happens to their velocities v; the key is for "redraw".
    """
    if bounds == "redraw":
        outside = (x < 0) | (x > 1)
        return jnp.where(outside, uniform(key, x.shape, x.dtype), x), v
    if bounds == "clip":
        return jnp.clip(x, 0, 1), v
    path = jnp.mod(x, 2)  # period 2: forth and back
    back = path > 1
    return jnp.where(back, 2 - path, path), jnp.where(back, -v, v)


def coarse_uniform(key: Array, shape: tuple[int, int], dtype: DTypeLike) -> Array:
    """Draw from (0, 1) in steps of 2^-16: enough for a random weight, with a quarter of the work.

    Each hash of the generator gives four numbers. Splitting a key is the only public way to all 64
    bits of a hash: `random.bits` keeps 32 of them, even for 16-bit numbers.
    """
    rows, columns = shape
    words = random.key_data(random.split(key, (-(-rows // 4), columns)))
    quarters = [half for i in (0, 1) for half in (words[..., i] >> 16, words[..., i] & 0xFFFF)]
    return (jnp.concatenate(quarters)[:rows].astype(dtype) + 0.5) / 2**16
