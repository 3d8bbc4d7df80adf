"""Recordings in NumPy .npz files: one array for each argument of `Recording.from_arrays`."""

from pathlib import Path
from typing import Any

import numpy as np

from posegsa.errors import RecordingError
from posegsa.recordings.checked_files import file_of, reading

GROUPS = "phases", "sources", "sensors"
"""Arguments that are dictionaries: each entry is an array named "group/key"."""
START = "start_rotation", "start_position", "start_bias"
WORDS = "name", "start", "frame"
BY_RATE = "weights_by_rate"
SCALARS = "landmark_outlier", "origin"
"""Names of arguments that are numbers; the first may be "off"."""
ARRAYS = (
    *("time", "time_step", "angular_velocity", "velocity"),
    *("vectors", "vector_references", "vector_weights"),
    *("landmarks", "landmark_references", "landmark_weights"),
    *("truth_rotation", "truth_quaternion", "truth_position", "judged"),
)


def read_npz(path: str | Path) -> dict[str, Any]:
    """Arguments of `Recording.from_arrays` from an .npz file; nothing in it is unpickled.

    Raises:
        RecordingError: it cannot be read, or contains an array of another name.
    """
    path = file_of(path)
    with reading(path), np.load(path, allow_pickle=False) as archive:
        held = {name: archive[name] for name in archive.files}
    found: dict[str, Any] = {group: {} for group in GROUPS}
    pose = [held.pop(name) for name in START if name in held]
    for name, array in held.items():
        group, _, key = name.partition("/")
        if group in GROUPS and key:
            found[group][key] = str(array) if group == "sources" else array
        elif name in WORDS:
            found[name] = str(array)
        elif name == "notes":
            found[name] = tuple(map(str, np.ravel(array)))
        elif name == BY_RATE and array.ndim == 0 and array.dtype == bool:
            found[name] = bool(array)
        elif name in SCALARS:
            found[name] = array.item() if array.ndim == 0 else array
        elif name in ARRAYS:
            found[name] = array
        else:
            allowed = ", ".join(
                (*ARRAYS, *WORDS, *START, BY_RATE, *SCALARS, "notes", *(f"{g}/..." for g in GROUPS))
            )
            raise RecordingError(f"{path}: holds {name!r}; allowed: {allowed}")
    if "angular_velocity" not in found:
        raise RecordingError(f"{path}: holds no angular_velocity")
    if pose:
        if len(pose) < 2:
            raise RecordingError(f"{path}: a start needs {START[0]} and {START[1]}")
        found["start"] = pose
    return found


def write_npz(path: str | Path, arguments: dict[str, Any]) -> None:
    """Write arguments of `Recording.from_arrays`, without those that are None."""
    arrays = {}
    for name, value in arguments.items():
        if name in GROUPS:
            arrays |= {f"{name}/{key}": np.asarray(each) for key, each in value.items()}
        elif name == "start" and not isinstance(value, str):
            arrays |= dict(zip(START, map(np.asarray, value), strict=True))
        elif value is not None:
            arrays[name] = np.asarray(value)
    path = Path(path)
    try:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from None
