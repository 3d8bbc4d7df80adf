"""The covariance of a Kalman filter by components: measurements, and changes of coordinates.

Like all of the hot loop it is written by components, which XLA fuses into one vectorised kernel.
The equations are those of `filters.kalman`.
"""

import operator
from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import chain
from typing import Literal, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.model.elementwise import choose, maximum
from posegsa.model.se3 import (
    Matrix3,
    Quaternion,
    Vec3,
    cross,
    dot,
    move,
    rows,
    scale,
    stack,
    subtract,
    unrotate,
)

Covariance: TypeAlias = tuple[tuple[Array, ...], ...]
"""Upper triangle of a symmetric matrix: row i holds its entries (i, i), (i, i + 1), ..., each an
array of the batch shape. One kernel takes 0.1 us per filter and sample with 12 states, 0.2 us with
18, on one core, for the paper's three sensors. Sensors of a kind are a loop, so that the compile
time does not depend on how many there are.
"""

Reset: TypeAlias = Literal["off", "two frames"]
"""How the covariance is carried to the coordinates of a corrected estimate (`transported`)."""

Row: TypeAlias = dict[int, Array | float]
"""A row of a sparse matrix: its nonzero entries by column."""

SMALLEST_CUT = 128
"""One scalar measurement leaves at least this share of a variance, in machine epsilons. Less than
one epsilon, 1e-7 in float32, would leave only rounding errors of either sign."""

LONGEST_MOVE = 100.0
"""Length of a position correction above which its effect on the covariance is limited [m]."""

POSE, ANGULAR, LINEAR, VECTORS = 0, 6, 9, 12
"""Index of the first state of the pose, of the velocities' biases and of the vectors' biases."""


class Found(NamedTuple):
    """Result of the measurements of a sample that have been processed so far."""

    covariance: Covariance
    correction: tuple[Array, ...]
    """x, the estimated errors of all states; applied to the estimate after the last measurement."""
    nis: Array
    """Normalised innovation squared: the sum over all scalars of their innovation squared over its
    variance, each innovation after the scalars before it."""
    scalars: Array
    """How many scalars have been measured, the degrees of freedom of `nis`."""


def entry_of(covariance: Covariance, i: int, j: int) -> Array:
    """Entry (i, j), on either side of the diagonal."""
    return covariance[i][j - i] if i <= j else covariance[j][i - j]


def matrix(covariance: Covariance, count: int) -> Array:
    """The first `count` rows and columns, (..., count, count)."""
    every = range(count)
    return jnp.stack([stack(tuple(entry_of(covariance, i, j) for j in every)) for i in every], -2)


def product(row: Row, column: Callable[[int], Array]) -> Array:
    """A sparse row times a column, which is a function from index to entry."""
    return reduce(operator.add, (factor * column(j) for j, factor in row.items()))


@jax.jit  # traced once for all programs; XLA inlines it
def by_components(
    found: Found, each: Sequence[Row], residual: Vec3, variance: Array, factor: Array
) -> Found:
    """Covariance and correction x of the states after a sensor's scalars h x = residual + noise.

    Each scalar is a measurement of its own, after those before it. What these took off the
    covariance is taken off the next one's gain; off the covariance itself only once, for all
    together, so that its many numbers are read and written once a sensor. Outer products of one
    vector with itself are subtracted, so the covariance stays symmetric.

    Args:
        found: before it.
        each: the derivatives h of each scalar.
        residual: measured minus predicted with x = 0.
        variance: of each component's noise.
        factor: 0 where the measurement is missing.
    """
    covariance, correction, nis, scalars = found
    every = range(len(covariance))
    gains: list[list[Array]] = []
    parts: list[list[Array]] = []
    for h, off in zip(each, residual, strict=True):
        # Sigma h^T: the Kalman gain times `total`.
        gain = [product(h, lambda j, i=i, h=h: entry_of(covariance, i, j)) for i in every]
        for earlier, part in zip(gains, parts, strict=True):
            taken = product(h, part.__getitem__)
            gain = [g - taken * e for g, e in zip(gain, earlier, strict=True)]
        own = product(h, gain.__getitem__)
        smallest = SMALLEST_CUT * float(jnp.finfo(own.dtype).eps)
        total = own + maximum(variance, smallest * own)
        used = (factor > 0) & (total > 0)
        per_total = choose(used, 1 / choose(used, total, 1.0), 0.0)
        innovation = off - product(h, correction.__getitem__)
        surprise = per_total * innovation
        nis = nis + surprise * innovation
        scalars = scalars + choose(used, jnp.ones_like(scalars), 0.0)
        correction = tuple(x + surprise * g for x, g in zip(correction, gain, strict=True))
        gains.append(gain)
        parts.append([per_total * g for g in gain])

    def cut(entry: Array, i: int, j: int) -> Array:
        for part, gain in zip(parts, gains, strict=True):
            entry = entry - part[i] * gain[j]
        return entry

    covariance = tuple(
        tuple(cut(entry, i, j) for j, entry in enumerate(row, start=i))
        for i, row in enumerate(covariance)
    )
    return Found(covariance, correction, nis, scalars)


