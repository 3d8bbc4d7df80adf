"""Relations between the quantities of a recording, and their misfits.

The motion of the body relates its sensors to each other. Over an interval of INTERVAL_TIME the
gyroscope gives a turn dR and the velocity a displacement dP in the body frame of its beginning, and

    turn and truth       R1 = R0 dR                      vector and turn     b1 = dR^T b0
    velocity and truth   P1 = P0 + R0 dP                 landmark and motion y1 = dR^T (y0 - dP)
    vector and truth     R b = r                         two vectors         b_i . b_j = r_i . r_j
    landmark and truth   y = R^T (p - P)                 two landmarks   |y_i - y_j| = |p_i - p_j|

A vector that points up may be gravity alone, or what an accelerometer measures. Its weighted means
over 2 T, R b - r in the inertial frame, are then (P(t + T) - 2 P(t) + P(t - T)) / T^2 exactly, with
weights that fall to 0 at both ends, however hard the body is shaken. P is that of the truth, or of
both velocities. The better of both readings counts. Taken by axis of the body, it also detects
wrong signs that hardly change the total. Without a P, means over seconds are compared: of a
specific force only gravity remains in them.

Raw signals of an inertial sensor have the references that their frame gives them: gravity upwards,
and for a field, whose size and dip are unknown, the horizontal direction north. That relation only
tells which frame is meant (NORTH_OFF): the truth may well be turned about the vertical by less.

A misfit is the median distance of both sides, as a share of the size of the compared quantity: 0.02
to 0.2 for real sensors, about 1 if there is a mistake. Constant biases of the velocities are left
out of it. If the body hardly turns or moves, a relation says nothing and is left out.
"""

import itertools
import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from posegsa.model.measurements import known_means
from posegsa.recordings.frames import GRAVITY, NORTH, UP, Frame
from posegsa.recordings.held import held
from posegsa.recordings.inertial_frame import turned
from posegsa.recordings.recording import Recording
from posegsa.recordings.rotations import inverse, log, matrices, product, quaternions
from posegsa.recordings.truth import all_finite

INTERVAL_TIME = 0.5
"""Length of an interval [s]."""
MIN_TIME_STEP = 0.008
"""Shortest time step that is used [s]; a faster recording is averaged."""
MAX_SAMPLES, PART_SAMPLES = 6000, 1500
"""Maximum number of samples that are used, and the length of the parts that they are taken in: the
parts in which the body turns most."""
MIN_TURN, MIN_DISPLACEMENT = 0.03, 0.03
"""Median turn [rad] and displacement [m] of an interval below which relations are left out."""
MIN_INTERVALS = 20
"""Minimum number of intervals, or measurements, for a relation."""
AVERAGED_MEASUREMENTS = 20
"""Measurements of a vector that are averaged in the inertial frame, where it is constant."""
AVERAGED_FORCES = 500
"""The same of a vector that points up, if no position tells the body's acceleration. Of a specific
force gravity remains: its mean over a time T is that and the change of the velocity over T, / T."""
MIN_MISFIT = 0.01
"""Smallest misfit: a smaller one counts as equal to it."""
FORCE_MEAN_TIME = 0.2
"""T of the means of specific force [s]."""
MIN_MEASURED_SHARE = 0.05
"""Minimum share of the weights in such a mean that belongs to measurements."""
MIN_FORCE_CHANGE = 0.005
"""Change of the specific force of an axis, as a share of gravity, below which it says nothing."""
MIN_HORIZONTAL_SHARE = 0.1
"""Horizontal share of a field's length below which it does not show where north is."""
NORTH_OFF, NORTH_FITS = 0.3, 0.05
"""Distance of the field's horizontal direction (of length one) from north up to which it may be
declination or iron, and the misfit that this counts as."""
AXES = "xyz"


@dataclass(frozen=True)
class Vector:
    """A vector that the body measures."""

    name: str
    body: np.ndarray
    """(K, 3) as measured; NaN where missing."""
    reference: np.ndarray | None
    """(3,) or (K, 3) in the inertial frame; None if only known to be constant there."""

    @property
    def is_up(self) -> bool:
        """Whether its reference is vertical: it may be gravity, or a specific force."""
        if self.reference is None:
            return False
        mean = np.atleast_2d(self.reference).mean(axis=0)
        return bool(abs(mean[2]) > 0.99 * np.linalg.norm(mean) > 0)


