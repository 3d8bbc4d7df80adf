"""Storage of records as JSON, and of records with columns as tables (CSV).

The types of a record's fields state what it may contain. Reading checks them strictly, and errors
name the path of the field: no field may be missing or unknown, types and shapes of arrays must
match, and numbers must be finite unless the type allows others. Texts must be printable, so that
nothing in a file can control a terminal. Nothing is ever unpickled.

Records are dataclasses, named tuples and typed dictionaries. Their fields are numbers, texts,
arrays (`posegsa.settings.arrays`), sections of a configuration, records, and lists, dictionaries
and unions of these. Numbers are read back bit for bit.
"""

import dataclasses
import hashlib
import json
import reprlib
import typing
from collections.abc import Mapping
from functools import cache, partial, reduce
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NoReturn, TypeVar, Union

import numpy as np
import pydantic
from pydantic import AfterValidator, BaseModel, Strict

from posegsa.errors import RunFolderError
from posegsa.settings.arrays import Columns
from posegsa.settings.plain import csv_text, decimal, json_text, plain, stored_fields

Record = TypeVar("Record")

_SHOWN = 3
"""Maximum number of problems in one error message."""


# JSON ---------------------------------------------------------------------------------------------


def to_json(record: object, schema: int) -> str:
    """A record as JSON, with the version of its format and a digest of itself."""
    data = plain(record)
    return json_text({"schema": schema, "digest": _digest(data)} | data) + "\n"


def _digest(data: object) -> str:
    """SHA-256 of plain data, whatever their layout in a file."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def from_json(
    kind: type[Record],
    text: str,
    schema: int,
    source: Path,
    *,
    edited: bool = False,
    if_on_purpose: str = "run it again",
) -> Record:
    """Read what `to_json` wrote, from the file that errors name.

    Args:
        kind: The record's type.
        text: The file's text.
        schema: The version of the format.
        source: The file.
        edited: Whether it may have been changed since it was written.
        if_on_purpose: What to do with a file that was changed on purpose, for the error.

    Raises:
        RunFolderError: It is not such a record, has another format, or was changed.
    """

    def refuse(word: str) -> NoReturn:  # Python accepts NaN and Infinity, which are not JSON
        raise ValueError(word)

    try:
        data = json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise RunFolderError(f"{source}: is not JSON: {error}") from None
    if not isinstance(data, dict):
        raise RunFolderError(f"{source}: {reprlib.repr(data)}; allowed: an object")
    found = data.pop("schema", "none")
    if type(found) is not int or found != schema:
        writer = data.get("version")
        writer = f"posegsa {reprlib.repr(writer)}" if writer else "a version that it does not name"
        raise RunFolderError(
            f"{source}: schema = {reprlib.repr(found)}, written by {writer}; this version reads "
            f"schema {schema}: run it again, or read it with the version that wrote it"
        )
    digest = data.pop("digest", None)
    record = from_plain(kind, data, source)  # before the digest: it names the wrong field
    if not edited and digest != _digest(data):
        raise RunFolderError(
            f"{source}: was changed after posegsa wrote it (its digest differs); if on purpose, "
            f"{if_on_purpose}"
        )
    return record


def from_plain(kind: type[Record], data: object, source: Path) -> Record:
    """A record from plain data, in JSON's types.

    Raises:
        RunFolderError: It is not such a record.
    """
    try:
        return _adapter(kind).validate_python(data, context={})
    except pydantic.ValidationError as error:
        problems = error.errors(include_url=False)
        words = "; ".join(_words(problem) for problem in problems[:_SHOWN])
        more = f"; and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
        raise RunFolderError(f"{source}: {words}{more}") from None


def _words(problem: Mapping[str, Any]) -> str:
    """One problem that pydantic found: the path of the field, its value and what is allowed."""
    path = ".".join(map(str, problem["loc"])) or "the whole record"
    given = problem["input"]
    given = "" if isinstance(given, dict | list) else f" = {reprlib.repr(given)}"
    reason = problem.get("ctx", {}).get("error") or problem["msg"]
    words = f"{path}{given}: {reason}"
    # Names of fields come from the file and must not control the terminal.
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in words)


@cache
def _adapter(kind: Any) -> pydantic.TypeAdapter:
    return pydantic.TypeAdapter(_strict(kind))


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("allowed: printable text")
    return text


_SCALARS = {
    bool: Annotated[bool, Strict()],
    int: Annotated[int, Strict()],
    float: Annotated[float, Strict(), pydantic.AllowInfNan(False)],
    str: Annotated[str, Strict(), AfterValidator(_printable)],
}


def _strict(kind: Any) -> Any:
    """The annotated type with which pydantic reads a type strictly from plain data."""
    origin: Any = typing.get_origin(kind)
    parts = typing.get_args(kind)
    if origin is Annotated:
        return Annotated[(_strict(parts[0]), *parts[1:])]
    if kind in _SCALARS:
        return _SCALARS[kind]
    if dataclasses.is_dataclass(kind) or typing.is_typeddict(kind) or hasattr(kind, "_fields"):
        return _strict_record(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return Annotated[kind, pydantic.PlainValidator(partial(_section, kind))]
    if origin is None or origin is Literal:
        return kind
    inner = tuple(_strict(part) for part in parts)
    return reduce(or_, inner) if origin in (Union, UnionType) else origin[inner]


def _section(kind: type[BaseModel], data: Any) -> BaseModel:
    """A section of a configuration; its constructor explains what is wrong."""
    if not isinstance(data, dict):
        raise ValueError("allowed: a table")
    return kind(**data)


def _strict_record(kind: Any) -> Any:
    name = kind.__name__
    hints = typing.get_type_hints(kind, include_extras=True)
    if dataclasses.is_dataclass(kind):
        hints = {field.name: hints[field.name] for field in stored_fields(kind)}
    # A tuple's field with a default may be missing: runs of earlier versions lack it.
    defaults = getattr(kind, "_field_defaults", {})
    fields: dict[str, Any] = {
        name: (_strict(hint), defaults.get(name, ...)) for name, hint in hints.items()
    }
    model = pydantic.create_model(name, __config__=pydantic.ConfigDict(extra="forbid"), **fields)
    return Annotated[model, AfterValidator(partial(_made, kind))]


def _made(kind: Any, found: BaseModel) -> Any:
    """The record made of the fields that were read."""
    return kind(**dict(found))


# Tables -------------------------------------------------------------------------------------------


def to_csv(record: object, counted: str = "") -> str:
    """A record of columns as CSV, with a header and a row for each sample or iteration.

    `counted` is the name of an optional first column that counts the rows from 1.
    """
    header, columns = [], []
    for field, spec in _columns(type(record)).items():
        array = decimal(np.asarray(getattr(record, field)))
        table = array.reshape(len(array), array[:1].size)
        header += spec.of(table.shape[1] // len(spec.names))
        columns += table.T.tolist()
    if counted:
        header, columns = [counted, *header], [range(1, len(columns[0]) + 1), *columns]
    return csv_text(header, zip(*columns, strict=True))


def _columns(kind: Any) -> dict[str, Columns]:
    return {
        field: spec
        for field, hint in typing.get_type_hints(kind, include_extras=True).items()
        for spec in hint.__metadata__
        if isinstance(spec, Columns)
    }
