"""The covariance of the attitude filter (`attitude`), by components: correction and propagation.

The states are the attitude error theta (rad; about east, north, up, R_true = exp(theta^) R), the
error of the gyroscope's bias (rad/s, body frame) and the horizontal velocity's (m/s; east, north).
"""

from collections.abc import Mapping
from functools import partial

import jax.numpy as jnp
from jax import Array

from posegsa.filters.covariance import Covariance, entry_of
from posegsa.model.se3 import Matrix3, Vec3, dot, scale, subtract

EAST, NORTH, UP = 0, 1, 2
"""States of the attitude error, about each axis."""
BIAS, VELOCITY, STATES = 3, 6, 8
"""Index of the first state of the bias and of the velocity, and the number of states."""

Found = tuple[Covariance, tuple[Array, ...]]
"""The covariance and the correction x after the measurements of a sample so far."""


def corrected(found: Found, state: int, residual: Array, noise: Array, weight: Array) -> Found:
    """The covariance and the correction after a measurement of one state.

    Args:
        found: before it.
        state: its index.
        residual: measured minus predicted, without the correction so far.
        noise: the variance of its noise for a weight of 1.
        weight: by which that is divided; 0 where the measurement is missing.
    """
    covariance, x = found
    gain = [entry_of(covariance, i, state) for i in range(STATES)]
    # gain / (variance + noise / weight), without an infinite noise.
    share = weight / (noise + weight * gain[state])
    surprise = share * (residual - x[state])
    return (
        tuple(
            tuple(entry - share * gain[i] * gain[j] for j, entry in enumerate(row, start=i))
            for i, row in enumerate(covariance)
        ),
        tuple(a + surprise * g for a, g in zip(x, gain, strict=True)),
    )


def forgotten(covariance: Covariance, variances: Mapping[int, Array]) -> Covariance:
    """The covariance once states are unknown again, by index with their variances."""

    def entry(i: int, j: int) -> Array:
        if i == j and i in variances:
            return variances[i]
        known = entry_of(covariance, i, j)
        return jnp.zeros_like(known) if i in variances or j in variances else known

    return tuple(tuple(entry(i, j) for j in range(i, STATES)) for i in range(STATES))


def turned_about_up(covariance: Covariance, cosine: Array, sine: Array) -> Covariance:
    """The covariance once east and north are turned: (e, n) <- (c e - s n, s e + c n)."""
    entries = [[entry_of(covariance, i, j) for j in range(STATES)] for i in range(STATES)]
    for east, north in ((EAST, NORTH), (VELOCITY, VELOCITY + 1)):
        for row in entries:
            row[east], row[north] = turned((row[east], row[north]), cosine, sine)
        # Rows after columns: the matrix stays symmetric, and only its upper half is kept.
        pairs = zip(entries[east], entries[north], strict=True)
        columns = [turned(pair, cosine, sine) for pair in pairs]
        entries[east], entries[north] = [a for a, _ in columns], [b for _, b in columns]
    return tuple(tuple(entries[i][i:]) for i in range(STATES))


def turned(level: tuple[Array, Array], cosine: Array, sine: Array) -> tuple[Array, Array]:
    """A vector (east, north) turned about up."""
    east, north = level
    return cosine * east - sine * north, sine * east + cosine * north


def propagated(covariance: Covariance, R: Matrix3, dt: Array, pull: Array) -> Covariance:
    """The covariance after theta <- theta - dt R (error of b) and v <- v + pull (theta x up).

    Args:
        covariance: before it.
        R: rows of the attitude, to east, north, up.
        dt: time step [s].
        pull: time step times gravity [m/s].
    """
    P, axis, both = partial(entry_of, covariance), range(3), range(2)
    M = tuple(scale(dt, row) for row in R)

    def with_bias(i: int) -> Vec3:
        """Covariance of a state with the bias."""
        return P(i, BIAS), P(i, BIAS + 1), P(i, BIAS + 2)

    def with_velocity(i: int) -> tuple[Array, Array]:
        """Covariance of a state with the new velocity."""
        return P(i, VELOCITY) + pull * P(i, NORTH), P(i, VELOCITY + 1) - pull * P(i, EAST)

    x, y, z = (with_bias(BIAS + j) for j in axis)
    turned = [(dot(row, x), dot(row, y), dot(row, z)) for row in M]
    half = [subtract(with_bias(i), scale(0.5, turned[i])) for i in axis]
    twice = [[dot(half[i], M[j]) for j in axis] for i in axis]
    moved = [with_velocity(i) for i in range(STATES)]
    x, y, z = moved[BIAS : BIAS + 3]
    of_velocity = [(x[k], y[k], z[k]) for k in both]  # and the bias
    entries = {
        **{(i, j): P(i, j) - (twice[i][j] + twice[j][i]) for i in axis for j in axis},
        **{(i, BIAS + j): with_bias(i)[j] - turned[i][j] for i in axis for j in axis},
        **{(i, VELOCITY + k): moved[i][k] - dot(M[i], of_velocity[k]) for i in axis for k in both},
        **{(BIAS + i, BIAS + j): P(BIAS + i, BIAS + j) for i in axis for j in axis},
        **{(BIAS + i, VELOCITY + k): moved[BIAS + i][k] for i in axis for k in both},
        (VELOCITY, VELOCITY): moved[VELOCITY][0] + pull * moved[NORTH][0],
        (VELOCITY, VELOCITY + 1): moved[VELOCITY][1] + pull * moved[NORTH][1],
        (VELOCITY + 1, VELOCITY + 1): moved[VELOCITY + 1][1] - pull * moved[EAST][1],
    }
    return tuple(tuple(entries[i, j] for j in range(i, STATES)) for i in range(STATES))
