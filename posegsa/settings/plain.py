"""Records as plain data, and plain data as JSON and CSV text."""

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field, fields, is_dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel


def plain(value: Any) -> Any:
    """The value in JSON's types; infinity and NaN become strings that `float` reads.

    Args:
        value: Numbers, texts, arrays, sections of a configuration, and containers of them; records
            are dataclasses, named tuples and mappings with their fields' names as keys.
    """
    match value:
        case BaseModel():
            return value.model_dump(mode="json")
        case np.ndarray() | np.generic():
            return plain(value.tolist())
        case float() if not math.isfinite(value):
            return str(value)
        case Mapping():
            return {key: plain(each) for key, each in value.items()}
        case tuple() if names := getattr(value, "_fields", ()):
            return {name: plain(each) for name, each in zip(names, value, strict=True)}
        case list() | tuple():
            return [plain(each) for each in value]
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in stored_fields(value)}
    return value


def stored_fields(kind: Any) -> list[Field[Any]]:
    """The fields of a dataclass that are stored: all but those with the metadata stored=False."""
    return [field for field in fields(kind) if field.metadata.get("stored", True)]


def decimal(array: np.ndarray) -> np.ndarray:
    """Float32 numbers as the float64 nearest to their shortest decimal form; others unchanged.

    So 0.01 is written as 0.01, not as 0.009999999776482582. Converted back they are the same bits.
    """
    return array.astype(str).astype(np.float64) if array.dtype == np.float32 else array


def json_text(value: Any, indent: str = "") -> str:
    """Plain data as JSON with one key per line; a list of numbers is on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        parts = [f"{json.dumps(key)}: {json_text(each, inner)}" for key, each in value.items()]
        opening, closing = "{", "}"
    elif isinstance(value, list) and any(isinstance(each, list | dict) for each in value):
        parts = [json_text(each, inner) for each in value]
        opening, closing = "[", "]"
    else:
        return json.dumps(value, allow_nan=False)
    lines = ",\n".join(inner + part for part in parts)
    return f"{opening}\n{lines}\n{indent}{closing}"


def csv_text(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Rows of cells as CSV with a header."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
