"""Reads recordings from CSV files: named columns to arguments of `Recording.from_arrays`."""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from posegsa.errors import RecordingError
from posegsa.recordings.checked_files import file_of, reading

Columns: TypeAlias = Mapping[str, str | Sequence[str] | Sequence[Sequence[str]]]
"""For arguments of `Recording.from_arrays`, the names of their columns."""

COLUMNS: dict[str, Any] = {
    "time": "time",
    "angular_velocity": ("wx", "wy", "wz"),
    "velocity": ("vx", "vy", "vz"),
    "truth_quaternion": ("qw", "qx", "qy", "qz"),
    "truth_position": ("px", "py", "pz"),
    "judged": "judged",
    "accelerometer": ("ax", "ay", "az"),
    "magnetometer": ("mx", "my", "mz"),
}
"""The default names; columns that a file does not have are left out. A column "time_ns" is the time
in ns, as integers. For vectors and landmarks see `SIGHTING`."""
ALIASES = {"gyr": "angular_velocity", "acc": "accelerometer", "mag": "magnetometer"}
"""Other names of these arguments: those of `imu`."""
SIGHTING = re.compile(r"(?P<kind>[vl])(?P<number>\d+)_[xyz]")
"""Default names of columns of vectors and landmarks, ordered by number: v0_x v0_y v0_z, v1_x ...,
l0_x ..."""
KINDS = {"v": "vectors", "l": "landmarks"}
ACCELEROMETER = "accelerometer"
SENSORS = ACCELEROMETER, "magnetometer"
"""Signals that become `Recording.sensors`."""
MASKS = ("judged",)
TIME_UNITS = {"s": 0, "ms": 6, "us": 3, "ns": 0}
"""Units of time stamps, with the power of ten that converts integers to ns."""


def read_csv(
    path: str | Path, columns: Columns | None, time_unit: str, delimiter: str
) -> dict[str, Any]:
    """Arguments of `Recording.from_arrays` from a CSV file; see `Recording.from_csv`.

    Raises:
        RecordingError: it cannot be read, or a column is missing.
    """
    path = file_of(path)
    if time_unit not in TIME_UNITS:
        raise RecordingError(f"time_unit = {time_unit!r}; allowed: {', '.join(TIME_UNITS)}")
    with reading(path), path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file, delimiter=delimiter)
        names = next(rows, [])
        head = [name.strip().lstrip("#").strip() for name in names]
        cells = [row for row in rows if row]
    if len(head) == 1:
        _refuse_other_separator(path, head[0], comment=names[0].lstrip().startswith("#"))
    if not cells:
        raise RecordingError(
            f"{path}: {'holds no sample below its head line' if head else 'is empty'}; allowed: a "
            "line with the names of columns, such as time,wx,wy,wz,ax,ay,az, and a line a sample"
        )
    if wrong := [k for k, row in enumerate(cells) if len(row) != len(head)]:
        raise RecordingError(
            f"{path}: sample {wrong[0]} has {len(cells[wrong[0]])} cells, the head {len(head)}"
        )
    found: dict[str, Any] = {"sensors": {}}
    if columns is None:
        columns = _default_columns(path, head)
        time_unit = "ns" if columns["time"] == "time_ns" else time_unit
    table = _Table(path, head, cells, delimiter)
    for argument, names in by_argument(columns).items():
        if argument == "time":
            found["time"] = table.times(names, time_unit)
        elif argument in SENSORS:
            found["sensors"][argument] = table.array(argument, names)
        elif argument in MASKS:
            values = table.array(argument, names)
            found[argument] = np.where(np.isin(values, (0, 1)), values, -1).astype(int)
        else:
            found[argument] = table.array(argument, names)
    if unread := ", ".join(name for name in head if name not in table.used):
        found["notes"] = (f"columns that are not used: {unread}",)
    return found


def by_argument(columns: Columns) -> Columns:
    """Columns by the names of arguments, without `ALIASES`.

    Raises:
        RecordingError: an argument has two names.
    """
    for alias, argument in ALIASES.items():
        if alias in columns and argument in columns:
            raise RecordingError(f"columns: {alias} and {argument}; allowed: one of the two")
    return {ALIASES.get(name, name): names for name, names in columns.items()}


def _refuse_other_separator(path: Path, head: str, *, comment: bool) -> None:
    """Raise a RecordingError if a head line that is one cell has other separators than expected."""
    for mark, words in {";": "semicolons", "\t": "tabs", " ": "spaces"}.items():
        if mark in head and mark == " " and comment:
            raise RecordingError(
                f"{path}: its first line is a comment, {head!r}; allowed: the names of columns, "
                "such as time,wx,wy,wz,ax,ay,az"
            )
        if mark in head:
            raise RecordingError(
                f"{path}: its columns are separated by {words}; allowed: commas, or the line "
                f"delimiter = {json.dumps(mark)} in {path.name}.toml beside it, in Python "
                "delimiter="
            )


