"""The types that configuration fields are made of, and the base of every section.

Numbers are strict: `"1"` and `true` are not numbers, `1.0` is not an integer, nothing is infinite.
All are bounded, so that nothing absurd is computed with, or allocated.
Arrays become tuples, so that every section can be hashed, compared, and static under JAX's jit.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from posegsa.settings.violations import Refused, Violation, config_error

LARGEST, SMALLEST = 1e9, 1e-9
"""What numbers may be, so that float32 holds them, and products of some of them, with room."""
MAX_COUNT = 10**6
"""What counts may be; what all of them together need is for `memory` to say."""
MAX_SAMPLES = 10**7

Number = Annotated[float, Strict(), Field(ge=-LARGEST, le=LARGEST)]
NonNegative = Annotated[float, Strict(), Field(ge=0, le=LARGEST)]
Positive = Annotated[float, Strict(), Field(ge=SMALLEST, le=LARGEST)]
Epsilon = Annotated[float, Strict(), Field(ge=float(np.finfo(np.float32).tiny), le=LARGEST)]
"""What is added against division by zero: a smaller number would be 0 in float32."""
Share = Annotated[float, Strict(), Field(ge=0, le=1)]
Count = Annotated[int, Strict(), Field(ge=1, le=MAX_COUNT)]
Index = Annotated[int, Strict(), Field(ge=0, le=MAX_SAMPLES)]
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

    @classmethod
    def described_by(cls, values: object) -> type[BaseModel]:
        """The type that says what is allowed in these values: this one, unless a key decides."""
        return cls

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
                raise config_error(title, error, values, self.described_by(values)) from None

        # So marked, only calls from outside pass through here: pydantic validates sections inside
        # sections directly, and their problems arrive above with their full key.
        __init__.__pydantic_base_init__ = True
