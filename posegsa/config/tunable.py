"""Numbers other than k1..k22 that a search may tune: of filter, error signal and weights."""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Literal, NamedTuple, get_args

from pydantic import ValidationError

from posegsa.settings.fields import Number, Section, Tunable
from posegsa.settings.violations import Violation, violations_of


class AlsoTuned(Section):
    """[[parameters.also]]: a further number that is searched together with k1..k22."""

    key: str
    """Its key, such as "filter.vector_bias_gain" or "scenario.vectors.0.weight"."""
    lower: Number
    """Lower bound, in the unit of the key."""
    upper: Number
    """Upper bound, in the unit of the key."""
    scale: Literal["linear", "logarithmic"] = "linear"
    """Whether the number itself is searched, or its logarithm."""

    def _conflicts(self) -> Iterator[Violation]:
        if self.lower > self.upper:
            yield Violation("lower", f"allowed: at most upper = {self.upper}", self.lower)
        if self.scale == "logarithmic" and self.lower <= 0:
            reason = 'allowed: above 0, because scale = "logarithmic"'
            yield Violation("lower", reason, self.lower)


class _Place(NamedTuple):
    """The location of a tunable number: section, field, and index in the field."""

    section: Section
    field: str
    index: int | None

    def refusal(self, value: float) -> str | None:
        """Why the section refuses a value for this number; None if it is allowed."""
        given: Any = value
        if self.index is not None:
            given = list(getattr(self.section, self.field))
            given[self.index] = value
        try:
            # Calling the section would raise a ConfigError with the wrong key.
            type(self.section).model_validate(dict(self.section) | {self.field: given})
        except ValidationError as error:
            return violations_of(error, type(self.section))[0].reason
        return None


Places = Mapping[str, _Place]
"""Locations of the tunable numbers of a configuration, by key."""


def tunable(experiment: Section) -> dict[str, _Place]:
    """The numbers of an experiment that a search may tune and that have an effect, by key."""
    return dict(_places(experiment, ""))


def _places(value: Any, path: str) -> Iterator[tuple[str, _Place]]:
    if isinstance(value, tuple):
        for i, each in enumerate(value):
            if isinstance(each, tuple | Section):
                yield from _places(each, f"{path}.{i}")
    if not isinstance(value, Section):
        return
    for name, mark in _fields(type(value)):
        inner, key = getattr(value, name), f"{path}.{name}" if path else name
        if mark is None:
            if isinstance(inner, tuple | Section):
                yield from _places(inner, key)
        elif mark.has_effect(value):
            if isinstance(inner, tuple):
                for i in range(len(inner)):
                    yield f"{key}.{i}", _Place(value, name, i)
            elif not isinstance(inner, str):  # "off" is no number
                yield key, _Place(value, name, None)
    for name in value.__pydantic_extra__ or {}:  # the numbers of a user's own filter
        yield f"{path}.{name}", _Place(value, name, None)


@cache
def _fields(kind: type[Section]) -> tuple[tuple[str, Tunable | None], ...]:
    """The fields of a kind of section that are tunable, with their marks, or may hold such fields.

    They are found once: an experiment is checked at each change, and most sections have none.
    """
    found = []
    for name, field in kind.model_fields.items():
        mark = next((one for one in field.metadata if isinstance(one, Tunable)), None)
        if mark is not None or _may_hold_tunable(field.annotation):
            found.append((name, mark))
    return tuple(found)


def _may_hold_tunable(annotation: Any) -> bool:
    """Whether values of a type may have tunable numbers within."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation.model_config.get("extra") == "allow" or bool(_fields(annotation))
    return any(map(_may_hold_tunable, get_args(annotation)))


def is_stated(section: Any, key: str) -> bool:
    """Whether a user has set the number with this key."""
    for name in key.split("."):
        if isinstance(section, Section):
            if name not in section.model_fields_set:
                return False
            section = getattr(section, name)
        elif name.isdecimal() and isinstance(section, tuple) and int(name) < len(section):
            section = section[int(name)]
        else:  # one number for several, such as gamma
            return True
    return True


def with_numbers(data: dict[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """An experiment as plain data with the numbers of some keys replaced, in place."""
    for key, value in values.items():
        *path, last = key.split(".")
        node: Any = data
        for name in path:
            node = node[int(name) if isinstance(node, list) else name]
        node[int(last) if isinstance(node, list) else last] = value
    return data


def number_at(section: Any, key: str) -> float:
    """The number of a key in an experiment."""
    for name in key.split("."):
        section = section[int(name)] if name.isdigit() else getattr(section, name)
    return float(section)


def also_conflicts(
    places: Places, also: tuple[AlsoTuned, ...], needless: tuple[AlsoTuned, ...]
) -> Iterator[Violation]:
    """The errors in the list of further numbers to tune.

    Those in `needless`, the defaults, may have no effect.
    """
    seen = set()
    for i, one in enumerate(also):
        if one.key not in places and one in needless:
            continue
        at = f"parameters.also.{i}"
        if one.key not in places:
            reason = f"cannot be tuned, or has no effect here; allowed: {', '.join(places)}"
            yield Violation(f"{at}.key", reason, one.key)
            continue
        if one.key in seen:
            yield Violation(f"{at}.key", "allowed: each key once", one.key)
        seen.add(one.key)
        for name in ("lower", "upper"):
            if refusal := places[one.key].refusal(getattr(one, name)):
                yield Violation(f"{at}.{name}", f"{one.key} {refusal}", getattr(one, name))
