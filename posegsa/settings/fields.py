"""The types that configuration fields are made of, and the base of every section.

Numbers are strict: `"1"` and `true` are not numbers, `1.0` is not an integer, nothing is infinite.
All are bounded, so that nothing absurd is computed with, or allocated.
Arrays become tuples, so that every section can be hashed, compared, and static under JAX's jit.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from posegsa.settings.violations import Refused, Violation, config_error

LARGEST, SMALLEST = 1e9, 1e-9
"""What numbers may be, so that float32 holds them, and products of some of them, with room."""
MOST = 10**6
"""What counts may be; what all of them together need is for `memory` to say."""
MOST_SAMPLES = 10**7

Number = Annotated[float, Strict(), Field(ge=-LARGEST, le=LARGEST)]
NonNegative = Annotated[float, Strict(), Field(ge=0, le=LARGEST)]
Positive = Annotated[float, Strict(), Field(ge=SMALLEST, le=LARGEST)]
Count = Annotated[int, Strict(), Field(ge=1, le=MOST)]
Index = Annotated[int, Strict(), Field(ge=0, le=MOST_SAMPLES)]
Flag = Annotated[bool, Strict()]
Vector3 = tuple[Number, Number, Number]
Vector6 = tuple[Number, Number, Number, Number, Number, Number]
Matrix3 = tuple[Vector3, Vector3, Vector3]


class Section(BaseModel):
    """One table of the configuration: frozen, and closed to keys that it does not know.

    The docstring under each field is its description.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )

    def _conflicts(self) -> Iterator[Violation]:
        """What is wrong between the fields, each of them valid in itself."""
        yield from ()

    @model_validator(mode="after")
    def _refuse_conflicts(self) -> Self:
        if problems := list(self._conflicts()):
            raise Refused(*problems)
        return self

    if not TYPE_CHECKING:  # type checkers keep the signature that pydantic derives from the fields

        def __init__(self, /, **values: Any) -> None:
            """Validates the values; what is wrong with them comes as a `ConfigError`."""
            try:
                super().__init__(**values)
            except ValidationError as error:
                title = f"not a valid {type(self).__name__}"
                raise config_error(title, error, values, type(self)) from None

        # So marked, only calls from outside pass through here: pydantic validates sections inside
        # sections directly, and their problems arrive above with their full key.
        __init__.__pydantic_base_init__ = True
