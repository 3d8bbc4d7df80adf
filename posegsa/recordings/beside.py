"""The TOML file beside a CSV file or a bag, with facts such as the positions of the landmarks.

A CSV file contains measurements, not the known surroundings. These are in `flight.csv.toml` beside
`flight.csv`, so that one path names the whole recording:

    vector_references = [[0, 0, 1], [1, 0, 0]]
    landmark_references = [[4, 0, 1], [0, 4, 1], [-4, 0, 2]]

A table `columns` gives the names of the columns, as in `Recording.from_csv`; beside a bag, a table
`topics` gives the topics, as in `Recording.from_rosbag`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegsa.config.reading import read_toml
from posegsa.errors import ConfigError, RecordingError
from posegsa.recordings.table import ALIASES, COLUMNS
from posegsa.words import counted

TABLE_KEYS = "columns", "time_unit", "delimiter"
"""Keys for reading a CSV file."""
BAG_KEYS = "topics", "stamps"
"""Keys for reading a bag."""
ARGUMENTS = (
    *("vector_references", "vector_weights"),
    *("landmark_references", "landmark_weights"),
    *("start", "frame"),
)
"""Keys that are arguments of `Recording.from_arrays`."""
STREAM_KEYS = "truth", "between"
"""Keys of sensors with stamps of their own: a TUM file with the truth, by its path from the folder
of the TOML file, and what to do between samples."""
COLUMN_ARGUMENTS = (*COLUMNS, "vectors", "landmarks", *ALIASES)


def path_beside(path: Path) -> Path:
    """The path of the TOML file of a CSV file or a bag, whether it exists or not."""
    return path.with_name(f"{path.name}.toml")


def read_beside(path: Path, keys: tuple[str, ...] = TABLE_KEYS) -> dict[str, Any]:
    """The contents of the TOML file beside a CSV file or a bag; empty if there is none.

    Args:
        path: The file or the bag.
        keys: `TABLE_KEYS` or `BAG_KEYS`.

    Raises:
        RecordingError: It cannot be read, or contains something that is not allowed.
    """
    beside = path_beside(path)
    if not beside.is_file():
        return {}
    try:
        found = read_toml(beside)
    except ConfigError as error:
        raise RecordingError(str(error)) from None
    allowed = (*keys, *ARGUMENTS, *STREAM_KEYS)
    for key in found:
        if key not in allowed:
            raise RecordingError(f"{beside}: {key!r}; allowed: {', '.join(allowed)}")
    for key in ("time_unit", "delimiter", "stamps", "truth"):
        if key in found and not isinstance(found[key], str):
            raise RecordingError(f"{beside}: {key} = {found[key]!r}; allowed: a text")
    for key in ("topics", "between"):
        if key in found and not isinstance(found[key], dict):
            raise RecordingError(f"{beside}: {key} = {found[key]!r}; allowed: a table, [{key}]")
    if "truth" in found:
        found["truth"] = beside.parent / found["truth"]
    if "columns" in found:
        _check_columns(found["columns"], beside)
    return found


def check_references(path: Path, arguments: Mapping[str, Any]) -> None:
    """Raise a RecordingError if vectors or landmarks of a file have no references."""
    for kind, what, unit in (("vector", "point", ""), ("landmark", "are", ", in m")):
        measured = arguments.get(f"{kind}s")
        given = arguments.get(f"{kind}_references") is not None
        if measured is None or given:
            continue
        if isinstance(measured, list):
            count = len(measured)  # streams
        elif np.ndim(measured) == 3:
            count = np.shape(measured)[1]
        else:
            continue
        example = ", ".join(["[x, y, z]"] * count)
        raise RecordingError(
            f"{path}: has {counted(count, kind)}, and nothing says where they {what}; allowed: the "
            f"line {kind}_references = [{example}] in {path_beside(path)} (inertial "
            f"frame{unit}), or in Python {kind}_references="
        )


def _check_columns(columns: object, beside: Path) -> None:
    """Raise a RecordingError unless this maps arguments to names of columns."""
    if not isinstance(columns, dict):
        raise RecordingError(f"{beside}: columns = {columns!r}; allowed: a table, [columns]")
    for argument, names in columns.items():
        where = f"{beside}: columns.{argument}"
        if argument not in COLUMN_ARGUMENTS:
            raise RecordingError(f"{where}; allowed: {', '.join(COLUMN_ARGUMENTS)}")
        if not _are_names(names):
            raise RecordingError(f"{where} = {names!r}; allowed: names of columns")
    named = {ALIASES.get(argument, argument) for argument in columns}
    if missing := {"time", "angular_velocity"} - named:
        raise RecordingError(f"{beside}: columns: lacks {', '.join(sorted(missing))}")


def _are_names(value: object) -> bool:
    """Whether this is a name, or a nonempty list of names or of such lists."""
    if isinstance(value, list):
        return bool(value) and all(map(_are_names, value))
    return isinstance(value, str)
