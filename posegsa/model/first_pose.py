"""The start from sensors: the pose that fits the first sample whose measurements fix one."""

import operator
from collections.abc import Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from posegsa.model.elementwise import choose, maximum
from posegsa.model.measurements import Measurements
from posegsa.model.sample import LandmarkSample, prepare
from posegsa.model.se3 import (
    Matrix3,
    Quaternion,
    Vec3,
    add,
    dot,
    rotate,
    rotation_matrix,
    rows,
    scale,
    stack,
    subtract,
    unit,
)
from posegsa.model.sensor_loops import in_turn, stacked
from posegsa.model.vectors import AS_MEASURED, VectorSample

INDEPENDENT = 1e-3
"""Directions fix an attitude if the sum over pairs of their cross products squared is at least
this: two vectors that are 1.8 degrees apart."""
ROUNDING = 128
"""Rounding errors of that sum, in machine epsilons of the square of all lengths squared."""
LIKE_A_DIRECTION = 2.0
"""The error of a landmark [m] that counts as one of 1 rad in a vector's direction: usual sensors
have some 0.1 m and 0.05 rad."""
SQUARINGS = 24
"""Squarings of Davenport's matrix. In the worst accepted case, at INDEPENDENT, its second
eigenvalue is 1 - 2.5e-4 times the largest; 18 squarings would reduce it to 1e-28."""
WAITING_STEP = 1e-6
"""Factor on the time steps before the start: nothing moves, and nothing is divided by 0."""
REST = 1.0
"""Time after the start over which the velocities are averaged, if the body is at rest [s]."""


class Shown(NamedTuple):
    """The pose that one sample shows, by components of any common batch shape."""

    fixed: Array
    """Whether the sample fixes a pose; if not, the rest means nothing."""
    attitude: Quaternion
    """R_est, body to inertial."""
    place: Vec3
    """P_est [m], inertial frame; 0 if there are no landmarks."""


def shown(vectors: Sequence[VectorSample], landmarks: Sequence[LandmarkSample]) -> Shown:
    """The pose that fits the vectors and landmarks of one sample (pure, by components).

    A sample fixes a pose if it has a landmark, unless there are none at all, and two directions
    that are not collinear, as known and as measured: of vectors, and from the landmarks' centre to
    each of them. The attitude solves Wahba's problem for these, vectors of length 1 and landmarks
    in units of LIKE_A_DIRECTION, by Davenport's q method (F. L. Markley, J. L. Crassidis,
    "Fundamentals of Spacecraft Attitude Determination and Control", 2014, section 5.3). So a
    landmark near the centre counts little. The position follows from the centre.

    Args:
        vectors: a factor of 0 marks a missing one, whose numbers must be finite; all others count
            the same.
        landmarks: likewise.
    """
    zero = jnp.zeros_like([*vectors, *landmarks][0].factor)
    nothing = zero, zero, zero
    centre = known_centre = nothing
    none = nothing, nothing, nothing
    sums = Sums(none, none, none)
    if vectors:
        sums, _ = in_turn(_with_vector, sums, stacked(vectors))
    count = zero + 1
    if landmarks:
        (body, inertial, count), _ = in_turn(_total, (nothing, nothing, zero), stacked(landmarks))
        centre, known_centre = (scale(1 / maximum(count, 1.0), one) for one in (body, inertial))
        with_landmark = partial(_with_landmark, centre, known_centre)
        sums, _ = in_turn(with_landmark, sums, stacked(landmarks))
    (size, apart), (seen_size, seen_apart) = _spread(sums.known), _spread(sums.seen)
    q = _best_rotation(sums.profile, 0.5 * (size + seen_size))
    place = subtract(known_centre, rotate(rows(q), centre))
    return Shown(apart & seen_apart & (count > 0), q, place)


class Sums(NamedTuple):
    """Sums over the directions of a sample, u as known and v as measured, by rows."""

    known: Matrix3
    """Of u u^T."""
    seen: Matrix3
    """Of v v^T."""
    profile: Matrix3
    """Of u v^T, Wahba's attitude profile matrix."""


def _with(sums: Sums, known: Vec3, seen: Vec3) -> Sums:
    """The sums with one more direction."""
    pairs = zip(sums, ((known, known), (seen, seen), (known, seen)), strict=True)
    return Sums(*(_plus_product(total, *pair) for total, pair in pairs))


def _plus_product(total: Matrix3, a: Vec3, b: Vec3) -> Matrix3:
    return (
        add(total[0], scale(a[0], b)),
        add(total[1], scale(a[1], b)),
        add(total[2], scale(a[2], b)),
    )


def _with_vector(sums: Sums, one: VectorSample) -> tuple[Sums, None]:
    weight = _is_there(one.factor)
    return _with(sums, scale(weight, unit(one.known)), scale(weight, unit(one.measured))), None


def _with_landmark(
    centre: Vec3, known_centre: Vec3, sums: Sums, one: LandmarkSample
) -> tuple[Sums, None]:
    weight = _is_there(one.factor) / LIKE_A_DIRECTION
    known, seen = subtract(one.inertial, known_centre), subtract(one.body, centre)
    return _with(sums, scale(weight, known), scale(weight, seen)), None