@dataclass(frozen=True)
class Quantities:
    """The quantities that relations compare, at K samples; NaN where missing."""

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
    """(3,) of each landmark, inertial frame [m]."""
    frame: Frame | None = None
    """The inertial frame, if the vectors are raw signals of an inertial sensor."""
    repeated: dict[str, np.ndarray] = field(default_factory=dict)
    """(K,) where a held velocity has no new measurement, by the velocity's name."""
    known: dict[Any, Any] = field(default_factory=dict, compare=False)
    """Cache of computed results, by name and by the identities of their input arrays."""

    def changed(self, **changes: Any) -> "Quantities":
        """The quantities with some of them replaced."""
        return replace(self, **changes)

    def once(self, what: Hashable, of: tuple[Any, ...], compute: Callable[[], Any]) -> Any:
        """A result computed from some arrays, from the cache if none of them has been replaced."""
        key = what, *map(id, of)
        if key not in self.known:
            self.known[key] = of, compute()  # keeping the arrays alive keeps their ids unique
        return self.known[key][1]


def quantities(recording: Recording, *, averaged: bool = True, whole: bool = False) -> Quantities:
    """The quantities of a recording, thinned and cut so that comparisons are quick.

    Args:
        recording: Any recording.
        averaged: Whether vectors are means over the samples that are left out; otherwise single
            samples, with the noise of a measurement.
        whole: Whether no part is cut out, however long the recording is.
    """
    m = {name: np.asarray(a, np.float64) for name, a in recording.measurements._asdict().items()}
    count = recording.samples
    step = max(1, int(MIN_TIME_STEP / recording.time_step + 1e-9))
    rows = np.arange(0, count - step + 1, step)
    if len(rows) > MAX_SAMPLES and not whole:
        turning = np.linalg.norm(m["angular_velocity"][rows], axis=1)
        parts = np.array_split(rows, math.ceil(len(rows) / PART_SAMPLES))
        most = np.argsort([-np.median(turning[p // step]) for p in parts], kind="stable")
        rows = np.concatenate([parts[k] for k in sorted(most[: MAX_SAMPLES // PART_SAMPLES])])
    within = rows[:, None] + np.arange(step)

    def first(a: np.ndarray) -> np.ndarray:
        """The first measured one of a few samples."""
        there = np.isfinite(a[within]).reshape(*within.shape, -1).all(axis=-1)
        return a[within[np.arange(len(rows)), there.argmax(axis=1)]]

    def mean(a: np.ndarray) -> np.ndarray:
        """The mean (K, 3) of the measured ones of a few samples: an impact is shorter than that."""
        return known_means(a[within])

    of_vectors = mean if averaged else first
    vectors, given = [], recording.sensors
    frame = recording.frame or "ENU"
    if "accelerometer" in given:
        up = GRAVITY * np.array(UP[frame])
        vectors.append(Vector("accelerometer", of_vectors(given["accelerometer"]), up))
    if "magnetometer" in given:
        vectors.append(Vector("magnetometer", of_vectors(given["magnetometer"]), None))
    if not vectors:
        seen = np.where(m["vector_weights"][..., None] > 0, m["vectors"], np.nan)
        for i in range(seen.shape[1]):
            reference = m["vector_references"]
            reference = reference[i] if reference.ndim == 2 else reference[rows, i]
            vectors.append(Vector(f"vector {i}", of_vectors(seen[:, i]), reference))
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
        frame=frame if "accelerometer" in given else None,
        repeated={
            name: np.asarray(~holding.fresh[within].any(axis=1))
            for name in ("angular_velocity", "velocity")
            if (holding := held(m[name])).samples > 1
        },
    )


def misfits(q: Quantities) -> dict[str, float]:
    """The misfit of each relation that the motion can show, by name."""
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
            relate(f"{vector.name} and truth", _vector_and_truth, vector, of=(*own, *truth))
            if vector.reference is None:
                relate(north_of(vector), _north_and_truth, vector, of=(*own, *truth))
        if vector.is_up and q.rotation is not None and q.position is not None:
            for k, axis in enumerate(AXES):
                name = f"{vector.name}, {axis}, and truth"
                relate(name, _axis_and_truth, vector, k, of=(*own, *truth))
        moving = (*own, *velocities)
        if q.velocity is not None or not _is_calmed(q, vector):
            relate(f"{vector.name} and gyroscope", _vector_and_turn, vector, of=moving)
        if vector.reference is not None:
            relate(f"length of {vector.name}", _length, vector, of=(*moving, *truth))
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
                both = *both, *velocities
                relate(f"{first.name} and {second.name}", _two_vectors, first, second, of=both)
    return {
        name: max(MIN_MISFIT, misfit)
        for name, misfit in found.items()
        if misfit is not None and not math.isnan(misfit)
    }


def _motion(q: Quantities) -> tuple[np.ndarray, np.ndarray]:
    """Attitude (K, 4) and position (K, 3) that the velocities give, from the first sample on."""
    return q.once("motion", (q.time, q.gyroscope, q.velocity), lambda: _moved(q))


def _moved(q: Quantities) -> tuple[np.ndarray, np.ndarray]:
    steps = np.diff(q.time, append=2 * q.time[-1] - q.time[-2])
    steps = np.where(steps > 5 * np.median(steps), np.median(steps), steps)
    turns = q.once("turns", (q.time, q.gyroscope), lambda: turned(q.gyroscope * steps[:, None]))
    if q.velocity is None:
        return turns, np.zeros_like(q.gyroscope)
    moved = np.einsum("kij,kj->ki", matrices(turns), q.velocity) * steps[:, None]
    return turns, np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)[:-1]])


def _intervals(q: Quantities, there: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """First and last samples of intervals of about INTERVAL_TIME, among the measured ones (K,)."""
    at = np.flatnonzero(there)
    if len(at) < MIN_INTERVALS:
        return None
    time = q.time[at]
    last = np.searchsorted(time, time + INTERVAL_TIME * 0.999)
    inside = last < len(at)
    first, last = np.flatnonzero(inside), last[inside]
    near = time[last] - time[first] < 1.5 * INTERVAL_TIME + 2 * np.median(np.diff(q.time))
    first, last = at[first[near]], at[last[near]]
    return (first, last) if len(first) >= MIN_INTERVALS else None


def _median_length(a: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(a, axis=-1)))


class Change(NamedTuple):
    """How the pose changes in n intervals by the velocities, in the frames of their beginnings."""

    first: np.ndarray
    """(n,) samples."""
    last: np.ndarray
    """(n,) samples."""
    turn: np.ndarray
    """(n, 4)."""
    rotation: np.ndarray
    """(n, 3, 3), of the turn."""
    moved: np.ndarray
    """(n, 3) [m]."""
    angle: float
    """Median of the turns [rad]."""


def _change(q: Quantities, there: np.ndarray) -> Change | None:
    """The change in intervals between measured samples (K,); None if they are too few."""
    # Most sensors measure at the same samples, and most hypotheses change no velocity.
    what = "change", there.tobytes()
    return q.once(what, (q.time, q.gyroscope, q.velocity), lambda: _computed_change(q, there))


def _computed_change(q: Quantities, there: np.ndarray) -> Change | None:
    found = _intervals(q, there)
    if found is None:
        return None
    first, last = found
    turns, moved = _motion(q)
    turn = product(inverse(turns[first]), turns[last])
    displaced = np.einsum("kji,kj->ki", matrices(turns[first]), moved[last] - moved[first])
    return Change(first, last, turn, matrices(turn), displaced, _median_length(log(turn)))


def _turn_and_truth(q: Quantities) -> float | None:
    assert q.rotation is not None
    change = _change(q, all_finite(q.rotation))
    if change is None:
        return None
    before, after = quaternions(q.rotation[change.first]), quaternions(q.rotation[change.last])
    true = product(inverse(before), after)
    size = _median_length(log(true))
    if size < MIN_TURN:
        return None
    off = log(product(inverse(true), change.turn))
    return _median_length(off - np.median(off, axis=0)) / size


def _velocity_and_truth(q: Quantities) -> float | None:
    assert q.rotation is not None
    assert q.position is not None
    assert q.velocity is not None
    found = _intervals(q, all_finite(q.rotation, q.position))
    if found is None:
        return None
    first, last = found
    steps = np.diff(q.time, append=q.time[-1])
    R = np.where(np.isfinite(q.rotation), q.rotation, 0.0)
    moved = np.cumsum(np.einsum("kij,kj->ki", R, q.velocity) * steps[:, None], axis=0)
    moved = np.concatenate([np.zeros((1, 3)), moved[:-1]])
    true = q.position[last] - q.position[first]
    size = _median_length(true)
    if size < MIN_DISPLACEMENT:
        return None
    off = np.einsum("kji,kj->ki", R[first], moved[last] - moved[first] - true)
    return _median_length(off - np.median(off, axis=0)) / size


def _vector_and_truth(q: Quantities, vector: Vector) -> float | None:
    assert q.rotation is not None
    there = all_finite(q.rotation, vector.body)
    if there.sum() < MIN_INTERVALS:
        return None
    b = vector.body[there]
    seen = np.einsum("kij,kj->ki", q.rotation[there], b)
    size = _median_length(b)
    if vector.reference is None:
        return _median_length(seen - np.median(seen, axis=0)) / max(size, 1e-12)
    known = np.broadcast_to(vector.reference, vector.body.shape)
    r = known[there]
    length = AVERAGED_MEASUREMENTS
    if _is_calmed(q, vector):
        length = AVERAGED_FORCES
        size = _median_length(_means(seen, length))
    r = r * (size / max(_median_length(r), 1e-12))  # its length has a relation of its own
    found = _median_length(_means(seen - r, length)) / max(size, 1e-12)
    if (force := true_force(q, vector)) is None:
        return found
    off = force.body - force.pulled - np.einsum("kji,kj->ki", q.rotation, known)
    return min(found, _median_length(off[all_finite(off)]) / max(_median_length(known), 1e-12))


def _is_calmed(q: Quantities, vector: Vector) -> bool:
    """Whether only means of many values of a vector, AVERAGED_FORCES, show gravity."""
    return vector.is_up and q.rotation is not None and q.position is None


def north_of(vector: Vector) -> str:
    """The name of the relation of a field's horizontal direction and the truth."""
    return f"{vector.name}, north, and truth"


def _north_and_truth(q: Quantities, vector: Vector) -> float | None:
    """Misfit of a field and north; None if it points north in no frame."""
    assert q.rotation is not None
    if q.frame is None:
        return None
    there = all_finite(q.rotation, vector.body)
    if there.sum() < MIN_INTERVALS:
        return None
    seen = np.mean(np.einsum("kij,kj->ki", q.rotation[there], vector.body[there]), axis=0)
    flat = float(np.linalg.norm(seen[:2]))
    if flat < MIN_HORIZONTAL_SHARE * _median_length(vector.body[there]):
        return None
    off = {F: float(np.linalg.norm(seen[:2] / flat - NORTH[F][:2])) for F in NORTH}
    if off[q.frame] <= NORTH_OFF:
        return NORTH_FITS
    return off[q.frame] if min(off.values()) <= NORTH_OFF else None


def _axis_and_truth(q: Quantities, vector: Vector, k: int) -> float | None:
    """Misfit of one axis of a vector that points up, as a share of the change of its prediction."""
    if (force := true_force(q, vector)) is None:
        return None
    assert q.rotation is not None
    known = np.broadcast_to(given(vector.reference), vector.body.shape)
    up, found = np.einsum("kji,kj->ki", q.rotation, known)[:, k], []
    for expected in (up, up + force.pulled[:, k]):
        pair = np.stack([force.body[:, k] - expected, expected], axis=1)
        pair = pair[all_finite(force.body, pair)]
        off, change = np.median(np.abs(pair - np.median(pair, axis=0)), axis=0)
        if change > MIN_FORCE_CHANGE * _median_length(known):
            found.append(float(off / change))
    return min(found, default=None)


class Force(NamedTuple):
    """Means of a specific force, in the body frame at their middle; NaN where unknown."""

    body: np.ndarray
    """(K, 3) as measured."""
    pulled: np.ndarray
    """(K, 3) the contribution of the body's acceleration."""


def true_force(q: Quantities, vector: Vector) -> Force | None:
    """A vector that points up, with the true acceleration in it; None if that is unknown."""
    if q.rotation is None or q.position is None or not vector.is_up:
        return None
    of = q.time, vector.body, vector.reference, q.rotation, q.position
    R, P = q.rotation, q.position
    return q.once("true force", of, lambda: _force(q.time, vector, R, P))


def _meanings(q: Quantities, vector: Vector) -> list[Vector]:
    """A vector as measured; if it points up, also without the acceleration by both velocities."""
    if q.velocity is None or not vector.is_up:
        return [vector]

    def compute() -> Force | None:
        turns, moved = _motion(q)
        return _force(q.time, vector, matrices(turns), moved)

    of = q.time, vector.body, vector.reference, q.gyroscope, q.velocity
    force = q.once("force", of, compute)
    return [vector] if force is None else [vector, replace(vector, body=force.body - force.pulled)]


def _force(time: np.ndarray, vector: Vector, R: np.ndarray, P: np.ndarray) -> Force | None:
    """Means of a specific force along a motion R (K, 3, 3), P (K, 3); None if there are too few."""
    step, count = float(np.median(np.diff(time))), len(time)
    n = max(2, round(FORCE_MEAN_TIME / step))
    if count < 2 * n + MIN_INTERVALS:
        return None
    there = all_finite(R, vector.body)
    force = np.einsum("kij,kj->ki", R[there], vector.body[there])
    weighed = np.zeros((count, 4))
    weighed[there] = np.concatenate([force, np.ones((len(force), 1))], axis=1)
    for _ in range(2):  # two equal means in succession have the triangular weights
        sums = np.concatenate([np.zeros((1, 4)), np.cumsum(weighed, axis=0)])
        weighed = (sums[n:] - sums[:-n]) / n
    weighed = weighed[1:-1]
    whole = np.abs(time[2 * n :] - time[: -2 * n] - 2 * n * step) < step
    whole &= weighed[:, 3] > MIN_MEASURED_SHARE
    scale = _median_length(given(vector.reference)) / GRAVITY
    second = (P[2 * n :] - 2 * P[n:-n] + P[: -2 * n]) / (n * step) ** 2
    both = np.full((2, count, 3), np.nan)
    back = R[n:-n][whole]
    for k, a in enumerate(
        (weighed[:, :3] / np.maximum(weighed[:, 3:], MIN_MEASURED_SHARE), scale * second)
    ):
        both[k, n:-n][whole] = np.einsum("kji,kj->ki", back, a[whole])
    return Force(*both) if all_finite(*both).sum() >= MIN_INTERVALS else None


def given(a: np.ndarray | None) -> np.ndarray:
    """An array that is known to be there."""
    assert a is not None
    return a


def _means(a: np.ndarray, length: int) -> np.ndarray:
    """Means of an array (K, 3) over `length` measurements each, so that their noise cancels."""
    first = np.arange(0, len(a), length)
    return np.add.reduceat(a, first, axis=0) / np.diff(np.append(first, len(a)))[:, None]


def _length(q: Quantities, vector: Vector) -> float | None:
    if all_finite(vector.body).sum() < MIN_INTERVALS:
        return None
    known = max(_median_length(given(vector.reference)), 1e-12)
    sizes = [_median_length(one.body[all_finite(one.body)]) for one in _meanings(q, vector)]
    if _is_calmed(q, vector):
        there = all_finite(given(q.rotation), vector.body)
        seen = np.einsum("kij,kj->ki", given(q.rotation)[there], vector.body[there])
        sizes += (
            [_median_length(_means(seen, AVERAGED_FORCES))] if there.sum() >= MIN_INTERVALS else []
        )
    return min(abs(np.log(max(size, 1e-12) / known)) for size in sizes)


def _vector_and_turn(q: Quantities, vector: Vector) -> float | None:
    found = [_direction_and_turn(q, one.body) for one in _meanings(q, vector)]
    return min((one for one in found if one is not None), default=None)


def _direction_and_turn(q: Quantities, body: np.ndarray) -> float | None:
    change = _change(q, all_finite(body))
    if change is None or change.angle < MIN_TURN:
        return None
    before, after = body[change.first], body[change.last]
    off = after - np.einsum("kji,kj->ki", change.rotation, before)
    return _median_length(off) / max(_median_length(before), 1e-12)


def _landmark_and_truth(q: Quantities, j: int) -> float | None:
    assert q.rotation is not None
    assert q.position is not None
    y = q.landmarks[j]
    there = all_finite(q.rotation, q.position, y)
    if there.sum() < MIN_INTERVALS:
        return None
    expected = np.einsum("kji,kj->ki", q.rotation[there], q.places[j] - q.position[there])
    return _median_length(y[there] - expected) / max(_median_length(expected), 1e-12)


def _landmark_and_motion(q: Quantities, j: int) -> float | None:
    y = q.landmarks[j]
    change = _change(q, all_finite(y))
    if change is None:
        return None
    before, after = y[change.first], y[change.last]
    off = after - np.einsum("kji,kj->ki", change.rotation, before - change.moved)
    return _median_length(off) / max(_median_length(before), 1e-12)


def _two_landmarks(q: Quantities, i: int, j: int) -> float | None:
    between = q.landmarks[i] - q.landmarks[j]
    there = all_finite(between)
    if there.sum() < MIN_INTERVALS:
        return None
    known = float(np.linalg.norm(q.places[i] - q.places[j]))
    seen = np.linalg.norm(between[there], axis=1)
    return float(np.median(np.abs(seen - known))) / max(known, 1e-12)


def _two_vectors(q: Quantities, one: Vector, other: Vector) -> float | None:
    def cosine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
        return np.sum(a * b, axis=-1) / np.where(lengths > 0, lengths, 1.0)

    known = float(np.median(cosine(given(one.reference), given(other.reference))))
    found = []
    for first, second in itertools.product(_meanings(q, one), _meanings(q, other)):
        there = all_finite(first.body, second.body)
        if there.sum() >= MIN_INTERVALS:
            seen = cosine(first.body[there], second.body[there])
            found.append(abs(float(np.median(seen)) - known))
    return min(found, default=None)
