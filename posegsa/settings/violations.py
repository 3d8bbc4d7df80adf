"""From what pydantic found to text that a person can act on: the key, the value, what is allowed.

What is allowed is read from the JSON schema of the types, so that no message repeats, or outlives,
what a type says. What a type cannot say, validators say with `Refused`.
"""

import difflib
import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel, ValidationError

from posegsa.errors import ConfigError

ABSENT = object()
"""Stands for a value that was not given."""

_Path = tuple[int | str, ...]
_Schema = Mapping[str, Any]
_WIDTH = 100  # characters in a line of a message
_SHOWN = 100  # characters of a value that are shown


@dataclass(frozen=True)
class Violation:
    """One thing wrong with a configuration."""

    key: str
    """Dotted path of the key, such as `filter.substeps`."""
    reason: str
    """What is allowed instead, or what is wrong, in a few words."""
    value: object = ABSENT
    """What was given."""

    def __str__(self) -> str:
        given = "" if self.value is ABSENT else f" = {_show(self.value)}"
        reason = textwrap.wrap(
            self.reason, _WIDTH - 4, break_long_words=False, break_on_hyphens=False
        )
        return "\n    ".join([f"  {self.key or '(top level)'}{given}", *reason])

    def under(self, path: _Path) -> "Violation":
        """The same problem, its key below the given one."""
        return Violation(_dotted((*path, self.key) if self.key else path), self.reason, self.value)


class Refused(ValueError):
    """Raised by validators: what is wrong, by keys relative to what they look at."""

    def __init__(self, *problems: Violation) -> None:
        super().__init__(*problems)
        self.problems = problems


def refuse(value: object, allowed: str) -> Refused:
    """The exception by which the validator of one field refuses its value."""
    return Refused(Violation("", f"allowed: {allowed}", value))


def report(title: str, problems: Sequence[Violation]) -> ConfigError:
    """The error that lists these problems under a title."""
    return ConfigError("\n\n".join([title, *map(str, problems)]))


def config_error(
    title: str, error: ValidationError, data: object, model: type[BaseModel]
) -> ConfigError:
    """The error that says in words what pydantic found.

    Args:
        title: First line of the message, such as the file's name.
        error: What pydantic raised.
        data: What it was given.
        model: The type that it was to become.
    """
    schema = _schema(model)
    found: dict[str, Violation] = {}
    for item in error.errors(include_url=False):
        for problem in _problems(item, data, schema):
            found.setdefault(problem.key, problem)
    # A union reports the whole value beside the part of it that is wrong: the part says more.
    parts = [p for p in found.values() if not any(k.startswith(f"{p.key}.") for k in found)]
    return report(title, parts)


@cache
def _schema(model: type[BaseModel]) -> _Schema:
    return model.model_json_schema()


def _problems(item: Mapping[str, Any], data: object, schema: _Schema) -> Iterator[Violation]:
    """The problems that one error of pydantic's stands for."""
    kind, location = item["type"], item["loc"]
    path, value = _follow(data, location)
    cause = item.get("ctx", {}).get("error")
    if isinstance(cause, Refused):
        yield from (problem.under(path) for problem in cause.problems)
    elif kind in ("extra_forbidden", "invalid_key"):
        yield Violation(_dotted(path), _unknown_key(path, schema))
    elif kind == "missing" and isinstance(location[-1], str):
        path = (*path, location[-1])
        yield Violation(
            _dotted(path), f"missing; needed: {_allowed(_locate(schema, path), schema)}"
        )
    else:
        options = _locate(schema, path)
        reason = f"allowed: {_allowed(options, schema)}"
        yield Violation(_dotted(path), reason + _suggestion(value, _choices(options)), value)


def _follow(data: object, location: _Path) -> tuple[_Path, object]:
    """The steps of an error's location that exist in the data, and the value there.

    The others name members of unions, or entries that a too short array lacks.
    """
    path: _Path = ()
    for step in location:
        parts: Any = dict(enumerate(data)) if isinstance(data, list | tuple) else data
        if isinstance(parts, Mapping) and step in parts:
            data = parts[step]
            path = (*path, step)
    return path, data