def _total(found: Any, one: LandmarkSample) -> tuple[Any, None]:
    """Sums of the landmarks as measured and as known, and their number."""
    body, inertial, count = found
    weight = _is_there(one.factor)
    seen, known = scale(weight, one.body), scale(weight, one.inertial)
    return (add(body, seen), add(inertial, known), count + weight), None


def _spread(products: Matrix3) -> tuple[Array, Array]:
    """The sum of the squares of directions, and whether these fix an attitude."""
    size = products[0][0] + products[1][1] + products[2][2]
    square = size * size
    apart = 0.5 * (square - reduce(operator.add, (dot(row, row) for row in products)))
    rounding = ROUNDING * float(jnp.finfo(size.dtype).eps)
    return size, apart >= maximum(rounding * square, INDEPENDENT)


def _best_rotation(profile: Matrix3, bound: Array) -> Quaternion:
    """The rotation R with the largest tr(R^T B), B the attitude profile matrix (Wahba's problem).

    It is the eigenvector of the largest eigenvalue of Davenport's matrix. That matrix plus `bound`
    times the identity has no negative eigenvalue; divided by its trace and squared again and again
    it becomes the projection onto the eigenvector.

    Args:
        profile: B = sum of known times measured, transposed, by rows.
        bound: at least the sum of the products of their lengths.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = profile
    share = 0.25 / choose(bound > 0, bound, 1.0)
    K = (
        ((xx + yy + zz), zy - yz, xz - zx, yx - xy),
        (xx - yy - zz, xy + yx, xz + zx),
        (yy - xx - zz, yz + zy),
        (zz - xx - yy,),
    )
    start = tuple(
        tuple(share * entry + (0.25 if j == 0 else 0.0) for j, entry in enumerate(row)) for row in K
    )

    def squared(upper: Any, _: None) -> tuple[Any, None]:
        full = [[upper[min(i, j)][abs(i - j)] for j in range(4)] for i in range(4)]
        square = [[_dot(full[i], full[j]) for j in range(i, 4)] for i in range(4)]
        per_trace = 1 / reduce(operator.add, (row[0] for row in square))
        return tuple(tuple(per_trace * entry for entry in row) for row in square), None

    upper, _ = lax.scan(squared, start, None, SQUARINGS)
    # Each column is the eigenvector; the one with the largest diagonal entry is the longest.
    best, q = upper[0][0], upper[0]
    for i in range(1, 4):
        column = [upper[min(i, j)][abs(i - j)] for j in range(4)]
        longer = upper[i][0] > best
        best = choose(longer, upper[i][0], best)
        q = tuple(choose(longer, new, old) for new, old in zip(column, q, strict=True))
    per_length = 1 / jnp.sqrt(_dot(q, q))
    w, x, y, z = (per_length * entry for entry in q)
    return w, x, y, z


def _dot(a: Sequence[Array], b: Sequence[Array]) -> Array:
    return reduce(operator.add, (x * y for x, y in zip(a, b, strict=True)))


def _is_there(factor: Array) -> Array:
    return choose(factor > 0, jnp.ones_like(factor), 0.0)


class FirstPose(NamedTuple):
    """The start of an estimate that is made from the sensors alone."""

    sample: Array
    """Index of the first sample that fixes a pose; N if none does."""
    rotation: Array
    """(3, 3) R_est, body to inertial."""
    position: Array
    """(3,) P_est [m], inertial frame."""


def first_pose(measurements: Measurements) -> FirstPose:
    """The pose that the first sample shows which fixes one (pure, jittable).

    Args:
        measurements: N samples.
    """
    sample = prepare(measurements, AS_MEASURED)
    fixed = shown(sample.vectors.each, sample.landmarks).fixed
    first = jnp.where(jnp.any(fixed), jnp.argmax(fixed), fixed.shape[0])
    k = jnp.minimum(first, fixed.shape[0] - 1)
    at = jax.tree.map(lambda a: a[k], sample)
    _, q, place = shown(at.vectors.each, at.landmarks)
    return FirstPose(first, rotation_matrix(stack(q)), stack(place))


def waiting_until(measurements: Measurements, sample: Array) -> Measurements:
    """Measurements with which a filter waits: before a sample nothing is seen and nothing moves."""
    count = measurements.time_step.shape[0]
    waits = jnp.arange(count, dtype=sample.dtype) < sample
    none = jnp.where(waits, 0.0, 1.0).astype(measurements.time_step.dtype)
    return measurements._replace(
        time_step=measurements.time_step * jnp.where(waits, WAITING_STEP, 1.0).astype(none.dtype),
        vector_weights=measurements.vector_weights * none[:, None],
        landmark_weights=measurements.landmark_weights * none[:, None],
    )


def bias_at_rest(measurements: Measurements, sample: Array) -> Array:
    """Means (6,) of the velocities over REST after a sample [rad/s, m/s]; at rest, the biases."""
    time = jnp.cumsum(measurements.time_step)
    index = jnp.arange(time.shape[0], dtype=sample.dtype)
    begin = time[jnp.minimum(sample, time.shape[0] - 1)]
    inside = ((index >= sample) & (time < begin + REST)).astype(time.dtype)
    both = jnp.concatenate([measurements.angular_velocity, measurements.velocity], axis=1)
    return inside @ both / jnp.maximum(jnp.sum(inside), 1)
