"""The TOML file beside a CSV file, with facts such as the positions of the landmarks.

A CSV file contains measurements, not the known surroundings. These are in `flight.csv.toml` beside
`flight.csv`, so that one path names the whole recording:

    vector_references = [[0, 0, 1], [1, 0, 0]]
    landmark_references = [[4, 0, 1], [0, 4, 1], [-4, 0, 2]]

A table `columns` gives the names of the columns, as in `Recording.from_csv`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegsa.config.reading import read_toml
from posegsa.errors import ConfigError, RecordingError
from posegsa.recordings.table import COLUMNS

TABLE_KEYS = "columns", "time_unit", "delimiter"
"""Keys for reading the CSV file."""
ARGUMENTS = (
    *("vector_references", "vector_weights"),
    *("landmark_references", "landmark_weights"),
    "start",
)
"""Keys that are arguments of `Recording.from_arrays`."""
COLUMN_ARGUMENTS = (*COLUMNS, "vectors", "landmarks")


def path_beside(path: Path) -> Path:
    """The path of the TOML file of a CSV file, whether it exists or not."""
    return path.with_name(f"{path.name}.toml")


def read_beside(path: Path) -> dict[str, Any]:
    """The contents of the TOML file beside a CSV file; empty if there is none.

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
    allowed = (*TABLE_KEYS, *ARGUMENTS)
    for key in found:
        if key not in allowed:
            raise RecordingError(f"{beside}: {key!r}; allowed: {', '.join(allowed)}")
    for key in ("time_unit", "delimiter"):
        if key in found and not isinstance(found[key], str):
            raise RecordingError(f"{beside}: {key} = {found[key]!r}; allowed: a text")
    if "columns" in found:
        _check_columns(found["columns"], beside)
    return found


def check_references(path: Path, arguments: Mapping[str, Any]) -> None:
    """Raise a RecordingError if vectors or landmarks of a CSV file have no references."""
    for kind, what, unit in (("vector", "point", ""), ("landmark", "are", ", in m")):
        measured = arguments.get(f"{kind}s")
        given = arguments.get(f"{kind}_references") is not None
        if measured is None or given or np.ndim(measured) != 3:
            continue
        count = np.shape(measured)[1]
        example = ", ".join(["[x, y, z]"] * count)
        raise RecordingError(
            f"{path}: has columns of {kind}s, {count} in all, and nothing says where they {what}; "
            f"allowed: the line {kind}_references = [{example}] in {path_beside(path)} (inertial "
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
    if missing := {"time", "angular_velocity"} - columns.keys():
        raise RecordingError(f"{beside}: columns: lacks {', '.join(sorted(missing))}")


def _are_names(value: object) -> bool:
    """Whether this is a name, or a nonempty list of names or of such lists."""
    if isinstance(value, list):
        return bool(value) and all(map(_are_names, value))
    return isinstance(value, str)