def next_vector_first(found: Found) -> Found:
    """The same with the vectors' bias states in rotated order: the second vector comes first.

    So the loop over vectors always finds the states of its vector in the same place; after the last
    vector they are back in their original order.
    """
    order = list(range(VECTORS))
    biases = range(VECTORS, len(found.covariance))
    order += [*biases[3:], *biases[:3]]
    covariance = tuple(
        tuple(entry_of(found.covariance, order[i], order[j]) for j in range(i, len(order)))
        for i in range(len(order))
    )
    correction = tuple(found.correction[i] for i in order)
    return found._replace(covariance=covariance, correction=correction)


def _whole_way(correction: Sequence[Array]) -> tuple[Quaternion, Vec3]:
    """exp(x^) of the pose's part of a correction x, by which it moves the estimate."""
    tx, ty, tz, *rho = correction[:ANGULAR]
    zero = jnp.zeros_like(tx)
    one = zero + 1
    shift = _limited((rho[0], rho[1], rho[2]))
    return move((one, zero, zero, zero), (zero, zero, zero), (tx, ty, tz), shift)


def _limited(shift: Vec3) -> Vec3:
    """A correction of the position, at most LONGEST_MOVE.

    In float32 a jump by kilometres, from garbage, would leave only rounding errors in the
    covariance.
    """
    return scale(1 / jnp.sqrt(1 + dot(shift, shift) / LONGEST_MOVE**2), shift)


def _with_turned_biases(covariance: Covariance, R: Matrix3) -> Covariance:
    """The covariance after each bias is turned, b <- R^T b."""
    every = range(len(covariance))

    def turned(column: Sequence[Array]) -> list[Array]:
        of_biases = range(ANGULAR, len(column), 3)
        return [*column[:ANGULAR], *chain(*(unrotate(R, _three(column, i)) for i in of_biases))]

    by_column = [turned([entry_of(covariance, i, j) for i in every]) for j in every]
    by_row = [turned([by_column[j][i] for j in every]) for i in every]
    return tuple(tuple(by_row[i][i:]) for i in every)


def _three(numbers: Sequence[Array], first: int) -> Vec3:
    return numbers[first], numbers[first + 1], numbers[first + 2]


def _turned(covariance: Covariance, R: Matrix3, P: Vec3) -> Covariance:
    """The covariance after xi <- Ad((R, P)^-1) xi."""
    every = range(len(covariance))
    left = [_adjoint(R, P, [entry_of(covariance, i, j) for i in range(ANGULAR)]) for j in every]
    pose = [_adjoint(R, P, [left[j][i] for j in range(ANGULAR)]) for i in range(ANGULAR)]
    return tuple(
        tuple(pose[i][j] if j < ANGULAR else left[j][i] for j in every[i:])
        if i < ANGULAR
        else covariance[i]
        for i in every
    )


@partial(jax.jit, static_argnames="reset")  # traced once for all programs; XLA inlines it
def transported(
    covariance: Covariance,
    correction: Sequence[Array],
    omega: Vec3,
    v: Vec3,
    dt: Array,
    reset: Reset = "off",
) -> Covariance:
    """The covariance after xi <- A xi - 1/2 (I + A) dt b, A = Ad(exp(-[omega; v]^)) (rad, m).

    In three steps, which take half the products of one: xi <- xi - dt/2 b, A xi, xi - dt/2 b.

    With the reset "two frames" of a correction x each bias is turned before, b <- exp(-[x_theta]x)
    b, and A has the factor Ad(exp(-x^)). The factor also multiplies the term of b, where it
    does not belong; that error is of second order in correction and time step.
    """
    zero, one, half = jnp.zeros_like(dt), jnp.ones_like(dt), 0.5 * dt
    begin = ((one, zero, zero, zero), (zero, zero, zero))
    if reset == "two frames":
        begin = _whole_way(correction)
        covariance = _with_turned_biases(covariance, rows(begin[0]))
    q, P = move(*begin, omega, v)
    return _less_bias(_turned(_less_bias(covariance, half), rows(q), P), half)


def _less_bias(covariance: Covariance, factor: Array) -> Covariance:
    """The covariance after xi <- xi - factor b."""
    every, pose = range(len(covariance)), range(ANGULAR)
    beside = [
        [entry_of(covariance, i, j) - factor * entry_of(covariance, ANGULAR + i, j) for j in every]
        for i in pose
    ]  # the biases' columns are complete, those of xi lack the bias's share
    return tuple(
        tuple(
            beside[i][j] - factor * beside[i][ANGULAR + j] if j < ANGULAR else beside[i][j]
            for j in every[i:]
        )
        if i < ANGULAR
        else covariance[i]
        for i in every
    )


def _adjoint(R: Matrix3, P: Vec3, xi: Sequence[Array]) -> tuple[Array, ...]:
    """[R^T theta; R^T (rho - P x theta)] of xi = [theta; rho], the inverse adjoint of (R, P)."""
    theta, rho = (xi[0], xi[1], xi[2]), (xi[3], xi[4], xi[5])
    return unrotate(R, theta) + unrotate(R, subtract(rho, cross(P, theta)))
