"""The usual mistakes in recordings, each with the quantities as they would be without it."""

import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posegsa.recordings.frames import GRAVITY, UP, Frame
from posegsa.recordings.relations import AXES, Quantities, Vector, misfits, north_of
from posegsa.recordings.rotations import matrices, quaternions, to_east_north_up

FITS, FITTED = 0.35, 0.1
"""Largest misfit, without the mistake, of the relation that improves most; and where numbers are
taken from the data to undo it."""
LENGTHS = ("cm", 100.0), ("mm", 1000.0)
"""Units that are taken for metres, with their number in a metre."""
MIRRORED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""From north-east-down to east-north-up, and back."""
TURNING, MOVING, TRUTH = "gyroscope|velocities", "velocity|velocities", "truth"
"""Names of the relations of the gyroscope, of the velocity and of the truth."""


class Hypothesis(NamedTuple):
    """A mistake, and the quantities as they would be without it."""

    words: str
    """What seems wrong, and what to do."""
    mended: Callable[[Quantities], Quantities]
    """Maps quantities to those without the mistake."""
    complexity: int
    """How much it changes; of equally good ones the simplest is named."""
    of: str
    """Regular expression of the names of the relations that it is about."""
    fits: float = FITS
    """Largest misfit of the relation that improves most, without the mistake."""


def hypotheses(q: Quantities) -> Iterator[Hypothesis]:
    """All mistakes that the relations of these quantities can reveal."""
    degree = math.pi / 180
    yield Hypothesis(
        "angular_velocity looks like deg/s: divide by 57.3",
        lambda q: q.changed(gyroscope=q.gyroscope * degree),
        1,
        TURNING,
    )
    yield Hypothesis(
        "angular_velocity looks as if it had been divided by 57.3 once too often: multiply by that",
        lambda q: q.changed(gyroscope=q.gyroscope / degree),
        1,
        TURNING,
    )
    for k, axis in enumerate(AXES):
        yield Hypothesis(
            f"the {axis} axis of angular_velocity alone looks like deg/s: divide it by 57.3",
            lambda q, k=k: q.changed(
                gyroscope=q.gyroscope * np.where(np.arange(3) == k, degree, 1.0)
            ),
            2,
            TURNING,
        )
    for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        yield Hypothesis(
            f'the time stamps look like {unit}: set time_unit = "{unit}" in the TOML file beside '
            "the recording",
            lambda q, factor=factor: q.changed(time=q.time * factor),
            1,
            f"{TURNING}|{MOVING}",
        )
    for words, sign in _turned_axes():
        yield Hypothesis(
            f"angular_velocity: {words}",
            lambda q, sign=sign: q.changed(gyroscope=q.gyroscope @ sign.T),
            _changes(sign),
            TURNING,
        )
    if q.velocity is not None:
        for unit, factor in (("km/h", 3.6), ("cm/s", 100.0), ("mm/s", 1000.0)):
            yield Hypothesis(
                f"velocity looks like {unit}: divide by {factor:g}",
                lambda q, factor=factor: q.changed(velocity=_of(q.velocity) / factor),
                1,
                MOVING,
            )
        for words, sign in _turned_axes():
            yield Hypothesis(
                f"velocity: {words}",
                lambda q, sign=sign: q.changed(velocity=_of(q.velocity) @ sign.T),
                _changes(sign),
                MOVING,
            )
    if q.rotation is not None:
        yield from _of_truth(q)
    for i, vector in enumerate(q.vectors):
        yield from _of_vector(q, i, vector)
    for i, j in itertools.combinations(range(len(q.vectors)), 2):
        yield Hypothesis(
            f"{q.vectors[i].name} and {q.vectors[j].name} look exchanged: exchange their columns, "
            "or their references",
            lambda q, i=i, j=j: _with_vectors_exchanged(q, i, j),
            2,
            f"{re.escape(q.vectors[i].name)}|{re.escape(q.vectors[j].name)}",
        )
    yield from _of_landmarks(q)


def _of(a: np.ndarray | None) -> np.ndarray:
    assert a is not None
    return a


def _of_truth(q: Quantities) -> Iterator[Hypothesis]:
    yield Hypothesis(
        "the true rotation looks inverse: it must map body to inertial coordinates (transpose it, "
        "or conjugate the quaternion)",
        lambda q: q.changed(rotation=_of(q.rotation).transpose(0, 2, 1)),
        1,
        TRUTH,
    )
    yield Hypothesis(
        "the true quaternion looks as if its scalar came last: posegsa reads (w, x, y, z)",
        lambda q: q.changed(rotation=_scalar_last(_of(q.rotation))),
        1,
        TRUTH,
    )
    yield Hypothesis(
        "the true quaternion looks inverse and as if its scalar came last: posegsa reads "
        "(w, x, y, z), body to inertial",
        lambda q: q.changed(rotation=_scalar_last(_of(q.rotation)).transpose(0, 2, 1)),
        3,
        TRUTH,
    )
    for words, axes in _turned_axes():
        if np.linalg.det(axes) > 0:
            yield Hypothesis(
                "the true rotation looks like that of other body axes than the sensors': its "
                f"(x, y, z) are their {words.split('should be ')[-1].rstrip(')')})",
                lambda q, axes=axes: q.changed(rotation=_of(q.rotation) @ axes),
                2,
                TRUTH,
            )
    yield Hypothesis(
        "angular_velocity looks as if it were in the inertial frame: the filter needs it in the "
        "body frame, R^T omega",
        lambda q: q.changed(gyroscope=_all_to_body(q, q.gyroscope)),
        1,
        TURNING,
    )
    if q.position is not None:
        for unit, factor in LENGTHS:
            yield Hypothesis(
                f"the true position looks like {unit}: divide by {factor:g}",
                lambda q, factor=factor: q.changed(position=_of(q.position) / factor),
                1,
                TRUTH,
            )
        yield Hypothesis(
            "the true position looks north-east-down, not east-north-up like the rest: (x, y, z) "
            "is (y, x, -z) in the other",
            lambda q: q.changed(position=_of(q.position) @ MIRRORED),
            2,
            TRUTH,
        )
    yield from _of_frame(q)
    if (frame := _frame_of_references(q)) is not None:
        turn, offset, words = frame
        yield Hypothesis(
            f"the truth looks as if it were in another inertial frame than the references: {words}",
            lambda q: q.changed(
                rotation=turn @ _of(q.rotation),
                position=None if q.position is None else q.position @ turn.T + offset,
            ),
            5,
            TRUTH,
            FITTED,
        )
    if q.velocity is not None:
        yield Hypothesis(
            "velocity looks as if it were in the inertial frame: the filter needs it in the body "
            "frame, R^T v",
            lambda q: q.changed(velocity=_all_to_body(q, _of(q.velocity))),
            1,
            MOVING,
        )


def _of_frame(q: Quantities) -> Iterator[Hypothesis]:
    """Other inertial frames that the truth of an inertial sensor may be in.

    Where no field shows north, only the other way up: of those frames one fits as well as another,
    and so does an accelerometer of the wrong sign.
    """
    if (assumed := q.frame) is None:
        return
    others: list[Frame] = [frame for frame in UP if frame != assumed]
    looks: dict[Frame, tuple[str, str]]
    if any(north_of(each) in misfits(q) for each in q.vectors):
        looks = {frame: (f"{frame}, not {assumed}", "") for frame in others}
    else:
        over: list[Frame] = [frame for frame in others if UP[frame] != UP[assumed]]
        way = "down" if over == ["NED"] else "up"
        sign = ". Or the accelerometer measures downwards at rest: then change its sign"
        looks = {over[0]: (f"a frame whose z axis points {way} ({' or '.join(over)})", sign)}
    for frame, (words, also) in looks.items():
        turn = to_east_north_up(assumed).T @ to_east_north_up(frame)
        yield Hypothesis(
            f'the truth looks like {words}: --frame {frame}, or the line frame = "{frame}" in the '
            f"TOML file beside the recording{also}",
            lambda q, turn=turn: q.changed(
                rotation=turn @ _of(q.rotation),
                position=None if q.position is None else q.position @ turn.T,
            ),
            0,
            TRUTH,
        )


def _of_vector(q: Quantities, i: int, vector: Vector) -> Iterator[Hypothesis]:
    def with_body(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Quantities], Quantities]:
        return lambda q: _with_vector(q, i, replace(q.vectors[i], body=change(q.vectors[i].body)))

    about = re.escape(vector.name)
    for words, sign in _turned_axes():
        yield Hypothesis(
            f"{vector.name}: {words}",
            with_body(lambda b, sign=sign: b @ sign.T),
            _changes(sign),
            about,
        )
    if vector.reference is None:
        return
    down = ": an accelerometer at rest measures upwards" if vector.is_up else ""
    yield Hypothesis(
        f"{vector.name} and its reference look opposite{down}: change the sign of one",
        with_body(np.negative),
        1,
        about,
    )
    reference = vector.reference
    yield Hypothesis(
        f"the reference of {vector.name} looks mirrored, north-east-down for east-north-up: "
        "(x, y, z) is (y, x, -z) in the other",
        lambda q: _with_vector(q, i, replace(q.vectors[i], reference=reference @ MIRRORED)),
        2,
        about,
    )
    for factor, words in (
        (GRAVITY, f"multiples of g: multiply by {GRAVITY}, or give it a reference of length 1"),
        (1 / GRAVITY, f"m/s^2: divide by {GRAVITY}, or give it a reference of that length"),
    ):
        yield Hypothesis(
            f"{vector.name} looks like {words}",
            with_body(lambda b, factor=factor: factor * b),
            1,
            about,
        )
    if q.rotation is not None:
        yield Hypothesis(
            f"{vector.name} and its reference look exchanged: the first is measured in the body "
            "frame, the second constant in the inertial frame",
            lambda q: _with_vector(
                q, i, replace(q.vectors[i], body=_to_body(q, q.vectors[i].body))
            ),
            2,
            about,
        )
    fixed = _constant(reference)
    points = None if vector.is_up or fixed is None else _mean_direction(q, vector)
    if fixed is not None and points is not None:
        points *= np.linalg.norm(fixed) / max(float(np.linalg.norm(points)), 1e-12)
        yield Hypothesis(
            f"the reference of {vector.name} looks wrong: by the truth it points to "
            f"{_numbers(points)}, {_angle_about_z(fixed, points):.0f} deg about the vertical "
            "from there",
            lambda q, points=points: _with_vector(q, i, replace(q.vectors[i], reference=points)),
            4,
            about,
            FITTED,
        )
    if q.rotation is not None and _lacks_gravity(q, vector):
        yield Hypothesis(
            f"{vector.name} looks like an acceleration without gravity: the filter needs what the "
            "sensor measures, gravity included",
            lambda q: _with_vector(
                q,
                i,
                replace(
                    q.vectors[i],
                    body=q.vectors[i].body
                    + _to_body(q, np.broadcast_to(reference, q.vectors[i].body.shape)),
                ),
            ),
            2,
            about,
        )


def _lacks_gravity(q: Quantities, vector: Vector) -> bool:
    """Whether a vector's mean direction is not that of its reference.

    Accelerations, impacts included, cancel in the mean: only gravity remains of a specific force.
    """
    if misfits(q).get(f"{vector.name} and truth", 0.0) <= FITS:
        return False
    reference = np.broadcast_to(_of(vector.reference), vector.body.shape)
    along = np.sum(_to_body(q, reference) * vector.body, axis=1)
    return bool(np.nanmean(along) < 0.5 * np.mean(np.sum(reference**2, axis=1)))


def _of_landmarks(q: Quantities) -> Iterator[Hypothesis]:
    count, about = len(q.places), "landmark"
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield Hypothesis(
            f"landmarks {i} and {j} look exchanged: exchange their columns, or their references",
            lambda q, order=order: q.changed(places=tuple(q.places[k] for k in order)),
            1,
            about,
        )
    if count and q.rotation is not None:
        yield Hypothesis(
            "the landmarks look as if they were measured in the inertial frame, p - P: the filter "
            "needs them in the body frame, R^T (p - P)",
            lambda q: q.changed(landmarks=tuple(_to_body(q, y) for y in q.landmarks)),
            1,
            about,
        )
        if q.position is not None:
            yield Hypothesis(
                "the landmarks look like their positions in the inertial frame: the filter needs "
                "what the body sees, R^T (p - P)",
                lambda q: q.changed(
                    landmarks=tuple(_to_body(q, y - _of(q.position)) for y in q.landmarks)
                ),
                2,
                about,
            )
    if count:
        yield Hypothesis(
            "the references of the landmarks look mirrored, north-east-down for east-north-up: "
            "(x, y, z) is (y, x, -z) in the other",
            lambda q: q.changed(places=tuple(place @ MIRRORED for place in q.places)),
            2,
            about,
        )
        for unit, factor in LENGTHS:
            yield Hypothesis(
                f"landmarks look like {unit}: divide by {factor:g}",
                lambda q, factor=factor: q.changed(
                    landmarks=tuple(y / factor for y in q.landmarks)
                ),
                1,
                about,
            )
        for words, sign in _turned_axes():
            yield Hypothesis(
                f"landmarks: {words}",
                lambda q, sign=sign: q.changed(landmarks=tuple(y @ sign.T for y in q.landmarks)),
                _changes(sign),
                about,
            )
    if count > 1:
        for j in range(count):
            yield from _of_one_landmark(q, j)


def _of_one_landmark(q: Quantities, j: int) -> Iterator[Hypothesis]:
    about = rf"landmarks? (\d+ and )?{j}\b"
    for unit, factor in LENGTHS:
        yield Hypothesis(
            f"landmark {j} looks like {unit}: divide by {factor:g}",
            lambda q, factor=factor: _with_landmark(q, j, q.landmarks[j] / factor),
            2,
            about,
        )
    if q.rotation is not None:
        yield Hypothesis(
            f"landmark {j} looks as if it were measured in the inertial frame, p - P: the filter "
            "needs it in the body frame, R^T (p - P)",
            lambda q: _with_landmark(q, j, _to_body(q, q.landmarks[j])),
            2,
            about,
        )
    if (seen := _places_seen(q)) is not None and np.isfinite(seen[j]).all(axis=1).any():
        place = np.nanmedian(seen[j], axis=0)
        yield Hypothesis(
            f"the reference of landmark {j} looks wrong: by the truth it is at {_numbers(place)}, "
            f"{np.linalg.norm(place - q.places[j]):.3g} m from there",
            lambda q: q.changed(places=(*q.places[:j], place, *q.places[j + 1 :])),
            4,
            about,
            FITTED,
        )
    for words, sign in _turned_axes():
        yield Hypothesis(
            f"landmark {j}: {words}",
            lambda q, sign=sign: _with_landmark(q, j, q.landmarks[j] @ sign.T),
            2 + _changes(sign),
            about,
        )


def _places_seen(q: Quantities) -> list[np.ndarray] | None:
    """Where each landmark was seen (K, 3), inertial frame of the truth; None without a pose."""
    if q.rotation is None or q.position is None:
        return None
    return [q.position + np.einsum("kij,kj->ki", q.rotation, y) for y in q.landmarks]


def _frame_of_references(q: Quantities) -> tuple[np.ndarray, np.ndarray, str] | None:
    """From the truth's inertial frame to the references': a turn about z, an offset, in words.

    None if it takes more than one vector and one landmark to tell it from a wrong reference.
    """
    seen, known = [], []
    for vector in q.vectors:
        reference = None if vector.reference is None else _constant(vector.reference)
        if reference is None or vector.is_up or not reference.any():
            continue
        mean = _mean_direction(q, vector)
        if mean is None:
            continue
        seen.append(mean / np.linalg.norm(reference))
        known.append(reference / np.linalg.norm(reference))
    places = _places_seen(q) or []
    at = [np.nanmedian(y, axis=0) if np.isfinite(y).any() else np.full(3, np.nan) for y in places]
    there = [j for j, place in enumerate(at) if np.isfinite(place).all()]
    offset = np.zeros(3)
    if there:
        mean, own = (np.mean([p[j] for j in there], axis=0) for p in (at, q.places))
        seen += [at[j] - mean for j in there]
        known += [q.places[j] - own for j in there]
    if len(seen) < 2 or not np.isfinite(seen).all():
        return None
    a, b = np.array(seen)[:, :2], np.array(known)[:, :2]
    angle = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    words = f"turn it by {math.degrees(angle):.0f} deg about the vertical"
    if there:
        offset = own - turn @ mean
        words += f", then shift it by {_numbers(offset)} m"
    return turn, offset, words


def _mean_direction(q: Quantities, vector: Vector) -> np.ndarray | None:
    """Mean (3,) of what is measured of a vector, inertial frame; None without a truth there."""
    if q.rotation is None:
        return None
    seen = np.einsum("kij,kj->ki", q.rotation, vector.body)
    seen = seen[np.isfinite(seen).all(axis=1)]
    return np.mean(seen, axis=0) if len(seen) else None


def _constant(reference: np.ndarray) -> np.ndarray | None:
    """A reference (3,) of all samples; None if it changes."""
    each = np.atleast_2d(reference)
    return None if np.any(np.ptp(each, axis=0)) else each[0]


def _numbers(a: np.ndarray) -> str:
    """A vector (3,), to be read."""
    return f"({', '.join(f'{x:.3g}' for x in np.round(a, 3) + 0.0)})"


def _angle_about_z(a: np.ndarray, b: np.ndarray) -> float:
    """Angle about z from vector a to b [deg]."""
    turned = math.atan2(b[1], b[0]) - math.atan2(a[1], a[0])
    return math.degrees(math.remainder(turned, 2 * math.pi))


def _turned_axes() -> Iterator[tuple[str, np.ndarray]]:
    """All ways to exchange axes and to change their signs, with words; without the identity.

    The matrix maps recorded to measured values.
    """
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.array_equal(matrix, np.eye(3)):
                continue
            parts = [f"{'-' if s < 0 else ''}{AXES[k]}" for k, s in zip(order, signs, strict=True)]
            flipped = [AXES[k] for k, s in zip(order, signs, strict=True) if s < 0]
            if order == (0, 1, 2) and len(flipped) == 1:
                words = f"the sign of its {flipped[0]} axis looks wrong"
            else:
                words = f"its axes look exchanged: (x, y, z) should be ({', '.join(parts)})"
            yield words, matrix


def _changes(matrix: np.ndarray) -> int:
    """How many axes are exchanged or change sign."""
    return int(np.sum(np.diag(matrix) != 1)) + int(np.sum(matrix < 0))


def _to_body(q: Quantities, inertial: np.ndarray) -> np.ndarray:
    """R^T of vectors (K, 3)."""
    return np.einsum("kji,kj->ki", _of(q.rotation), inertial)


def _all_to_body(q: Quantities, inertial: np.ndarray) -> np.ndarray:
    """R^T of velocities (K, 3), which are integrated: by the R last known where it is not."""
    R = _of(q.rotation)
    known = np.isfinite(R).all(axis=(1, 2))
    last = np.maximum.accumulate(np.where(known, np.arange(len(R)), known.argmax()))
    return np.einsum("kji,kj->ki", R[last], inertial)


def _scalar_last(R: np.ndarray) -> np.ndarray:
    """Rotations whose quaternions were read as (w, x, y, z) and are (x, y, z, w)."""
    known = np.isfinite(R).all(axis=(1, 2))
    found = np.full(R.shape, np.nan)
    found[known] = matrices(quaternions(R[known])[:, [3, 0, 1, 2]])
    return found


def _with_vector(q: Quantities, i: int, vector: Vector) -> Quantities:
    return q.changed(vectors=(*q.vectors[:i], vector, *q.vectors[i + 1 :]))


def _with_vectors_exchanged(q: Quantities, i: int, j: int) -> Quantities:
    one, other = q.vectors[i], q.vectors[j]
    q = _with_vector(q, i, replace(one, body=other.body))
    return _with_vector(q, j, replace(other, body=one.body))


def _with_landmark(q: Quantities, j: int, seen: np.ndarray) -> Quantities:
    return q.changed(landmarks=(*q.landmarks[:j], seen, *q.landmarks[j + 1 :]))
