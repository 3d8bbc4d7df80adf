"""Relations that the quantities of a recording must fulfil, and how far they miss them.

A body that turns and moves ties its sensors together. Over an interval of HORIZON the gyroscope
gives a turn dR and the velocity a displacement dP in the body frame of its beginning, and

    turn and truth       R1 = R0 dR                      vector and turn     b1 = dR^T b0
    velocity and truth   P1 = P0 + R0 dP                 landmark and motion y1 = dR^T (y0 - dP)
    vector and truth     R b = r                         two vectors         b_i . b_j = r_i . r_j
    landmark and truth   y = R^T (p - P)                 two landmarks   |y_i - y_j| = |p_i - p_j|

A misfit is the median distance of both sides, as a share of the size of what is compared: 0.02 to
0.2 for what sensors measure, about 1 where something is mistaken. Constant biases of the velocities
are left out of it. Where the body hardly turns or moves a relation says nothing, and is missing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from posegsa.recordings.inertial_frame import running_products
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import matrices, product, quaternions

HORIZON = 0.5
"""Length of an interval [s]."""
FASTEST = 0.008
"""Shortest time step that is used [s]; a faster recording is averaged."""
MOST, PART = 6000, 1500
"""Maximum number of samples that are used, and the length of the parts that they come in: those in
which the body turns most."""
TURNED, MOVED = 0.03, 0.03
"""Median turn [rad] and displacement [m] of an interval below which relations are missing."""
FEWEST = 20
"""Intervals, or measurements, that a relation needs."""
AVERAGED = 20
"""Measurements of a vector that are averaged in the inertial frame, where it is constant."""
FINEST = 0.01
"""Smallest misfit: a better one is as good."""
GRAVITY = 9.81


@dataclass(frozen=True)
class Vector:
    """A vector that the body measures."""

    name: str
    body: np.ndarray
    """(K, 3) as measured; NaN where missing."""
    reference: np.ndarray | None
    """(3,) or (K, 3) in the inertial frame; None if only known to be constant there."""


@dataclass(frozen=True)
class Quantities:
    """What relations are about, at K samples; NaN where missing."""

    time: np.ndarray
    """(K,) [s]."""
    gyroscope: np.ndarray
    """(K, 3) [rad/s]."""
    velocity: np.ndarray | None
    """(K, 3) [m/s], body frame."""
    rotation: np.ndarray | None
    """(K, 3, 3) true R."""
    position: np.ndarray | None
    """(K, 3) true P [m]."""
    vectors: tuple[Vector, ...]
    landmarks: tuple[np.ndarray, ...]
    """(K, 3) of each landmark [m], body frame."""
    places: tuple[np.ndarray, ...]
    """(3,) of each, inertial frame [m]."""
    known: dict[Any, Any] = field(default_factory=dict, compare=False)
    """What has been computed of them, by what it is and by the arrays that it was computed of."""

    def changed(self, **changes: Any) -> "Quantities":
        """With some of them replaced."""
        return replace(self, **changes)

    def once(self, what: str, of: tuple[Any, ...], compute: Callable[[], Any]) -> Any:
        """What is computed of some arrays, if none of these has been replaced since."""
        key = what, *map(id, of)
        if key not in self.known:
            self.known[key] = of, compute()  # the arrays are kept, so that no other has their id
        return self.known[key][1]


def quantities(recording: Recording) -> Quantities:
    """What a recording holds, at a rate and of a length that can be compared in moments."""
    m = {name: np.asarray(a, np.float64) for name, a in recording.measurements._asdict().items()}
    count = recording.samples
    step = max(1, int(FASTEST / recording.time_step + 1e-9))
    rows = np.arange(0, count - step + 1, step)
    if len(rows) > MOST:
        turning = np.linalg.norm(m["angular_velocity"][rows], axis=1)
        parts = np.array_split(rows, math.ceil(len(rows) / PART))
        most = np.argsort([-np.median(turning[p // step]) for p in parts], kind="stable")
        rows = np.concatenate([parts[k] for k in sorted(most[: MOST // PART])])
    within = rows[:, None] + np.arange(step)

    def first(a: np.ndarray) -> np.ndarray:
        """The first of a few samples that is there."""
        there = np.isfinite(a[within]).reshape(*within.shape, -1).all(axis=-1)
        return a[within[np.arange(len(rows)), there.argmax(axis=1)]]

    vectors, given = [], recording.sensors
    if "accelerometer" in given:
        up = np.array([0.0, 0.0, GRAVITY])
        vectors.append(Vector("accelerometer", first(given["accelerometer"]), up))
    if "magnetometer" in given:
        vectors.append(Vector("magnetometer", first(given["magnetometer"]), None))
    if not vectors:
        seen = np.where(m["vector_weights"][..., None] > 0, m["vectors"], np.nan)
        for i in range(seen.shape[1]):
            reference = m["vector_references"]
            reference = reference[i] if reference.ndim == 2 else reference[rows, i]
            vectors.append(Vector(f"vector {i}", first(seen[:, i]), reference))
    truth, places = recording.truth, m["landmark_references"]
    landmarks = np.where(m["landmark_weights"][..., None] > 0, m["landmarks"], np.nan)
    return Quantities(
        time=recording.time[rows],
        gyroscope=m["angular_velocity"][within].mean(axis=1),
        velocity=None if recording.attitude_only else m["velocity"][within].mean(axis=1),
        rotation=None if truth is None else truth.rotation[rows],
        position=None if truth is None or truth.position is None else truth.position[rows],
        vectors=tuple(vectors),
        landmarks=tuple(first(landmarks[:, j]) for j in range(landmarks.shape[1])),
        places=tuple(places if places.ndim == 2 else places[0]),
    )


def misfits(q: Quantities) -> dict[str, float]:
    """The misfit of each relation that says something, by its name."""
    found: dict[str, float | None] = {}

    def relate(name: str, compute: Callable[..., float | None], *more: Any, of: tuple) -> None:
        found[name] = q.once(name, (q.time, *of), lambda: compute(q, *more))

    truth, velocities = (q.rotation, q.position), (q.gyroscope, q.velocity)
    if q.rotation is not None:
        relate("gyroscope and truth", _turn_and_truth, of=(q.gyroscope, q.rotation))
        if q.velocity is not None and q.position is not None:
            relate("velocity and truth", _velocity_and_truth, of=(q.velocity, *truth))
    for vector in q.vectors:
        own = vector.body, vector.reference
        if q.rotation is not None:
            relate(f"{vector.name} and truth", _vector_and_truth, vector, of=(*own, q.rotation))
        relate(f"{vector.name} and gyroscope", _vector_and_turn, vector, of=(*own, q.gyroscope))
        if vector.reference is not None:
            relate(f"length of {vector.name}", _length, vector, of=own)
    for j in range(len(q.places)):
        own = q.landmarks[j], q.places[j]
        if q.rotation is not None and q.position is not None:
            relate(f"landmark {j} and truth", _landmark_and_truth, j, of=(*own, *truth))
        if q.velocity is not None:
            relate(f"landmark {j} and velocities", _landmark_and_motion, j, of=(*own, *velocities))
        for i in range(j):
            both = *own, q.landmarks[i], q.places[i]
            relate(f"landmarks {i} and {j}", _two_landmarks, i, j, of=both)
    for j, second in enumerate(q.vectors):
        for first in q.vectors[:j]:
            if first.reference is not None and second.reference is not None:
                both = first.body, first.reference, second.body, second.reference
                relate(f"{first.name} and {second.name}", _two_vectors, first, second, of=both)
    return {name: max(FINEST, misfit) for name, misfit in found.items() if misfit is not None}


def _motion(q: Quantities) -> tuple[np.ndarray, np.ndarray]:
    """Attitude (K, 4) and position (K, 3) that the velocities give, from the first sample on."""
    steps = np.diff(q.time, append=2 * q.time[-1] - q.time[-2])
    steps = np.where(steps > 5 * np.median(steps), np.median(steps), steps)
    turned = q.once("turns", (q.time, q.gyroscope), lambda: _turned(q.gyroscope * steps[:, None]))
    if q.velocity is None:
        return turned, np.zeros_like(q.gyroscope)
    moved = np.einsum("kij,kj->ki", matrices(turned), q.velocity) * steps[:, None]
    return turned, np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)[:-1]])


def _turned(angles: np.ndarray) -> np.ndarray:
    """Products (K, 4) of the rotations by all angles (K, 3) [rad] before each."""
    return running_products(np.concatenate([[[1.0, 0.0, 0.0, 0.0]], _exp(angles[:-1])]))


def _exp(angles: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(angles, axis=1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * angles * np.sinc(angle / 2 / np.pi)], axis=1)


def _log(q: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of quaternions."""
    q = np.where(q[..., :1] < 0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., :1])
    return np.where(length > 0, angle / np.where(length > 0, length, 1), 2.0) * q[..., 1:]


