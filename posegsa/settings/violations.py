"""Messages for invalid configurations: the key, the value, what is allowed.

Pydantic reports what a field's type allows; validators raise `Refused` for everything else. This
module adds the dotted key, the value in TOML, and for misspelt words the nearest known one.
"""

import difflib
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from posegsa.errors import ConfigError
from posegsa.words import toml

ABSENT = object()
"""Marks a value that was not given."""

_Path = tuple[int | str, ...]
_Table = Mapping[Any, FieldInfo]
_LINE = 96  # characters of a reason in a line of a message
_SHOWN = 100  # characters of a value that are shown


@dataclass(frozen=True)
class Violation:
    """One thing wrong with a configuration."""

    key: str
    """Dotted path of the key, such as `filter.substeps`."""
    reason: str
    """What is wrong or what is allowed, in a few words."""
    value: object = ABSENT
    """The given value."""

    def __str__(self) -> str:
        given = "" if self.value is ABSENT else f" = {toml(self.value)}"
        if len(given) > _SHOWN:
            given = f"{given[:_SHOWN]}..."
        reason = textwrap.wrap(self.reason, _LINE, break_long_words=False, break_on_hyphens=False)
        return "\n    ".join([f"  {self.key or '(top level)'}{given}", *reason])

    def under(self, path: _Path) -> "Violation":
        """The violation with its key below the given one."""
        return replace(self, key=_dotted((*path, self.key) if self.key else path))


class Refused(ValueError):
    """Raised by validators, with keys relative to the validated value."""

    def __init__(self, *violations: Violation) -> None:
        super().__init__(*violations)
        self.violations = violations


def refusal(value: object, allowed: str) -> Refused:
    """The exception that the validator of a single field raises."""
    return Refused(Violation("", f"allowed: {allowed}", value))


def violations_error(title: str, violations: Iterable[Violation]) -> ConfigError:
    """The error that lists these violations under a title."""
    return ConfigError("\n\n".join([title, *map(str, violations)]))


def config_error(title: str, error: ValidationError, model: type[BaseModel]) -> ConfigError:
    """The error that lists under a title what pydantic found wrong with a model's data."""
    return violations_error(title, violations_of(error, model))


def violations_of(error: ValidationError, model: type[BaseModel]) -> list[Violation]:
    """The violations that pydantic found in a model's data."""
    found: dict[tuple[str, int], Violation] = {}
    for item in error.errors(include_url=False):
        for i, violation in enumerate(_violations(item, model.model_fields)):
            if other := found.get((violation.key, i)):  # every member of a union has its own reason
                violation = replace(violation, reason=f"{other.reason}, or {violation.reason}")
            found[violation.key, i] = violation
    # A union refuses the whole value too; the error about the wrong part of it says more.
    keys = [key for key, _ in found]
    return [v for v in found.values() if not any(k.startswith(f"{v.key}.") for k in keys)]


def _violations(item: Mapping[str, Any], model: _Table) -> Iterable[Violation]:
    context, value, reason = item.get("ctx", {}), item["input"], item["msg"]
    path, tables = _place(item["loc"], model)
    if isinstance(cause := context.get("error"), Refused):
        return [violation.under(path) for violation in cause.violations]
    match item["type"]:
        case "extra_forbidden":
            path = (*_place(item["loc"][:-1], model)[0], item["loc"][-1])
            value, reason = ABSENT, _unknown_key(path, item["input"], tables, model)
        case "missing":
            value, reason = ABSENT, "missing"
        case "tuple_type":
            reason = "Input should be an array"
        case "model_type" | "model_attributes_type" | "union_tag_not_found":
            reason = f"Input should be a table with the keys {_listed(tables)}"
        case "union_tag_invalid":  # the key that says which table is meant
            key = context["discriminator"].strip("'")
            path = (*path, key)
            value = value[key] if isinstance(value, Mapping) else context["tag"]
    if expected := context.get("expected") or context.get("expected_tags"):
        reason = f"Input should be {expected}"
        if nearest := _nearest(value, re.findall("'([^']*)'", expected)):
            reason += f"; did you mean '{nearest}'?"
    reason = re.sub("^(Input|Tuple) | after validation", "", reason)
    reason = re.sub(r"0\.0{4}\d+", lambda small: f"{float(small[0]):g}", reason)
    return [Violation(_dotted(path), reason, value)]


def _place(location: _Path, model: _Table) -> tuple[_Path, list[_Table]]:
    """The keys and indices of an error's location, and the tables that are possible there.

    Pydantic's location also names the members of unions, which do not appear in a file.
    """
    path, tables, chosen = (), [model], False
    for step in location:
        fields = [table[step] for table in tables if step in table]
        # After the name of a chosen table comes one of its keys, which may be the user's own.
        if fields or isinstance(step, int) or chosen:
            path = (*path, step)
        chosen = False
        if fields:
            tables = [table for field in fields for table in _tables_of(field)]
        else:
            tagged = [t for t in tables if any(step in get_args(f.annotation) for f in t.values())]
            tables, chosen = tagged or tables, bool(tagged)
    return path, tables


def _tables_of(field: FieldInfo) -> list[_Table]:
    """The tables that the value of a field may be."""
    for choice in field.metadata:
        if kinds := getattr(choice, "kinds", None):  # `settings.choice`
            return [kind.model_fields for kind in kinds.values()]
    return _tables(field.annotation)


def _tables(annotation: Any) -> list[_Table]:
    """The tables in a type, including those in unions and arrays."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation.model_fields]
    return [table for part in get_args(annotation) for table in _tables(part)]


def _unknown_key(path: _Path, value: object, tables: list[_Table], model: _Table) -> str:
    """Why a key is refused: with the nearest known key, the same key elsewhere, or all keys."""
    *above, key = path
    if nearest := _nearest(key, [known for table in tables for known in table]):
        return f"unknown key; did you mean {_dotted((*above, nearest))}?"
    inside = list(value) if isinstance(value, Mapping) else []  # of a section of earlier versions
    for each in (key, *inside):
        for section, field in model.items():
            if section not in above and any(each in table for table in _tables_of(field)):
                return f"unknown key; did you mean {section}.{each}?"
    return f"unknown key; known here: {_listed(tables)}"


def _nearest(word: object, known: Iterable[str]) -> str | None:
    """The known word nearest to the given one, if any is near."""
    lowered = {candidate.lower(): candidate for candidate in known}
    found = difflib.get_close_matches(str(word).lower(), lowered, n=1, cutoff=0.6)
    return lowered[found[0]] if found else None


def _listed(tables: list[_Table]) -> str:
    return ", ".join(dict.fromkeys(key for table in tables for key in table))


def _dotted(path: _Path) -> str:
    return ".".join(map(str, path))
