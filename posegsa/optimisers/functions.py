"""Classical test functions, as objectives with a box and a known minimum of 0.

Sources: X. Yao, Y. Liu, G. Lin, "Evolutionary Programming Made Faster", IEEE Trans. Evolutionary
Computation 3 (1999) 82-102 (sphere, Rosenbrock, Schwefel 2.26, Rastrigin, Ackley, Griewank and
their boxes); N. Hansen et al., "Real-Parameter Black-Box Optimization Benchmarking", 2009 (the
ellipsoid).

Many optimisers find the middle of the box, or a point on an axis, more easily than other points. A
shifted function has its minimum off the middle; a rotated function has other axes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from posegsa.arguments import check_number, check_whole, refuse
from posegsa.optimisers.search_box import Box, box

_SCHWEFEL = 420.96874633  # the z in [-500, 500] at which z sin(sqrt(|z|)) is largest
_SCHWEFEL_TOP = 418.98288727  # its value there


def sphere(z: Array) -> Array:
    """Sum of squares."""
    return jnp.sum(z**2, axis=-1)


def ellipsoid(z: Array) -> Array:
    """Sum of squares with weights from 1 to 10^6."""
    d = z.shape[-1]
    weights = jnp.asarray(np.logspace(0, 6, d), z.dtype)
    return jnp.einsum("...d,d->...", z**2, weights, precision="highest")


def rosenbrock(z: Array) -> Array:
    """A curved valley, flat along its floor; minimum at 1."""
    a, b = z[..., :-1], z[..., 1:]
    return jnp.sum(100 * (b - a**2) ** 2 + (1 - a) ** 2, axis=-1)


def rastrigin(z: Array) -> Array:
    """A bowl with a local minimum near every point with integer coordinates."""
    # 10 (1 - cos 2 pi z), in a form without cancellation near 0; likewise in Ackley's function.
    return jnp.sum(z**2 + 20 * jnp.sin(math.pi * z) ** 2, axis=-1)


def ackley(z: Array) -> Array:
    """A plain with small bumps and one deep hole."""
    distance = jnp.sqrt(jnp.mean(z**2, axis=-1))
    bumps = -2 * jnp.mean(jnp.sin(math.pi * z) ** 2, axis=-1)
    return -20 * jnp.expm1(-0.2 * distance) - math.e * jnp.expm1(bumps)


def griewank(z: Array) -> Array:
    """A wide bowl with many regular bumps."""
    root = jnp.asarray(np.sqrt(np.arange(1, z.shape[-1] + 1)), z.dtype)
    waves = jnp.prod(jnp.cos(z / jnp.broadcast_to(root, z.shape)), axis=-1)
    return jnp.sum(z**2, axis=-1) / 4000 + (1 - waves)


def schwefel(z: Array) -> Array:
    """Schwefel's function 2.26: deep holes far from each other, the best near a corner.

    Outside the box, where the formula falls further, it rises with the square of the distance.
    """
    inside = jnp.clip(z, -500, 500)
    outside = jnp.sum((z - inside) ** 2, axis=-1)
    return jnp.sum(_SCHWEFEL_TOP - inside * jnp.sin(jnp.sqrt(jnp.abs(inside))), axis=-1) + outside


class _Classical(NamedTuple):
    formula: Callable[[Array], Array]
    limit: float  # the box is [-limit, limit] in every dimension
    minimum: float  # every coordinate of the minimum


_CLASSICAL = {
    "sphere": _Classical(sphere, 100, 0),
    "ellipsoid": _Classical(ellipsoid, 100, 0),
    "rosenbrock": _Classical(rosenbrock, 30, 1),
    "rastrigin": _Classical(rastrigin, 5.12, 0),
    "ackley": _Classical(ackley, 32, 0),
    "griewank": _Classical(griewank, 600, 0),
    "schwefel": _Classical(schwefel, 500, _SCHWEFEL),
}
FUNCTIONS = tuple(_CLASSICAL)
"""Names of the functions."""
MAX_DIMENSIONS = 5000
"""Maximum dimension of a test function: a rotation matrix then takes 200 MB."""


@dataclass(frozen=True)
class ClassicalFunction:
    """A test function; call it with positions (agents, dimensions) for costs (agents,).

    Raises:
        ArgumentError: An attribute is out of range, or the minimum would leave the box.
    """

    name: str
    dimensions: int
    shift: float = 0.0
    """Shift of the minimum in every coordinate, in half widths of the box."""
    rotation: int | None = None
    """Seed of a random rotation about the minimum; None for no rotation."""

    def __post_init__(self) -> None:
        if self.name not in FUNCTIONS:
            refuse(f"function: name = {self.name!r}", " or ".join(map(repr, FUNCTIONS)))
        check_whole("function: dimensions", self.dimensions, 2, MAX_DIMENSIONS)
        check_number("function: shift", self.shift, -1, 1)
        if self.rotation is not None:
            check_whole("function: rotation", self.rotation, 0)
        _, limit, minimum = _CLASSICAL[self.name]
        if abs(minimum + self.shift * limit) > limit:
            low, high = -1 - minimum / limit, 1 - minimum / limit
            refuse(
                f"function: shift = {self.shift} takes the minimum of {self.name} out of its box",
                f"{low:.3g} to {high:.3g}",
            )

    @property
    def box(self) -> Box:
        """The function's box."""
        limit = np.full(self.dimensions, _CLASSICAL[self.name].limit)
        return box(-limit, limit)

    @property
    def minimum(self) -> np.ndarray:
        """Position of the minimum (dimensions,)."""
        _, limit, minimum = _CLASSICAL[self.name]
        return np.full(self.dimensions, minimum + self.shift * limit)

    @property
    def title(self) -> str:
        """Its name, dimension, shift and rotation as text."""
        words = [f"{self.name}, {self.dimensions} dimensions"]
        if self.shift:
            words.append(f"shifted by {self.shift:g} half widths")
        if self.rotation is not None:
            words.append(f"rotated (seed {self.rotation})")
        return ", ".join(words)

    def __call__(self, positions: Array) -> Array:
        """Return the costs (agents,) of positions (agents, dimensions)."""
        formula, _, minimum = _CLASSICAL[self.name]
        away = positions - jnp.asarray(self.minimum, positions.dtype)[None, :]
        if self.rotation is not None:
            turn = jnp.asarray(_random_rotation(self.dimensions, self.rotation), positions.dtype)
            away = jnp.einsum("ij,aj->ai", turn, away, precision="highest")
        return formula(away + minimum)


def _random_rotation(dimensions: int, seed: int) -> np.ndarray:
    """A rotation or reflection (d, d), uniform over all of them: QR of a Gaussian matrix."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(dimensions, dimensions)))
    return q * np.sign(np.diag(r))
