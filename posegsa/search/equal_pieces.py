"""What there is any number of, in pieces of one size: so that all of them run one program."""

import numpy as np


def piece(a: np.ndarray, first: int, count: int, axis: int = 0) -> np.ndarray:
    """Entries of an array from the `first` one on, `count` of them; past the end the last again."""
    a = np.moveaxis(a, axis, 0)
    there = a[first : first + count]
    if missing := count - len(there):
        there = np.concatenate([there, np.broadcast_to(a[-1:], (missing, *a.shape[1:]))])
    return np.moveaxis(there, 0, axis)