class _Table:
    """The cells of a file, by column."""

    def __init__(self, path: Path, head: list[str], cells: list[list[str]], delimiter: str) -> None:
        self.path, self.head, self.cells = path, head, cells
        self.marks = "." if delimiter == "," else ".,"
        """What may be a decimal mark: a comma only where it separates no columns."""
        self.mark = ""
        """That of the file, once one has been read."""
        self.used = {"time", "time_ns"}
        """Names of the columns that have been read; one time is enough."""

    def array(self, argument: str, names: Any) -> np.ndarray:
        """Numbers (K, ...) of columns; nested lists of names make the axes after the first."""
        if not isinstance(names, str):
            return np.stack([self.array(argument, name) for name in names], axis=1)
        return np.array([self._number(names, k, cell) for k, cell in self._column(argument, names)])

    def times(self, name: Any, unit: str) -> np.ndarray:
        """Time stamps (K,) as for `from_arrays`: floats in s or integers in ns."""
        if unit == "s":
            return self.array("time", name)
        try:
            whole = [int(cell) for _, cell in self._column("time", name)]
            return np.array(whole, np.int64) * 10 ** TIME_UNITS[unit]
        except ValueError:  # not integers
            return self.array("time", name) * {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]

    def _column(self, argument: str, name: Any) -> list[tuple[int, str]]:
        if self.head.count(name) != 1:
            what = "no column" if name not in self.head else "more than one column"
            raise RecordingError(
                f"{self.path}: {what} {name!r}, for {argument}; it has: {', '.join(self.head)}"
            )
        self.used.add(name)
        at = self.head.index(name)
        return [(k, row[at].strip()) for k, row in enumerate(self.cells)]

    def _number(self, name: str, k: int, cell: str) -> float:
        try:
            return float(self._with_point(cell)) if cell else float("nan")
        except ValueError:
            marked = f" with the decimal mark {self.mark!r} of the file" if self.mark else ""
            raise RecordingError(
                f"{self.path}: {cell!r} in column {name!r} of sample {k} is not a number{marked}"
            ) from None

    def _with_point(self, cell: str) -> str:
        """A cell with a decimal point, whatever the file's decimal mark; one file has one."""
        for mark in self.marks:
            if mark in cell:
                self.mark = self.mark or mark
                if mark != self.mark:
                    raise ValueError("another mark than before")
        return cell.replace(",", ".") if self.mark == "," else cell


def _default_columns(path: Path, head: list[str]) -> dict[str, Any]:
    """Those of `COLUMNS` that a file has, with its vectors and landmarks."""
    found, lacking = {}, {}
    for argument, names in COLUMNS.items():
        each = [names] if isinstance(names, str) else names
        missing = [name for name in each if name not in head]
        if not missing:
            found[argument] = names
        elif len(missing) < len(each) or argument in ("time", "angular_velocity"):
            lacking[argument] = " ".join(missing)
    if "time_ns" in head:
        found["time"] = "time_ns"
        lacking.pop("time", None)
    if lacking:
        words = ", ".join(f"{names} ({argument})" for argument, names in lacking.items())
        raise RecordingError(
            f"{path}: lacks {words}; it has: {', '.join(head)}; allowed: all columns of "
            "a quantity (time in s, or time_ns; wx wy wz in rad/s), or other names that a file "
            f"{path.name}.toml beside it lists (docs/recordings.md), in Python columns="
        )
    return found | _sightings(path, head)


def _sightings(path: Path, head: list[str]) -> dict[str, list[list[str]]]:
    """The columns of a file's vectors and landmarks, by argument."""
    numbers: dict[str, set[str]] = {}
    for name in head:
        if match := SIGHTING.fullmatch(name):
            numbers.setdefault(match["kind"], set()).add(match["number"])
    found = {}
    for kind, each in numbers.items():
        names = [[f"{kind}{n}_{axis}" for axis in "xyz"] for n in sorted(each, key=int)]
        if lacking := [name for three in names for name in three if name not in head]:
            raise RecordingError(
                f"{path}: lacks {', '.join(lacking)}; {KINDS[kind]} have three columns each, such "
                f"as {kind}0_x {kind}0_y {kind}0_z"
            )
        found[KINDS[kind]] = names
    return found
