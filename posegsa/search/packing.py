"""Arrays of one shape in one array, as the loop over samples reads them.

A scenario is some forty arrays over its samples. The loop takes a sample's numbers from one array
(`model.loops.scan_rows`); kept in that form, it need not be made anew for every population, and a
compiled program has half as many arguments.
"""

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jax import Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Packed:
    """A tree of arrays, those of one shape and dtype side by side in one."""

    together: Array
    """(..., n)."""
    others: tuple[Array, ...]
    """Those of other shapes."""
    places: tuple[int, ...] = field(metadata={"static": True})
    """Which leaves of the tree stand together."""
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
    """A tree with its arrays of the shape and dtype of `like`, one of them, put together.

    Not inside a compiled program.
    """
    leaves, structure = jax.tree.flatten(tree)
    arrays = list(map(np.asarray, leaves))  # put together without a program
    alike = [(a.shape, a.dtype) == (like.shape, like.dtype) for a in arrays]
    return Packed(
        together=jax.device_put(
            np.stack([a for a, same in zip(arrays, alike, strict=True) if same], axis=-1)
        ),
        others=tuple(a for a, same in zip(leaves, alike, strict=True) if not same),
        places=tuple(i for i, same in enumerate(alike) if same),
        structure=structure,
    )
