"""Trajectories in the TUM format, which evo and most other trajectory tools read.

One line per sample: time [s], position x y z [m], quaternion x y z w, the scalar last (J. Sturm et
al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array
from posegsa.recordings.checked_files import file_of, reading
from posegsa.recordings.rotations import quaternions
from posegsa.recordings.streams import Between, Stream, on_one_clock

COLUMNS = "time x y z qx qy qz qw"


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


def read_tum(path: str | Path) -> dict[str, Stream]:
    """The poses of a TUM file as streams "truth_quaternion" (w, x, y, z) and "truth_position".

    Raises:
        RecordingError: it cannot be read; or a line does not hold eight numbers, of which the last
            four are a quaternion.
    """
    path = file_of(path)
    rows, lines = [], []
    with reading(path), path.open(encoding="utf-8-sig") as file:
        for number, line in enumerate(file, start=1):
            cells = line.split("#")[0].replace(",", " ").split()
            if not cells:
                continue
            try:
                rows.append([float(cell) for cell in cells])
            except ValueError:
                raise RecordingError(
                    f"{path}: line {number} is {line.strip()!r}; allowed: the numbers {COLUMNS}"
                ) from None
            lines.append(number)
            if len(rows[-1]) != 8:
                raise RecordingError(
                    f"{path}: line {number} has {len(rows[-1])} numbers; allowed: {COLUMNS}"
                )
    if not rows:
        raise RecordingError(f"{path}: holds no pose; allowed: lines {COLUMNS}")
    table = np.array(rows)
    length = np.linalg.norm(table[:, 4:], axis=1)
    if (off := np.abs(length - 1) > 0.05).any():
        k = int(np.argmax(off))
        raise RecordingError(
            f"{path}: line {lines[k]}: the quaternion qx qy qz qw has the length {length[k]:.4g}; "
            "allowed: 1"
        )
    time, quaternion = table[:, 0], np.roll(table[:, 4:], 1, axis=1)
    return {"truth_quaternion": (time, quaternion), "truth_position": (time, table[:, 1:4])}


def with_tum(
    arguments: dict[str, Any], path: str | Path, between: Mapping[str, Between] | None = None
) -> dict[str, Any]:
    """Arguments of `Recording.from_arrays` with the truth from a TUM file.

    Args:
        arguments: arguments with "time", on the clock of the file.
        path: the file.
        between: as in `Recording.from_streams`.

    Raises:
        RecordingError: the file cannot be read or does not overlap with the recording, or the
            arguments have a truth.
    """
    if given := [name for name in arguments if name.startswith("truth_")]:
        raise RecordingError(
            f"truth = {str(path)!r}: in addition to {', '.join(given)}; allowed: one truth"
        )
    if "time" not in arguments:
        raise RecordingError(f"truth = {str(path)!r}: allowed with time stamps")
    found = on_one_clock(read_tum(path), clock=arguments["time"], between=between)
    notes = (*arguments.get("notes", ()), *found.pop("notes"))
    truth = {name: a for name, a in found.items() if name.startswith("truth_")}
    return arguments | truth | {"notes": notes}
