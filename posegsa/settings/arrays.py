"""Annotations of record fields that state which numbers they may contain.

    training_costs: Annotated[np.ndarray, Numbers("training scenarios", allow="infinite")]
    position: Annotated[np.ndarray, Columns("x_m", "y_m", "z_m")]
    knots: Annotated[list[float], Numbers("knots")]

pydantic validates such fields strictly: text, true and null are not numbers. Infinity and NaN,
which JSON does not have, are written as the strings "inf", "-inf" and "nan".
"""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

_NOT_FINITE = ("inf", "-inf", "nan")


class Numbers:
    """An array or list of numbers, or a single number if no shape is given.

    Args:
        shape: The lengths of its axes. A named length is at least 1 and the same throughout a
            record; None allows any length.
        dtype: bool, int (64 bits) or float (64 bits).
        allow: Which floats are allowed: finite ones, also infinite ones, or any including NaN.
    """

    def __init__(
        self,
        *shape: int | str | None,
        dtype: type = float,
        allow: Literal["finite", "infinite", "any"] = "finite",
    ) -> None:
        self.shape, self.dtype, self.allow = shape, dtype, allow

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """How pydantic reads an annotated field: as lists first, then as an array."""
        del handler
        schema: CoreSchema = core_schema.bool_schema(strict=True)
        if self.dtype is int:
            schema = core_schema.int_schema(strict=True, ge=-(2**63), lt=2**63)
        elif self.dtype is float:
            schema = core_schema.no_info_before_validator_function(
                lambda value: float(value) if value in _NOT_FINITE else value,
                core_schema.float_schema(strict=True, allow_inf_nan=self.allow != "finite"),
            )
        for _ in self.shape:
            schema = core_schema.list_schema(schema, strict=True)

        def read(numbers: Any, info: core_schema.ValidationInfo) -> Any:
            array = self._array(numbers, info.context)
            return array if hasattr(source, "dtype") else numbers

        return core_schema.with_info_after_validator_function(read, schema)

    def _array(self, numbers: Any, lengths: Any) -> np.ndarray:
        """Nested lists of the right type as an array, if shape and values are allowed.

        `lengths` are the named lengths known so far in this record; new ones are added.
        """
        array = np.array(numbers, self.dtype)
        needed = [
            lengths.setdefault(length, max(1, found))
            if isinstance(length, str)
            else found
            if length is None
            else length
            for length, found in zip(self.shape, array.shape, strict=False)
        ]
        if list(array.shape) != needed:
            shape = ", ".join(map(str, self.shape))
            raise ValueError(f"shape {array.shape}; allowed: ({shape}), with {lengths}")
        if self.allow == "infinite" and np.isnan(array).any():
            raise ValueError("nan; allowed: numbers, or infinite")
        return array


class Columns(Numbers):
    """An array over time or iterations, stored as one or several columns of a table.

    Args:
        names: Names of the columns, with units.
        rows: The name of the number of rows.
        each: Whether there is a set of these columns for each of several items, for example
            vectors; "#" in a name is replaced by the number of the item.
        numbers: Keyword arguments of `Numbers`.
    """

    def __init__(self, *names: str, rows: str = "rows", each: bool = False, **numbers: Any) -> None:
        columns = [None] if each else [len(names)] if len(names) > 1 else []
        super().__init__(rows, *columns, **numbers)
        self.names, self.each = names, each

    def of(self, count: int) -> list[str]:
        """The names of all columns for `count` items."""
        if not self.each:
            return list(self.names)
        return [name.replace("#", str(i)) for i in range(count) for name in self.names]


Cost = Annotated[float, Numbers(allow="infinite")]
"""A cost: infinite where the filter diverged, never NaN."""
