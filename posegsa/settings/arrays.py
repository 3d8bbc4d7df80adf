"""What the numbers in a stored record may be, stated beside each of its fields.

    training_costs: Annotated[np.ndarray, Numbers("training scenarios", allow="infinite")]
    position: Annotated[np.ndarray, Columns("x_m", "y_m", "z_m")]
    knots: Annotated[list[float], Numbers("knots")]

pydantic reads such fields by these statements, strictly: text, true and null are no numbers. Those
that are not finite, which JSON cannot write, are the texts that `float` reads: inf, -inf and nan.
"""

from collections.abc import MutableMapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

Allow = Literal["finite", "infinite", "any"]
"""Finite numbers; infinite ones too; NaN too."""

_NOT_FINITE = {"inf", "-inf", "nan"}
_WORDS = {
    "finite": "finite numbers",
    "infinite": "numbers, infinite ones too",
    "any": "numbers, also infinite or nan",
    bool: "true or false",
    int: "whole numbers",
}


class Numbers:
    """An array or list of numbers, or a single one where no length is given.

    Args:
        shape: Its lengths. A length with a name is at least 1, and the same throughout a record.
        dtype: bool, int (64 bits) or float (64 bits).
        allow: Which floats.
    """

    def __init__(self, *shape: int | str, dtype: type = float, allow: Allow = "finite") -> None:
        self.shape, self.dtype, self.allow = shape, dtype, allow

    def __str__(self) -> str:
        numbers = _WORDS[self.allow if self.dtype is float else self.dtype]
        return f"{numbers} of shape ({', '.join(map(str, self.shape))})" if self.shape else numbers

    def read(self, value: object, lengths: MutableMapping[str, int]) -> np.ndarray:
        """An array of nested lists as JSON has them, or (with shape ()) of a single number.

        Args:
            value: The lists, or the number.
            lengths: The named lengths that this record has shown so far; new ones are added.

        Raises:
            ValueError: It is something else; says what is allowed.
        """
        try:
            array = np.array(self._strict(value, len(self.shape)), self.dtype)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"allowed: {self}") from None
        self.check(array, lengths)
        return array

    def _strict(self, value: Any, depth: int) -> Any:
        """The value, with numbers in the place of their texts.

        Raises:
            TypeError: Something in it is neither.
        """
        if depth > 0 and isinstance(value, list):
            return [self._strict(part, depth - 1) for part in value]
        if depth == 0 and self.dtype is float and value in _NOT_FINITE:
            return float(value)
        if depth == 0 and type(value) in ({int, float} if self.dtype is float else {self.dtype}):
            return value
        raise TypeError

    def check(self, array: np.ndarray, lengths: MutableMapping[str, int]) -> None:
        """Raise a ValueError unless an array of this dtype has this shape and only such numbers.

        Args:
            array: The array.
            lengths: As `read`'s.
        """
        needed = [
            lengths.setdefault(length, max(1, found)) if isinstance(length, str) else length
            for length, found in zip(self.shape, array.shape, strict=False)
        ]
        if list(array.shape) != needed:
            named = ", ".join(f"{name} = {length}" for name, length in lengths.items())
            raise ValueError(f"of shape {array.shape}; allowed: {self}; {named}")
        if self.dtype is float and self.allow != "any":
            refused = np.isnan(array) if self.allow == "infinite" else ~np.isfinite(array)
            for place in np.argwhere(refused)[:1].tolist():
                raise ValueError(f"{array[tuple(place)]} at {place}; allowed: {self}")

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """How pydantic reads a field that is annotated with this."""
        del handler
        is_array = source is np.ndarray

        def read(value: object, info: core_schema.ValidationInfo) -> Any:
            lengths: Any = info.context
            array = self.read(value, lengths)
            return array if is_array else array.tolist()

        return core_schema.with_info_plain_validator_function(read)


class Columns(Numbers):
    """An array over time or iterations, in a table one column or several side by side.

    Args:
        names: Their names, with units; by default a single one, that of the field.
        dtype: As of `Numbers`.
        allow: Likewise.
    """

    def __init__(self, *names: str, dtype: type = float, allow: Allow = "finite") -> None:
        beside = (len(names),) if len(names) > 1 else ()
        super().__init__("rows", *beside, dtype=dtype, allow=allow)
        self.names = names


Cost = Annotated[float, Numbers(allow="infinite")]
"""A cost: infinite where the filter diverged, never NaN."""
