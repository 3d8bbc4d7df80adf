"""The types that configuration fields are made of, and the base of every section.

Numbers are strict: `"1"` and `true` are not numbers, `1.0` is not an integer, nothing is infinite.
All are bounded, so that nothing absurd is computed with, or allocated.
Arrays become tuples, so that every section can be hashed, compared, and static under JAX's jit.
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
"""Bounds of numbers: float32 holds these, and products of some of them, with room."""
MAX_COUNT = 10**6
"""Bound of counts; what all of them together need of memory is checked before a search."""
MAX_SAMPLES = 10**7

Number = Annotated[float, Strict(), Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
NonNegative = Annotated[float, Strict(), Field(ge=0, le=MAX_NUMBER)]
Positive = Annotated[float, Strict(), Field(ge=MIN_POSITIVE, le=MAX_NUMBER)]
Epsilon = Annotated[float, Strict(), Field(ge=float(np.finfo(np.float32).tiny), le=MAX_NUMBER)]
"""What is added against division by zero: a smaller number would be 0 in float32."""
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
"""Of a pair: its first value is not above the second."""


class Tunable:
    """Marks a number that a search may tune.

    Args:
        name: Another field of the section, with which alone it has an effect; by default none.
        value: What that field must be.
    """

    def __init__(self, name: str | None = None, value: object = None) -> None:
        self._name, self._value = name, value

    def has_effect(self, section: "Section") -> bool:
        """Whether the number has an effect in a section."""
        return self._name is None or getattr(section, self._name) == self._value


class Section(BaseModel):
    """One table of the configuration: frozen, and closed to keys that it does not know.

    The docstring under each field is its description.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def described(self) -> Iterator[tuple[str, Any, str]]:
        """Name, value as plain data and description of each field, of sections inside each key."""
        plain = self.model_dump(mode="json")
        for name, field in type(self).model_fields.items():
            if isinstance(section := getattr(self, name), Section):
                for key, value, description in section.described():
                    yield f"{name}.{key}", value, description
            else:
                yield name, plain[name], " ".join((field.description or "").split())

    @model_validator(mode="before")
    @classmethod
    def _with_numbers_of_python(cls, values: Any) -> Any:
        """Strict fields would refuse NumPy's scalars."""
        if not isinstance(values, Mapping):
            return values
        return {k: v.item() if isinstance(v, np.generic) else v for k, v in values.items()}

    def _conflicts(self) -> Iterator[Violation]:
        """What is wrong between the fields, each of them valid in itself."""
        yield from ()

    @model_validator(mode="after")
    def _refuse_conflicts(self) -> Self:
        if violations := list(self._conflicts()):
            raise Refused(*violations)
        return self

    if not TYPE_CHECKING:  # type checkers keep the signature that pydantic derives from the fields

        def __init__(self, /, **values: Any) -> None:
            """Validates the values; what is wrong with them comes as a `ConfigError`."""
            try:
                super().__init__(**values)
            except ValidationError as error:
                title = f"not a valid {type(self).__name__}"
                raise config_error(title, error, type(self)) from None

        # So marked, only calls from outside pass through here: pydantic validates sections inside
        # sections directly, and what is wrong with them arrives above with its full key.
        __init__.__pydantic_base_init__ = True
