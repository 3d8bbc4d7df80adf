import numpy as np
import pytest
from helpers.messages import assert_states
from hypothesis import given, settings
from hypothesis import strategies as st

from posegsa.model.observability import (
    are_collinear,
    why_attitude_unobservable,
    why_unobservable,
)

pytestmark = pytest.mark.quick

ALONG, UP, EAST = (1.0, -1.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
CORNERS = ((1.0, 2.0, 3.0), (2.0, 2.0, 3.0), (1.0, 5.0, 3.0))


def is_observable(*arguments: object) -> bool:
    return not why_unobservable(*arguments)


@pytest.mark.parametrize(
    ("directions", "positions"),
    [
        ([ALONG, UP], CORNERS[:1]),  # case 1
        ([UP], CORNERS[:2]),  # case 2
        ([], CORNERS),  # case 3
        ([UP, UP, EAST], CORNERS[:1]),
        ([UP, (0.0, 1e-5, 1.0)], CORNERS[:1]),
        ([UP], [(5e6, 4e5, 0.0), (5e6 + 1.0, 4e5, 0.0)]),  # far from the origin
        ([(1e200, 0.0, 0.0), (0.0, 1e-200, 0.0)], [(1e200, 0.0, 0.0)]),
    ],
)
def test_observable(directions: object, positions: object) -> None:
    assert is_observable(directions, positions)


@pytest.mark.parametrize(
    ("directions", "positions"),
    [
        ([ALONG, UP, EAST], []),
        ([UP], CORNERS[:1]),
        ([UP, (0.0, 0.0, -3.0)], CORNERS[:1]),
        ([UP, (0.0, 1e-8, 1.0)], CORNERS[:1]),
        ([EAST], CORNERS[:2]),
        ([EAST, EAST], CORNERS[:2]),
        ([UP], [CORNERS[0]] * 4),
        ([UP], [(0.0, 0.0, 0.0)] * 2),
        ([], CORNERS[:2]),
        ([], [(0.1, 0.1, 0.1), (0.2, 0.2, 0.2), (0.3, 0.3, 0.3), (0.7, 0.7, 0.7)]),
        ([], []),
    ],
)
def test_not_observable(directions: object, positions: object) -> None:
    assert why_unobservable(directions, positions).startswith("found ")


def test_only_weights_above_zero_count() -> None:
    assert is_observable([ALONG, UP], CORNERS[:1], [1.0, 0.1])
    assert not is_observable([ALONG, UP], CORNERS[:1], [1.0, 0.0])
    assert is_observable([UP], CORNERS, [0.0], [1.0, 1.0, 1.0])
    assert not is_observable([UP], CORNERS, [0.0], [1.0, 0.0, 1.0])


def test_a_vector_of_length_zero_shows_nothing_and_a_landmark_at_the_origin_something() -> None:
    zero = (0.0, 0.0, 0.0)
    assert not is_observable([UP, zero], CORNERS[:1])
    assert_states(why_unobservable([UP, zero], CORNERS[:1]), "found 1 vector and 1 landmark")
    assert_states(why_attitude_unobservable([zero, UP]), "found 1 vector")
    assert is_observable([zero, ALONG, UP], CORNERS[:1])
    assert is_observable([UP], [zero, CORNERS[0]])


@settings(deadline=None)
@given(
    st.integers(0, 3),
    st.integers(0, 4),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
    st.floats(1e-3, 1e3),
)
def test_the_rank_decides_for_any_frame(
    n: int, m: int, dimensions: int, seed: int, scale: float
) -> None:
    """Directions and landmarks in a line, plane or space, moved, turned and scaled at random."""
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0][:, :dimensions]
    directions = random.normal(size=(n, dimensions)) @ turn.T
    positions = scale * (random.normal(size=(m, dimensions)) @ turn.T + random.normal(size=3))
    rank = min(dimensions, n + max(m - 1, 0))
    assert is_observable(directions, positions) == (m >= 1 and rank >= 2)


def test_collinear_vectors() -> None:
    assert are_collinear((1.0, 2.0, 3.0), (-2.0, -4.0, -6.0))
    assert not are_collinear((1.0, 2.0, 3.0), (1.0, 2.0, 3.1))


def test_two_vectors_fix_the_attitude() -> None:
    assert why_attitude_unobservable([UP, EAST]) == ""
    for directions, weights, found in (
        ([], None, "no vectors"),
        ([UP], None, "1 vector"),
        ([UP, (0.0, 0.0, -3.0)], None, "2 collinear vectors"),
        ([UP, EAST], [1.0, 0.0], "1 vector"),
    ):
        assert_states(why_attitude_unobservable(directions, weights), found, "two non-collinear")
