"""Particle swarm: against a plain loop of the source's equations."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import random

from posegsa.optimisers import ParticleSwarm
from posegsa.optimisers.base import uniform
from posegsa.optimisers.particle_swarm import constriction


def test_constriction_is_the_published_number() -> None:
    # Clerc and Kennedy (2002), Eberhart and Shi (2000): 0.729 for phi = 4.1, pulls 0.729 x 2.05.
    assert constriction(4.1) == pytest.approx(0.7298, abs=5e-5)
    assert 4.1 * constriction(4.1) / 2 == pytest.approx(1.4961, abs=1e-4)
    # The swarm's matrix has spectral radius sqrt(chi) < 1: it neither explodes nor freezes.
    chi = constriction(4.1)
    roots = np.linalg.eigvals([[chi, chi * 4.1], [-chi, 1 - chi * 4.1]])
    assert max(abs(roots)) == pytest.approx(math.sqrt(chi))


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


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"agents": 1}, "agents = 1"),
        ({"inertia": -0.1}, "inertia = -0.1"),
        ({"social": "x"}, "social"),
    ],
)
def test_settings_out_of_range_are_refused(setting: dict, message: str) -> None:
    with pytest.raises(ValueError, match=f"ParticleSwarm: {message}"):
        ParticleSwarm(**setting)
