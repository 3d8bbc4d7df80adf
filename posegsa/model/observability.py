"""Whether vectors and landmarks determine the pose: a precise form of the paper's Assumption 1.

The paper names three cases:

1. two vectors that are not collinear, and one landmark;
2. one vector and two landmarks (the line between them not parallel to the vector);
3. three landmarks that do not lie on one line.

All three follow from one rule. A landmark fixes the position once the attitude is known; the lines
between landmarks act like vectors. So the pose is observable if there is at least one landmark, and
if the vectors together with the lines between landmarks span two directions. (The cross product of
two vectors adds nothing: where it is not zero, they already span two directions.)
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

PARALLEL = 1e-6
"""Directions count as parallel up to about this angle [rad]."""

COINCIDENT = 1e-9
"""Landmarks count as one point up to this distance, relative to the largest coordinate. Rounding
turns the line between landmarks farther apart by less than `PARALLEL`."""


def why_unobservable(
    directions: ArrayLike,
    positions: ArrayLike,
    direction_weights: ArrayLike | None = None,
    position_weights: ArrayLike | None = None,
) -> str:
    """Why the pose cannot be determined: what was found and what is needed; "" if it can.

    Args:
        directions: Vectors in the inertial frame, of any length, shape (n, 3); one of length zero
            shows nothing.
        positions: Landmark positions in the inertial frame [m], shape (m, 3).
        direction_weights: One weight per vector, shape (n,); 0 leaves a vector out. By default
            all count.
        position_weights: The same for each landmark, shape (m,).
    """
    vectors = _directions(directions, direction_weights)
    landmarks = _counted(positions, position_weights)
    lines = _unit_lines(landmarks)
    if len(landmarks) > 0 and _span_two_directions(np.vstack([_unit(vectors), lines])):
        return ""
    return (
        f"found {_found(vectors, landmarks, lines)} (weight above 0); needed are two "
        "non-collinear vectors and a landmark, or a vector and two landmarks on a line not "
        "parallel to it, or three landmarks not on one line"
    )


def why_attitude_unobservable(
    directions: ArrayLike, direction_weights: ArrayLike | None = None
) -> str:
    """The same for the attitude alone, which two vectors determine."""
    vectors, none = _directions(directions, direction_weights), np.empty((0, 3))
    if _span_two_directions(_unit(vectors)):
        return ""
    found = _found(vectors, none, none).removesuffix(" and no landmarks")
    return f"found {found} (weight above 0); needed are two non-collinear vectors"


def are_collinear(first: ArrayLike, second: ArrayLike) -> bool:
    """Whether two non-zero vectors, shape (3,), are parallel or opposite, within `PARALLEL`."""
    return not _span_two_directions(_unit(np.array([first, second], dtype=float)))


def _directions(rows: ArrayLike, weights: ArrayLike | None) -> NDArray[np.float64]:
    """The vectors that count, shape (n, 3): those of length zero do not."""
    vectors = _counted(rows, weights)
    return vectors[vectors.any(axis=1)]


def _counted(rows: ArrayLike, weights: ArrayLike | None) -> NDArray[np.float64]:
    """The rows with a weight above zero, shape (n, 3)."""
    points = np.asarray(rows, dtype=float).reshape(-1, 3)
    return points if weights is None else points[np.asarray(weights) > 0]


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows scaled to length one; first by the largest component, so that no square overflows."""
    scaled = vectors / np.max(np.abs(vectors), axis=1, keepdims=True)
    return scaled / np.linalg.norm(scaled, axis=1, keepdims=True)


def _unit_lines(landmarks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Landmarks relative to their centre, the furthest at distance 1; empty if all coincide."""
    size = np.max(np.abs(landmarks), initial=0.0)
    if size == 0.0:
        return np.empty((0, 3))
    spread = landmarks / size
    spread = spread - spread.mean(axis=0)
    furthest = np.max(np.linalg.norm(spread, axis=1))
    return spread / furthest if furthest > COINCIDENT else np.empty((0, 3))


def _span_two_directions(rows: NDArray[np.float64]) -> bool:
    """Whether rows of length one or less have rank two or more."""
    return len(rows) >= 2 and bool(np.linalg.svd(rows, compute_uv=False)[1] > PARALLEL)


def _found(
    vectors: NDArray[np.float64], landmarks: NDArray[np.float64], lines: NDArray[np.float64]
) -> str:
    """An unobservable set of sensors in words: '2 collinear vectors and 1 landmark'."""
    collinear = len(vectors) > 1 and not _span_two_directions(_unit(vectors))
    layout = ""
    if len(landmarks) > 1 and len(lines) == 0:
        layout = " at one point"
    elif len(landmarks) > 2 and not _span_two_directions(lines):
        layout = " on one line"
    if len(vectors) > 0 and len(lines) > 0:
        layout += ", all parallel"
    kind = "collinear vector" if collinear else "vector"
    return f"{_count(len(vectors), kind)} and {_count(len(landmarks), 'landmark')}{layout}"


def _count(number: int, noun: str) -> str:
    """'no vectors', '1 vector', '2 vectors'."""
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
