"""How the filter uses measured vectors: weights, bias removal, normalisation, cross product.

The filter and its error signal use the vectors only through Wahba's attitude profile matrix
B = sum_i s_i u_i v_i^T, with u_i from the measured v_i^B and v_i its reference (G. Wahba, "A Least
Squares Estimate of Satellite Attitude", SIAM Review 7(3), 1965; F. L. Markley, J. L.
Crassidis, "Fundamentals of Spacecraft Attitude Determination and Control", 2014, Eq. 5.5).

If B does not depend on the agent, it is computed once for all agents, and a step costs the same for
2 vectors and for 200. If the filter estimates the vectors' biases, or agents have different
weights, B is computed in each step, by components:

    d_i = v_i^B - c_i,   u_i = d_i / |d_i|,   u_x = (d_1 x d_2) / |d_1 x d_2|

with c_i the estimated bias; without normalisation there are no divisions.
"""

import operator
from dataclasses import dataclass, field
from functools import reduce
from typing import NamedTuple, NoReturn

import jax
import jax.numpy as jnp
from jax import Array

from posegsa.arguments import refuse
from posegsa.model.elementwise import choose, minimum
from posegsa.model.measurements import Measurements
from posegsa.model.se3 import (
    Matrix3,
    Vec3,
    add,
    cross,
    dot,
    safe_sqrt,
    scale,
    subtract,
    unit,
    vec3,
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class VectorSettings:
    """How vectors are used; the numbers are traced, the rest is static."""

    weights: tuple[Array, ...] | None = None
    """s_i^R of each vector; None means 1 for all."""
    cross_weight: Array | float = 0.5
    """s^R of the cross product of the first two vectors."""
    normalise: bool = field(default=True, metadata={"static": True})
    """Whether vectors and references are normalised to length 1 (Eq. 3)."""
    cross: bool = field(default=True, metadata={"static": True})
    """Whether the cross product of the first two vectors is added (Section V of the paper)."""
    each_agent: bool = field(default=False, metadata={"static": True})
    """Whether B depends on the agent, and so is computed in the loop."""


AS_MEASURED = VectorSettings(
    weights=None, cross_weight=0.0, normalise=False, cross=False, each_agent=True
)
"""Settings that leave the vectors as measured."""


class Wahba(NamedTuple):
    """All that the filter and its error signal need from the vectors of a sample."""

    profile: Matrix3
    """B = sum_i s_i u_i v_i^T, by rows."""
    power: Array
    """sum_i s_i (|u_i|^2 + |v_i|^2)."""
    curvature: Array
    """1/2 sum_i s_i |u_i| |v_i|, the vectors' part of the curvature bound L."""
    scale: Array
    """3 / (8 sum_i s_i), 0 where no vector is seen."""

    @property
    def each(self) -> NoReturn:
        """Refused: sums have no single vectors."""
        refuse(
            "sample.vectors.each: of Wahba's sums",
            "in a filter whose `prepare` has VectorSettings(each_agent=True)",
        )


class VectorSample(NamedTuple):
    """One vector in one sample, by components."""

    measured: Vec3
    """v_i^B as measured; arbitrary where it is missing."""
    known: Vec3
    """v_i^I, in the same unit."""
    reference: Vec3
    """v_i^I as used in U: of length 1 if vectors are normalised."""
    factor: Array
    """Factor on its weight, 0 where it is missing."""


class VectorSamples(NamedTuple):
    """The vectors of one sample if Wahba's sums are computed in the loop."""

    each: tuple[VectorSample, ...]
    cross_reference: Vec3
    """v_1^I x v_2^I as used in U; zeros without a cross product."""


def prepare_vectors(measurements: Measurements, settings: VectorSettings) -> Wahba | VectorSamples:
    """What the loop needs from the vectors, with or without a time axis (pure, jittable)."""
    factors = measurements.vector_weights
    # 0 * NaN is NaN, so a missing measurement must be masked, not only weighted.
    body = jnp.where(factors[..., None] > 0, measurements.vectors, 0.0)
    inertial = measurements.vector_references
    count = factors.shape[-1]
    crossed = settings.cross and count >= 2
    if settings.each_agent:
        references = with_cross_vector(inertial) if crossed else inertial
        if settings.normalise:
            references = normalised(references)
        each = tuple(
            VectorSample(
                measured=vec3(body[..., i, :]),
                known=vec3(inertial[..., i, :]),
                reference=vec3(references[..., i, :]),
                factor=factors[..., i],
            )
            for i in range(count)
        )
        nothing = jnp.zeros((*factors.shape[:-1], 3), body.dtype)
        last = references[..., -1, :] if crossed else nothing
        return VectorSamples(each, vec3(last))
    weights = factors
    if settings.weights is not None and count:
        weights = factors * jnp.broadcast_to(jnp.stack(settings.weights), factors.shape)
    if crossed:
        body, inertial = with_cross_vector(body), with_cross_vector(inertial)
        both = settings.cross_weight * jnp.minimum(factors[..., 0], factors[..., 1])
        weights = jnp.concatenate([weights, both[..., None]], axis=-1)
    if settings.normalise:
        body, inertial = normalised(body), normalised(inertial)
    profile = jnp.einsum("...n,...ni,...nj->...ij", weights, body, inertial, precision="highest")
    body_square = jnp.sum(body * body, axis=-1)
    inertial_square = jnp.sum(inertial * inertial, axis=-1)
    lengths = safe_sqrt(body_square) * safe_sqrt(inertial_square)
    return Wahba(
        profile=(vec3(profile[..., 0, :]), vec3(profile[..., 1, :]), vec3(profile[..., 2, :])),
        power=jnp.sum(weights * (body_square + inertial_square), axis=-1),
        curvature=0.5 * jnp.sum(weights * lengths, axis=-1),
        scale=0.375 * inverse_or_zero(jnp.sum(weights, axis=-1)),
    )


def corrected(
    vectors: VectorSamples, biases: tuple[Vec3, ...], settings: VectorSettings
) -> tuple[Wahba, tuple[Vec3, ...]]:
    """Wahba's sums of the vectors less their biases, and d_i = v_i^B - c_i (in the loop).

    Args:
        vectors: as measured.
        biases: c_i of each; () if not estimated.
        settings: weights, normalisation, cross product.
    """
    each = vectors.each
    if not each:
        zeros, zero = vectors.cross_reference, vectors.cross_reference[0]
        return Wahba((zeros, zeros, zeros), power=zero, curvature=zero, scale=zero), ()
    freed = tuple(v.measured for v in each)
    if biases:
        freed = tuple(subtract(d, c) for d, c in zip(freed, biases, strict=True))
    weights = [v.factor for v in each]
    if settings.weights is not None:
        weights = [s * factor for s, factor in zip(settings.weights, weights, strict=True)]
    made, references = list(freed), [v.reference for v in each]
    if settings.cross and len(each) >= 2:
        made.append(cross(freed[0], freed[1]))
        references.append(vectors.cross_reference)
        weights.append(settings.cross_weight * minimum(each[0].factor, each[1].factor))
    if settings.normalise:
        made = [unit(u) for u in made]
    columns = [
        reduce(add, [scale(s * v[j], u) for s, u, v in zip(weights, made, references, strict=True)])
        for j in range(3)
    ]
    total = reduce(operator.add, weights)
    if settings.normalise:
        # All have length 1; missing ones have weight 0.
        power, curvature = 2 * total, 0.5 * total
    else:
        squares = [(dot(u, u), dot(v, v)) for u, v in zip(made, references, strict=True)]
        both = list(zip(weights, squares, strict=True))
        power = reduce(operator.add, [s * (u2 + v2) for s, (u2, v2) in both])
        curvature = 0.5 * reduce(operator.add, [s * safe_sqrt(u2 * v2) for s, (u2, v2) in both])
    rows = tuple(zip(*columns, strict=True))
    wahba = Wahba(
        profile=(rows[0], rows[1], rows[2]),
        power=power,
        curvature=curvature,
        scale=0.375 * choose(total > 0, 1 / choose(total > 0, total, 1.0), 0.0),
    )
    return wahba, freed


def normalised(vectors: Array) -> Array:
    """Vectors (..., 3) of unit length (Eq. 3); a vector of length 0 stays 0."""
    square = jnp.sum(vectors * vectors, axis=-1, keepdims=True)
    return vectors * inverse_or_zero(safe_sqrt(square))


def with_cross_vector(vectors: Array) -> Array:
    """Vectors (..., n, 3) with v_1 x v_2 appended, (..., n + 1, 3) (Section V of the paper)."""
    product = jnp.cross(vectors[..., 0, :], vectors[..., 1, :])
    return jnp.concatenate([vectors, product[..., None, :]], axis=-2)


def inverse_or_zero(a: Array) -> Array:
    """1/a, and 0 where a is 0."""
    return jnp.where(a > 0, 1 / jnp.where(a > 0, a, 1.0), 0.0)
