"""Stack arrays of one shape into one array, as the loop over samples reads them.

A scenario has about forty arrays over its samples. The loop reads the numbers of a sample from one
array (`model.loops.scan_rows`). Scenarios are kept in this form, so that it is not rebuilt for
every population and a compiled program has half as many arguments.
"""

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jax import Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Packed:
    """A tree of arrays in which those of one shape and dtype are stacked."""

    together: Array
    """(..., n) the stacked arrays."""
    others: tuple[Array, ...]
    """The arrays of other shapes."""
    places: tuple[int, ...] = field(metadata={"static": True})
    """Indices of the stacked leaves in the tree."""
    structure: Any = field(metadata={"static": True})
    """The tree without its arrays."""

    def unpacked(self) -> Any:
        """The tree (pure, jittable)."""
        parts, others = iter(range(len(self.places))), iter(self.others)
        count = len(self.places) + len(self.others)
        leaves = [
            self.together[..., next(parts)] if i in self.places else next(others)
            for i in range(count)
        ]
        return jax.tree.unflatten(self.structure, leaves)


def packed(tree: Any, like: Array) -> Packed:
    """Stack those arrays of a tree that have the shape and dtype of `like`, one of them.

    It can't be called in a compiled program.
    """
    leaves, structure = jax.tree.flatten(tree)
    arrays = list(map(np.asarray, leaves))  # NumPy stacks without compiling a program
    alike = [(a.shape, a.dtype) == (like.shape, like.dtype) for a in arrays]
    return Packed(
        together=jax.device_put(
            np.stack([a for a, same in zip(arrays, alike, strict=True) if same], axis=-1)
        ),
        others=tuple(a for a, same in zip(leaves, alike, strict=True) if not same),
        places=tuple(i for i, same in enumerate(alike) if same),
        structure=structure,
    )
