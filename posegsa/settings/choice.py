"""A field that is one of several sections, distinguished by a key that all of them have."""

from collections.abc import Mapping

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema


class Choice:
    """Marks such a field: `Annotated[Base, Choice("kind", {"this": This, "that": That})]`.

    Args:
        key: The key, a field of each section that contains the section's name.
        kinds: The sections by name. A table without the key is the first one.
    """

    def __init__(self, key: str, kinds: Mapping[str, type[BaseModel]]) -> None:
        self.key, self.kinds = key, kinds

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        choices = {name: handler.generate_schema(kind) for name, kind in self.kinds.items()}
        union = core_schema.tagged_union_schema(choices, discriminator=self.key)
        return core_schema.no_info_before_validator_function(self._named, union)

    def _named(self, value: object) -> object:
        """The table with its key, by default that of the first section."""
        return {self.key: next(iter(self.kinds)), **value} if isinstance(value, Mapping) else value
