"""Trajectories in the TUM format, which evo and most other trajectory tools read.

One line per sample: time [s], position x y z [m], quaternion x y z w, the scalar last (J. Sturm et
al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012).
"""

import numpy as np
from jax.typing import ArrayLike

from posegsa.model.measurements import finite_array
from posegsa.recordings.rotations import quaternions


def tum_text(time: ArrayLike, rotation: ArrayLike, position: ArrayLike | None = None) -> str:
    """The text of a TUM file, without samples that are not finite.

    Args:
        time: (K,) [s].
        rotation: (K, 3, 3) body to inertial.
        position: (K, 3) inertial frame [m]; None, if not estimated, is written as zeros.

    Raises:
        MeasurementError: an array has another shape; names it.
    """
    t = finite_array("time", time, (None,))
    q = quaternions(finite_array("rotation", rotation, (len(t), 3, 3), finite=False))
    P = np.zeros((len(t), 3)) if position is None else position
    P = finite_array("position", P, (len(t), 3), finite=False)
    rows = np.column_stack([t, P, np.roll(q, -1, axis=1)])
    rows = rows[np.isfinite(rows).all(axis=1)]
    lines = (" ".join([f"{row[0]:.9f}", *(f"{a:.12g}" for a in row[1:])]) for row in rows.tolist())
    return "".join(f"{line}\n" for line in lines)