def _inverse(q: np.ndarray) -> np.ndarray:
    return q * [1, -1, -1, -1]


def _intervals(q: Quantities, there: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """First and last samples of intervals of about HORIZON, of those that are there (K,)."""
    at = np.flatnonzero(there)
    if len(at) < FEWEST:
        return None
    time = q.time[at]
    last = np.searchsorted(time, time + HORIZON * 0.999)
    inside = last < len(at)
    first, last = np.flatnonzero(inside), last[inside]
    near = time[last] - time[first] < 1.5 * HORIZON + 2 * np.median(np.diff(q.time))
    first, last = at[first[near]], at[last[near]]
    return (first, last) if len(first) >= FEWEST else None


def _finite(*arrays: np.ndarray) -> np.ndarray:
    """(K,) where all of some arrays (K, ...) are finite."""
    return np.all([np.isfinite(a).reshape(len(a), -1).all(axis=1) for a in arrays], axis=0)


def _median_length(a: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(a, axis=-1)))


def _between(q: Quantities, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns (n, 4) and displacements (n, 3) of intervals, body frame of their first samples."""
    turned, moved = _motion(q)
    turn = product(_inverse(turned[first]), turned[last])
    back = matrices(turned[first])
    return turn, np.einsum("kji,kj->ki", back, moved[last] - moved[first])


def _true_turns(q: Quantities, there: np.ndarray) -> np.ndarray:
    assert q.rotation is not None
    found = np.full((len(q.time), 4), np.nan)
    found[there] = quaternions(q.rotation[there])
    return found


def _turn_and_truth(q: Quantities) -> float | None:
    assert q.rotation is not None
    there = _finite(q.rotation)
    found = _intervals(q, there)
    if found is None:
        return None
    first, last = found
    true = _true_turns(q, there)
    true = product(_inverse(true[first]), true[last])
    size = _median_length(_log(true))
    if size < TURNED:
        return None
    turn, _ = _between(q, first, last)
    off = _log(product(_inverse(true), turn))
    return _median_length(off - np.median(off, axis=0)) / size


def _velocity_and_truth(q: Quantities) -> float | None:
    assert q.rotation is not None
    assert q.position is not None
    assert q.velocity is not None
    found = _intervals(q, _finite(q.rotation, q.position))
    if found is None:
        return None
    first, last = found
    steps = np.diff(q.time, append=q.time[-1])
    R = np.where(np.isfinite(q.rotation), q.rotation, 0.0)
    moved = np.cumsum(np.einsum("kij,kj->ki", R, q.velocity) * steps[:, None], axis=0)
    moved = np.concatenate([np.zeros((1, 3)), moved[:-1]])
    true = q.position[last] - q.position[first]
    size = _median_length(true)
    if size < MOVED:
        return None
    off = np.einsum("kji,kj->ki", R[first], moved[last] - moved[first] - true)
    return _median_length(off - np.median(off, axis=0)) / size


def _vector_and_truth(q: Quantities, vector: Vector) -> float | None:
    assert q.rotation is not None
    there = _finite(q.rotation, vector.body)
    if there.sum() < FEWEST:
        return None
    b = vector.body[there]
    seen = np.einsum("kij,kj->ki", q.rotation[there], b)
    size = _median_length(b)
    if vector.reference is None:
        return _median_length(seen - np.median(seen, axis=0)) / max(size, 1e-12)
    r = np.broadcast_to(vector.reference, vector.body.shape)[there]
    r = r * (size / max(_median_length(r), 1e-12))  # its length is another relation
    return _median_length(_averaged(seen - r)) / max(size, 1e-12)


def _averaged(off: np.ndarray) -> np.ndarray:
    """Means of differences (K, 3) over AVERAGED measurements, so that their noise cancels."""
    first = np.arange(0, len(off), AVERAGED)
    return np.add.reduceat(off, first, axis=0) / np.diff(np.append(first, len(off)))[:, None]


def _length(_: Quantities, vector: Vector) -> float | None:
    there = _finite(vector.body)
    if there.sum() < FEWEST or vector.reference is None:
        return None
    size, known = _median_length(vector.body[there]), _median_length(vector.reference)
    return abs(np.log(max(size, 1e-12) / max(known, 1e-12)))


def _vector_and_turn(q: Quantities, vector: Vector) -> float | None:
    found = _intervals(q, _finite(vector.body))
    if found is None:
        return None
    first, last = found
    turn, _ = _between(q, first, last)
    if _median_length(_log(turn)) < TURNED:
        return None
    before, after = vector.body[first], vector.body[last]
    off = after - np.einsum("kji,kj->ki", matrices(turn), before)
    return _median_length(off) / max(_median_length(before), 1e-12)


def _landmark_and_truth(q: Quantities, j: int) -> float | None:
    assert q.rotation is not None
    assert q.position is not None
    y = q.landmarks[j]
    there = _finite(q.rotation, q.position, y)
    if there.sum() < FEWEST:
        return None
    expected = np.einsum("kji,kj->ki", q.rotation[there], q.places[j] - q.position[there])
    return _median_length(y[there] - expected) / max(_median_length(expected), 1e-12)


def _landmark_and_motion(q: Quantities, j: int) -> float | None:
    y = q.landmarks[j]
    found = _intervals(q, _finite(y))
    if found is None:
        return None
    first, last = found
    turn, moved = _between(q, first, last)
    off = y[last] - np.einsum("kji,kj->ki", matrices(turn), y[first] - moved)
    return _median_length(off) / max(_median_length(y[first]), 1e-12)


def _two_landmarks(q: Quantities, i: int, j: int) -> float | None:
    between = q.landmarks[i] - q.landmarks[j]
    there = _finite(between)
    if there.sum() < FEWEST:
        return None
    known = float(np.linalg.norm(q.places[i] - q.places[j]))
    seen = np.linalg.norm(between[there], axis=1)
    return float(np.median(np.abs(seen - known))) / max(known, 1e-12)


def _two_vectors(_: Quantities, one: Vector, other: Vector) -> float | None:
    there = _finite(one.body, other.body)
    if there.sum() < FEWEST or one.reference is None or other.reference is None:
        return None

    def cosine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
        return np.sum(a * b, axis=-1) / np.where(lengths > 0, lengths, 1.0)

    known = np.median(cosine(one.reference, other.reference))
    return abs(float(np.median(cosine(one.body[there], other.body[there]))) - float(known))
