"""Particle swarm, compared with a loop of the source's equations and with evosax."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evosax.algorithms import PSO
from jax import Array, random

from posegsa.optimisers import Box, ParticleSwarm, box, minimise
from posegsa.optimisers.ask_tell import uniform
from posegsa.optimisers.particle_swarm import INERTIA, PULL


def constriction(phi: float) -> float:
    """Return chi of Clerc and Kennedy (2002, Eq. 4.15 with kappa = 1) for phi = phi1 + phi2 > 4."""
    return 2 / (phi - 2 + math.sqrt(phi**2 - 4 * phi))


def test_constriction_is_the_published_number() -> None:
    # Clerc and Kennedy (2002), Eberhart and Shi (2000): 0.729 for phi = 4.1, pulls 0.729 x 2.05.
    assert constriction(4.1) == pytest.approx(INERTIA, abs=5e-5)
    assert 4.1 * constriction(4.1) / 2 == pytest.approx(PULL, abs=1e-4)
    # The matrix of the swarm has spectral radius sqrt(chi) < 1, so the swarm converges.
    chi = constriction(4.1)
    roots = np.linalg.eigvals([[chi, chi * 4.1], [-chi, 1 - chi * 4.1]])
    assert max(abs(roots)) == pytest.approx(math.sqrt(chi))


def test_the_defaults_are_those_that_were_measured() -> None:
    assert (INERTIA, PULL) == (0.7298, 1.4961), "as the documents' numbers were measured"


@pytest.mark.usefixtures("x64")
def test_steps_against_a_plain_loop() -> None:
    swarm = ParticleSwarm(agents=5, iterations=9, inertia=0.9, cognitive=1.3, social=2.1)
    state = swarm.init(random.key(0), 3, jnp.float64)
    tell = jax.jit(swarm.tell)
    rng = np.random.default_rng(0)
    x, v = np.array(state.position), np.zeros((5, 3))
    p, known = x.copy(), [math.inf] * 5
    left = 0
    for _ in range(6):
        costs = rng.normal(size=5)
        _, key_own, key_all = random.split(state.key, 3)
        r1, r2 = (np.array(uniform(k, (5, 3), jnp.float64)) for k in (key_own, key_all))
        for i in range(5):
            if costs[i] < known[i]:
                p[i], known[i] = x[i], costs[i]
        g = p[min(range(5), key=lambda i: known[i])]
        for i in range(5):
            for d in range(3):
                pull = 1.3 * r1[i, d] * (p[i, d] - x[i, d]) + 2.1 * r2[i, d] * (g[d] - x[i, d])
                v[i, d] = 0.9 * v[i, d] + pull
                x[i, d] += v[i, d]
                if not 0 <= x[i, d] <= 1:
                    x[i, d], v[i, d] = min(max(x[i, d], 0), 1), 0
                    left += 1
        state = tell(state, jnp.asarray(costs))
        np.testing.assert_allclose(swarm.ask(state), x, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(state.velocity, v, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(state.best_position, p, rtol=1e-12, atol=1e-14)
        assert state.best_cost.tolist() == known
    assert left > 0, "the bounds were met"


SEARCHES = 200


@pytest.mark.usefixtures("x64")
def test_it_ends_where_evosaxs_does() -> None:
    """The same inertia, pulls, agents and iterations, over many keys.

    evosax draws r1 and r2 once per agent, not per coordinate, and has no bounds. In one dimension
    the swarms are the same: the mean depths agree within their standard error, which is small
    enough to detect an inertia that is 10 % off.
    """
    swarm = ParticleSwarm(agents=15, iterations=60)
    ours, theirs = _depths(swarm)
    error = math.hypot(ours.std(), theirs.std()) / math.sqrt(SEARCHES)
    assert abs(ours.mean() - theirs.mean()) < 3 * error


def _depths(swarm: ParticleSwarm) -> tuple[np.ndarray, np.ndarray]:
    """Decimal logarithms of both final costs on a parabola off the middle, (SEARCHES,) each."""
    space = box([-1.0], [1.0])
    keys, others = random.split(random.key(2), (2, SEARCHES))
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        theirs = jax.jit(jax.vmap(lambda key: _evosax(swarm, space, key)))(others)
    ours = minimise(_sphere, space, swarm, keys).best_cost
    return np.log10(np.asarray(ours)), np.log10(np.asarray(theirs))


def _sphere(x: Array) -> Array:
    return jnp.sum((x - 0.3) ** 2, axis=1)


def _evosax(swarm: ParticleSwarm, space: Box, key: Array) -> Array:
    """Best cost of evosax's swarm with the same settings."""
    strategy = PSO(population_size=swarm.agents, solution=space.lower)
    params = strategy.default_params.replace(
        inertia_coeff=swarm.inertia, cognitive_coeff=swarm.cognitive, social_coeff=swarm.social
    )
    key_first, key = random.split(key)
    x = random.uniform(key_first, (swarm.agents, len(space.lower)), None, space.lower, space.upper)
    initialised = jax.tree.map(jnp.asarray, strategy.init(key, x, _sphere(x), params))

    def step(state, key):
        x, state = strategy.ask(key, state, params)
        state, _ = strategy.tell(key, x, _sphere(x), state, params)
        return jax.tree.map(lambda a, like: a.astype(like.dtype), state, initialised), None

    end, _ = jax.lax.scan(step, initialised, random.split(key, swarm.iterations - 1))
    return end.best_fitness


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"agents": 1}, "agents = 1\n"),
        ({"inertia": -0.1}, "inertia = -0.1"),
        ({"social": "x"}, "social"),
    ],
)
def test_settings_out_of_range_are_refused(setting: dict, message: str) -> None:
    with pytest.raises(ValueError, match=f"not a valid ParticleSwarm\n\n  {message}"):
        ParticleSwarm(**setting)
