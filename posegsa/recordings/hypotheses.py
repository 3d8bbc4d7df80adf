"""The usual mistakes in recordings, each with the quantities as they would be without it."""

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posegsa.recordings.frames import GRAVITY, UP, Frame
from posegsa.recordings.relations import AXES, Quantities, Vector, given, misfits, north_of
from posegsa.recordings.rotations import matrices, quaternions, to_east_north_up

MAX_MISFIT, MAX_MISFIT_OF_FIT = 0.35, 0.1
"""Largest misfit that may remain, in the relation that improves most, once a mistake is undone; and
once it is undone with numbers that are fitted to the data."""
LENGTHS = ("cm", 100.0), ("mm", 1000.0)
"""Units that are taken for metres, with their number in a metre."""
MIRRORED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""From north-east-down to east-north-up, and back."""
TRUTH = "truth"
"""Name of the relations of the truth."""
Change = Callable[[np.ndarray], np.ndarray]


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
    fits: float = MAX_MISFIT
    """Largest misfit of the relation that improves most, without the mistake."""


class _Part(NamedTuple):
    """A part of the quantities whose numbers may be mistaken."""

    name: str
    of: str
    """As in `Hypothesis`."""
    changed: Callable[[Quantities, Change], Quantities]
    """Applies a function to its numbers."""

    def mistake(self, words: str, change: Change, complexity: int = 1) -> Hypothesis:
        """A mistake that a function of its numbers undoes."""
        return Hypothesis(words, lambda q: self.changed(q, change), complexity, self.of)

    def units(
        self, looks: str, units: Iterable[tuple[str, float]], complexity: int = 1
    ) -> Iterator[Hypothesis]:
        """Other units, each with its number in the right one."""
        for unit, factor in units:
            words = f"{self.name} {looks} like {unit}: divide by {factor:g}"
            yield self.mistake(words, lambda a, factor=factor: a / factor, complexity)

    def axes(self, more: int = 0) -> Iterator[Hypothesis]:
        """All ways to exchange its axes and to change their signs; `more` adds to complexity."""
        for words, sign in _turned_axes():
            yield self.mistake(
                f"{self.name}: {words}", lambda a, sign=sign: a @ sign.T, more + _changes(sign)
            )


def _field(name: str, of: str, field: str) -> _Part:
    """A field of the quantities as a part."""
    return _Part(name, of, lambda q, change: q.changed(**{field: change(getattr(q, field))}))


GYROSCOPE = _field("angular_velocity", "gyroscope|velocities", "gyroscope")
VELOCITY = _field("velocity", "velocity|velocities", "velocity")
TIME = _field("the time stamps", f"{GYROSCOPE.of}|{VELOCITY.of}", "time")
ROTATION = _field("the true rotation", TRUTH, "rotation")
POSITION = _field("the true position", TRUTH, "position")
LANDMARKS = _Part(
    "landmarks",
    "landmark",
    lambda q, change: q.changed(landmarks=tuple(map(change, q.landmarks))),
)


def hypotheses(q: Quantities) -> Iterator[Hypothesis]:
    """All mistakes that the relations of these quantities can reveal."""
    degree = math.pi / 180
    yield GYROSCOPE.mistake(
        "angular_velocity looks like deg/s: divide by 57.3", lambda w: w * degree
    )
    yield GYROSCOPE.mistake(
        "angular_velocity looks as if it had been divided by 57.3 once too often: multiply by that",
        lambda w: w / degree,
    )
    for k, axis in enumerate(AXES):
        yield GYROSCOPE.mistake(
            f"the {axis} axis of angular_velocity alone looks like deg/s: divide it by 57.3",
            lambda w, k=k: w * np.where(np.arange(3) == k, degree, 1.0),
            2,
        )
    for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        yield TIME.mistake(
            f'the time stamps look like {unit}: set time_unit = "{unit}" in the TOML file beside '
            "the recording",
            lambda t, factor=factor: t * factor,
        )
    yield from GYROSCOPE.axes()
    if q.velocity is not None:
        yield from VELOCITY.units("looks", (("km/h", 3.6), ("cm/s", 100.0), ("mm/s", 1000.0)))
        yield from VELOCITY.axes()
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


def _of_truth(q: Quantities) -> Iterator[Hypothesis]:
    yield ROTATION.mistake(
        "the true rotation looks inverse: it must map body to inertial coordinates (transpose it, "
        "or conjugate the quaternion)",
        lambda R: R.transpose(0, 2, 1),
    )
    yield ROTATION.mistake(
        "the true quaternion looks as if its scalar came last: posegsa reads (w, x, y, z)",
        _scalar_last,
    )
    yield ROTATION.mistake(
        "the true quaternion looks inverse and as if its scalar came last: posegsa reads "
        "(w, x, y, z), body to inertial",
        lambda R: _scalar_last(R).transpose(0, 2, 1),
        3,
    )
    for words, axes in _turned_axes():
        if np.linalg.det(axes) > 0:
            yield ROTATION.mistake(
                "the true rotation looks like that of other body axes than the sensors': its "
                f"(x, y, z) are their {words.split('should be ')[-1].rstrip(')')})",
                lambda R, axes=axes: R @ axes,
                2,
            )
    yield GYROSCOPE.mistake(
        "angular_velocity looks as if it were in the inertial frame: the filter needs it in the "
        "body frame, R^T omega",
        lambda w: _all_to_body(q, w),
    )
    if q.position is not None:
        yield from POSITION.units("looks", LENGTHS)
        yield POSITION.mistake(
            "the true position looks north-east-down, not east-north-up like the rest: (x, y, z) "
            "is (y, x, -z) in the other",
            lambda P: P @ MIRRORED,
            2,
        )
    yield from _of_frame(q)
    if (frame := _frame_of_references(q)) is not None:
        turn, offset, words = frame
        yield Hypothesis(
            f"the truth looks as if it were in another inertial frame than the references: {words}",
            lambda q: _in_frame(q, turn, offset),
            5,
            TRUTH,
            MAX_MISFIT_OF_FIT,
        )
    if q.velocity is not None:
        yield VELOCITY.mistake(
            "velocity looks as if it were in the inertial frame: the filter needs it in the body "
            "frame, R^T v",
            lambda v: _all_to_body(q, v),
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
            lambda q, turn=turn: _in_frame(q, turn, np.zeros(3)),
            0,
            TRUTH,
        )


def _in_frame(q: Quantities, turn: np.ndarray, offset: np.ndarray) -> Quantities:
    """Quantities with the truth in another inertial frame: turned, then shifted."""
    P = q.position
    return q.changed(
        rotation=turn @ given(q.rotation), position=None if P is None else P @ turn.T + offset
    )


def _of_vector(q: Quantities, i: int, vector: Vector) -> Iterator[Hypothesis]:
    def changed(q: Quantities, change: Change) -> Quantities:
        return _with_vector(q, i, replace(q.vectors[i], body=change(q.vectors[i].body)))

    part = _Part(vector.name, re.escape(vector.name), changed)
    yield from part.axes()
    if vector.reference is None:
        return
    down = ": an accelerometer at rest measures upwards" if vector.is_up else ""
    yield part.mistake(
        f"{vector.name} and its reference look opposite{down}: change the sign of one", np.negative
    )
    reference = vector.reference
    yield Hypothesis(
        f"the reference of {vector.name} looks mirrored, north-east-down for east-north-up: "
        "(x, y, z) is (y, x, -z) in the other",
        lambda q: _with_vector(q, i, replace(q.vectors[i], reference=reference @ MIRRORED)),
        2,
        part.of,
    )
    for factor, words in (
        (GRAVITY, f"multiples of g: multiply by {GRAVITY}, or give it a reference of length 1"),
        (1 / GRAVITY, f"m/s^2: divide by {GRAVITY}, or give it a reference of that length"),
    ):
        yield part.mistake(f"{vector.name} looks like {words}", lambda b, factor=factor: factor * b)
    if q.rotation is not None:
        yield part.mistake(
            f"{vector.name} and its reference look exchanged: the first is measured in the body "
            "frame, the second constant in the inertial frame",
            lambda b: _to_body(q, b),
            2,
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
            part.of,
            MAX_MISFIT_OF_FIT,
        )
    if q.rotation is not None and _lacks_gravity(q, vector):
        yield part.mistake(
            f"{vector.name} looks like an acceleration without gravity: the filter needs what the "
            "sensor measures, gravity included",
            lambda b: b + _to_body(q, np.broadcast_to(reference, b.shape)),
            2,
        )


def _lacks_gravity(q: Quantities, vector: Vector) -> bool:
    """Whether a vector's mean direction is not that of its reference.

    Accelerations, impacts included, cancel in the mean: only gravity remains of a specific force.
    """
    if misfits(q).get(f"{vector.name} and truth", 0.0) <= MAX_MISFIT:
        return False
    reference = np.broadcast_to(given(vector.reference), vector.body.shape)
    along = np.sum(_to_body(q, reference) * vector.body, axis=1)
    return bool(np.nanmean(along) < 0.5 * np.mean(np.sum(reference**2, axis=1)))


def _of_landmarks(q: Quantities) -> Iterator[Hypothesis]:
    count = len(q.places)
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield Hypothesis(
            f"landmarks {i} and {j} look exchanged: exchange their columns, or their references",
            lambda q, order=order: q.changed(places=tuple(q.places[k] for k in order)),
            1,
            LANDMARKS.of,
        )
    if count and q.rotation is not None:
        yield LANDMARKS.mistake(
            "the landmarks look as if they were measured in the inertial frame, p - P: the filter "
            "needs them in the body frame, R^T (p - P)",
            lambda y: _to_body(q, y),
        )
        if q.position is not None:
            yield LANDMARKS.mistake(
                "the landmarks look like their positions in the inertial frame: the filter needs "
                "what the body sees, R^T (p - P)",
                lambda y: _to_body(q, y - given(q.position)),
                2,
            )
    if count:
        yield Hypothesis(
            "the references of the landmarks look mirrored, north-east-down for east-north-up: "
            "(x, y, z) is (y, x, -z) in the other",
            lambda q: q.changed(places=tuple(place @ MIRRORED for place in q.places)),
            2,
            LANDMARKS.of,
        )
        yield from LANDMARKS.units("look", LENGTHS)
        yield from LANDMARKS.axes()
    if count > 1:
        for j in range(count):
            yield from _of_one_landmark(q, j)


def _of_one_landmark(q: Quantities, j: int) -> Iterator[Hypothesis]:
    def changed(q: Quantities, change: Change) -> Quantities:
        seen = change(q.landmarks[j])
        return q.changed(landmarks=(*q.landmarks[:j], seen, *q.landmarks[j + 1 :]))

    part = _Part(f"landmark {j}", rf"landmarks? (\d+ and )?{j}\b", changed)
    yield from part.units("looks", LENGTHS, 2)
    if q.rotation is not None:
        yield part.mistake(
            f"landmark {j} looks as if it were measured in the inertial frame, p - P: the filter "
            "needs it in the body frame, R^T (p - P)",
            lambda y: _to_body(q, y),
            2,
        )
    if (seen := _places_seen(q)) is not None and np.isfinite(seen[j]).all(axis=1).any():
        place = np.nanmedian(seen[j], axis=0)
        yield Hypothesis(
            f"the reference of landmark {j} looks wrong: by the truth it is at {_numbers(place)}, "
            f"{np.linalg.norm(place - q.places[j]):.3g} m from there",
            lambda q: q.changed(places=(*q.places[:j], place, *q.places[j + 1 :])),
            4,
            part.of,
            MAX_MISFIT_OF_FIT,
        )
    yield from part.axes(more=2)


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
    return np.einsum("kji,kj->ki", given(q.rotation), inertial)


def _all_to_body(q: Quantities, inertial: np.ndarray) -> np.ndarray:
    """R^T of velocities (K, 3), which are integrated: by the R last known where it is not."""
    R = given(q.rotation)
    known = np.isfinite(R).all(axis=(1, 2))
    last = np.maximum.accumulate(np.where(known, np.arange(len(R)), known.argmax()))
    return np.einsum("kji,kj->ki", R[last], inertial)


def _scalar_last(R: np.ndarray) -> np.ndarray:
    """Rotations whose quaternions were read as (w, x, y, z) and are (x, y, z, w)."""
    known = np.where(np.isfinite(R), R, np.nan)
    return matrices(quaternions(known)[:, [3, 0, 1, 2]])


def _with_vector(q: Quantities, i: int, vector: Vector) -> Quantities:
    return q.changed(vectors=(*q.vectors[:i], vector, *q.vectors[i + 1 :]))


def _with_vectors_exchanged(q: Quantities, i: int, j: int) -> Quantities:
    one, other = q.vectors[i], q.vectors[j]
    q = _with_vector(q, i, replace(one, body=other.body))
    return _with_vector(q, j, replace(other, body=one.body))