def _unknown_key(path: _Path, schema: _Schema) -> str:
    """Why a key is refused: with the nearest key beside it, or its like elsewhere, or all keys."""
    key = str(path[-1])
    beside = list(_keys(_locate(schema, path[:-1])))
    if nearest := _nearest(key, beside):
        return f'unknown key; did you mean "{_dotted((*path[:-1], nearest))}"?'
    sections = _keys([schema]) if path[:-1] else ()
    for section in sections:
        if key in _keys(_locate(schema, (section,))):
            return f'unknown key; did you mean "{section}.{key}"?'
    return f"unknown key; known here: {', '.join(beside)}"


def _nearest(word: str, known: Sequence[str]) -> str | None:
    """The known word most like the given one, if any is."""
    lowered = {candidate.lower(): candidate for candidate in known}
    found = difflib.get_close_matches(word.lower(), lowered, n=1, cutoff=0.7)
    return lowered[found[0]] if found else None


def _suggestion(value: object, choices: Sequence[str]) -> str:
    """A question after a misspelt word."""
    nearest = _nearest(value, choices) if isinstance(value, str) else None
    return f'; did you mean "{nearest}"?' if nearest else ""


def _locate(schema: _Schema, path: _Path) -> list[_Schema]:
    """The schemas that a value at this path may follow."""
    nodes = _options(schema, schema)
    for step in path:
        nodes = [option for node in nodes for option in _options(_child(node, step), schema)]
    return nodes


def _options(node: _Schema, root: _Schema) -> list[_Schema]:
    """The node's alternatives, references resolved."""
    if "$ref" in node:
        return _options(root["$defs"][node["$ref"].rpartition("/")[2]], root)
    if "anyOf" in node:
        return [option for part in node["anyOf"] for option in _options(part, root)]
    return [node] if node else []


def _child(node: _Schema, step: int | str) -> _Schema:
    """The schema of one key of a table or one entry of an array; empty if there is none."""
    if isinstance(step, str):
        return node.get("properties", {}).get(step, {})
    entries = node.get("prefixItems", [])
    return entries[step] if step < len(entries) else node.get("items") or {}


def _keys(nodes: Sequence[_Schema]) -> Sequence[str]:
    """The keys of a table."""
    return [key for node in nodes for key in node.get("properties", {})]


def _choices(nodes: Sequence[_Schema]) -> list[str]:
    """The words that are allowed."""
    return [
        w for node in nodes for w in node.get("enum", [node["const"]] if "const" in node else [])
    ]


def _allowed(nodes: Sequence[_Schema], root: _Schema) -> str:
    """What these schemas allow, in words."""
    return " or ".join(_describe(node, root) for node in nodes)


def _describe(node: _Schema, root: _Schema) -> str:
    """What one schema allows, in words."""
    if choices := _choices([node]):
        return " or ".join(json.dumps(choice) for choice in choices)
    match node["type"]:
        case "boolean":
            return "true or false"
        case "integer":
            return "an integer" + _bounds(node)
        case "number":
            return "a finite number" + _bounds(node)
        case "array":
            count = f" of at most {node['maxItems']}" if "maxItems" in node else ""
            count = f" of {node['minItems']}" if "minItems" in node else count
            return f"an array{count}, each {_allowed(_options(_child(node, 0), root), root)}"
        case _:
            return f"a table with the keys {', '.join(_keys([node]))}"


def _bounds(node: _Schema) -> str:
    """The limits of a number, in words."""
    signs = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    limits = [f"{sign} {_limit(node[key])}" for key, sign in signs.items() if key in node]
    return f" {' and '.join(limits)}" if limits else ""


def _limit(number: float) -> str:
    return f"{number:g}" if isinstance(number, float) else str(number)


def _dotted(path: _Path) -> str:
    return ".".join(map(str, path))


def _show(value: object) -> str:
    """A value as TOML would have it, cut short where it is long."""
    text = _toml(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def _toml(value: object) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False)
        case list() | tuple():
            return f"[{', '.join(map(_toml, value))}]"
        case Mapping():
            return f"{{{', '.join(f'{k} = {_toml(v)}' for k, v in value.items())}}}"
        case _:
            return repr(value)
