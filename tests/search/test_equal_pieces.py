"""Pieces of one size of what there is any number of."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posegsa.search.equal_pieces import piece


@given(there=st.integers(1, 20), count=st.integers(1, 8), axis=st.integers(0, 1))
def test_pieces_put_together_are_the_whole_filled_up_with_its_last(
    there: int, count: int, axis: int
) -> None:
    shape = (there, 2) if axis == 0 else (2, there)
    whole = np.arange(2 * there).reshape(shape)
    parts = [piece(whole, first, count, axis) for first in range(0, there, count)]
    assert all(part.shape[axis] == count for part in parts)
    together = np.concatenate(parts, axis)
    np.testing.assert_array_equal(np.take(together, range(there), axis), whole)
    for filled in range(there, together.shape[axis]):
        np.testing.assert_array_equal(
            np.take(together, filled, axis), np.take(whole, there - 1, axis)
        )
