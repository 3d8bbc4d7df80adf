"""Optimisers that minimise any batched function over a box.

An optimiser is a frozen dataclass of settings with three pure methods, `init`, `ask` and `tell`,
that work in the unit box. `minimise` runs one on an objective; `start` and `advance` are its two
halves, for use inside a compiled function of one's own.
"""

from posegsa.optimisers.base import (
    Box,
    History,
    Optimiser,
    Search,
    advance,
    box,
    from_unit,
    lengthened,
    minimise,
    start,
)
from posegsa.optimisers.gsa import GSA
from posegsa.optimisers.random_search import RandomSearch

__all__ = [
    "GSA",
    "Box",
    "History",
    "Optimiser",
    "RandomSearch",
    "Search",
    "advance",
    "box",
    "from_unit",
    "lengthened",
    "minimise",
    "start",
]
