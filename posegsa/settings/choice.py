"""A field that holds one of several sections, told apart by a key that all of them have."""

import json
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from posegsa.settings.violations import Refused, Violation

Kind = TypeVar("Kind", bound=BaseModel)


class Choice(Generic[Kind]):
    """Marks such a field: `Annotated[Base, Choice("kind", {"this": This, "that": That})]`.

    Args:
        key: The key; in each section a field that holds the section's name.
        kinds: The sections by name. The first one is meant where a table has no such key.
    """

    def __init__(self, key: str, kinds: Mapping[str, type[Kind]]) -> None:
        self.key, self.kinds = key, kinds

    def kind(self, value: object) -> type[Kind]:
        """The section that a value is meant to be; the first one if it does not say."""
        name = self._name(value)
        known = isinstance(name, str) and name in self.kinds
        return self.kinds[name if known else next(iter(self.kinds))]

    def _name(self, value: object) -> Any:
        """The name of the section that a value is, or is to become; None if it can't be one."""
        if isinstance(value, Mapping):
            return value.get(self.key, next(iter(self.kinds)))
        return getattr(value, self.key, None)

    def _named(self, value: object) -> object:
        """Refuse a name that no section has."""
        name = self._name(value)
        if name is not None and name not in list(self.kinds):
            allowed = " or ".join(map(json.dumps, self.kinds))
            raise Refused(Violation(self.key, f"allowed: {allowed}", name))
        return value

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        choices = {name: handler.generate_schema(kind) for name, kind in self.kinds.items()}
        union = core_schema.tagged_union_schema(choices, discriminator=self._name)
        return core_schema.no_info_before_validator_function(self._named, union)
