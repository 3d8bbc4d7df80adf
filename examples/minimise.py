"""Minimise your own function
==========================

Any batched JAX function over a box, a whole population at once, by any of the optimisers. Here the
place of an object is found from its distances to four known places. ::

    python examples/minimise.py
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import posegsa

DISTANCES = jnp.array([5.1, 4.4, 3.9, 6.3])  # m, from four known places to an object
PLACES = jnp.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 8.0]])


def cost(positions):
    """Costs (agents,) of possible positions (agents, 2): the sum of squared residuals."""
    away = jnp.linalg.norm(positions[:, None] - PLACES, axis=-1)
    return jnp.sum((away - DISTANCES) ** 2, axis=-1)


def main(iterations=100):
    box = posegsa.box([-10.0, -10.0], [10.0, 10.0])
    optimisers = {
        "gravitational search": posegsa.GSA(agents=50, iterations=iterations),
        "differential evolution": posegsa.DifferentialEvolution(agents=50, iterations=iterations),
        "particle swarm": posegsa.ParticleSwarm(agents=50, iterations=iterations),
        "random search": posegsa.RandomSearch(agents=50, iterations=iterations),
    }
    found = {}
    _, axes = plt.subplots(layout="constrained")
    for name, optimiser in optimisers.items():
        search = posegsa.minimise(cost, box, optimiser, jax.random.key(0))
        found[name] = search
        x, y = search.best_position
        print(f"{name:24} {float(search.best_cost):.6f} at ({float(x):.4f}, {float(y):.4f})")
        axes.semilogy(search.history.best, label=name)
    axes.set(xlabel="iteration", ylabel="best cost so far")
    axes.legend()
    return found


if __name__ == "__main__":
    main()
    plt.show()
