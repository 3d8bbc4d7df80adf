"""The types of configuration fields, and the base class of all sections.

Numbers are strict: `"1"` and `true` are not numbers, `1.0` is not an integer, nothing is infinite.
All are bounded, to prevent absurd computations and allocations.
Arrays become tuples, so sections can be hashed, compared, and static under JAX's jit.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    ValidationError,
    model_validator,
)

from posegsa.settings.violations import Refused, Violation, config_error, refusal

MAX_NUMBER, MIN_POSITIVE = 1e9, 1e-9
"""Bounds of numbers, chosen so that products of several of them fit into float32."""
MAX_COUNT = 10**6
"""Bound of counts. The memory that they need together is checked before a search."""
MAX_SAMPLES = 10**7

Number = Annotated[float, Strict(), Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
NonNegative = Annotated[float, Strict(), Field(ge=0, le=MAX_NUMBER)]
Positive = Annotated[float, Strict(), Field(ge=MIN_POSITIVE, le=MAX_NUMBER)]
Epsilon = Annotated[float, Strict(), Field(ge=float(np.finfo(np.float32).tiny), le=MAX_NUMBER)]
"""A number added to avoid division by zero; smaller ones would be 0 in float32."""
Share = Annotated[float, Strict(), Field(ge=0, le=1)]
Count = Annotated[int, Strict(), Field(ge=1, le=MAX_COUNT)]
Index = Annotated[int, Strict(), Field(ge=0, le=MAX_SAMPLES)]
Flag = Annotated[bool, Strict()]
Vector3 = tuple[Number, Number, Number]
Vector6 = tuple[Number, Number, Number, Number, Number, Number]
Matrix3 = tuple[Vector3, Vector3, Vector3]


def _ascending(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise refusal(ends, "a first value that is not above the second")
    return ends


Ascending = AfterValidator(_ascending)
"""Validates a pair: its first value is not above the second."""


class Tunable:
    """Marks a number that a search may tune.

    Args:
        name: Another field of the section on which its effect depends; by default none.
        value: The value of that field with which the number has an effect; without one, any
            but "off".
    """

    def __init__(self, name: str | None = None, value: object = None) -> None:
        self._name, self._value = name, value

    def has_effect(self, section: "Section") -> bool:
        """Whether the number has an effect in a section."""
        if self._name is None:
            return True
        other = getattr(section, self._name)
        return other != "off" if self._value is None else other == self._value


class Section(BaseModel):
    """One table of the configuration: frozen, and without unknown keys.

    The docstring under each field is its description.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def described(self) -> Iterator[tuple[str, Any, str]]:
        """Name, value as plain data and description of each field, also of nested sections."""
        plain = self.model_dump(mode="json")
        for name, field in type(self).model_fields.items():
            if isinstance(section := getattr(self, name), Section):
                for key, value, description in section.described():
                    yield f"{name}.{key}", value, description
            else:
                yield name, plain[name], " ".join((field.description or "").split())
        for name in self.model_extra or ():  # of a filter of the user's own
            yield name, plain[name], "A number of the filter."

    @model_validator(mode="before")
    @classmethod
    def _with_numbers_of_python(cls, values: Any) -> Any:
        """Convert NumPy scalars, which strict fields refuse."""
        if not isinstance(values, Mapping):
            return values
        return {k: v.item() if isinstance(v, np.generic) else v for k, v in values.items()}

    def _conflicts(self) -> Iterator[Violation]:
        """Conflicts between fields that are valid on their own."""
        yield from ()

    @model_validator(mode="after")
    def _refuse_conflicts(self) -> Self:
        if violations := list(self._conflicts()):
            raise Refused(*violations)
        return self

    if not TYPE_CHECKING:  # type checkers keep the signature that pydantic derives from the fields

        def __init__(self, /, **values: Any) -> None:
            """Validate the values; a problem raises a `ConfigError`."""
            try:
                super().__init__(**values)
            except ValidationError as error:
                title = f"not a valid {type(self).__name__}"
                raise config_error(title, error, type(self)) from None

        # With this mark pydantic validates nested sections without calling __init__, so that the
        # outer section reports their errors with their full keys.
        __init__.__pydantic_base_init__ = True
