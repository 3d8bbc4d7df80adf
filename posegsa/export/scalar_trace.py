"""A JAX function of scalars as a graph of operations, traced and simplified.

The model computes with one array for each coordinate, so that the trace (jaxpr) of one of its
functions for one agent is scalar arithmetic: sums, products, comparisons, choices. Operations on
numbers that are known at export (0, 1, an infinite limit) are computed here, and equal operations
share one value. `scalar_c` writes the values as C.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core, source_info_util

from posegsa.arguments import refuse
from posegsa.errors import ArgumentError
from posegsa.model.sensor_loops import kept_as_loops


@dataclass(frozen=True)
class Known:
    """A number that has a name in C: a setting."""

    text: str
    value: float


Argument = str | float | Known
"""A leaf of an argument: the text of a C variable, a number, or a number with a name."""


@dataclass(frozen=True)
class Operation:
    """An operation and its operands."""

    name: str
    of: tuple["Value", ...]
    origin: str = ""
    """The function of the model that it comes from."""
    loop: "Loop | None" = None
    """The loop of an operation "loop"."""
    place: int = 0
    """For an operation "carried": the index of the value among those that the loop carries."""


@dataclass(frozen=True, eq=False)
class Value:
    """A value: an operation, or a leaf with a text or a number. Equality is identity."""

    operation: Operation | None = None
    text: str = ""
    number: float | bool | None = None
    named: bool = False
    """Whether the code has the number's name, not its value."""
    truth: bool = False
    """Whether an input of a loop's body is a boolean instead of a real number."""


@dataclass(frozen=True, eq=False)
class Loop:
    """A `lax.scan`, a `lax.while_loop`, or a `lax.cond` as a loop of one turn or none.

    Its operation is of one operand for each input. What a scan stores, it carries: a number for
    each turn, which move on by one in each turn.
    """

    turns: int
    inputs: tuple[Value, ...]
    """Inputs of the body: constant values, carried values, and each row's element of this turn."""
    first: int
    """Index of the first carried input. The inputs before it are constant."""
    results: tuple[Value, ...]
    """What the body hands on to the next turn, one for each carried input."""
    condition: int | None = None
    """Index of the input that says whether there is a turn; if it is carried, whether there is
    another one. None if there are `turns` of them."""

    @property
    def again(self) -> bool:
        """Whether its condition is asked after each turn."""
        return self.condition is not None and self.condition >= self.first

    @property
    def last(self) -> int:
        """Index after the last carried input. Later inputs have a value for each turn."""
        return self.first + len(self.results)


INFIX = {
    **{"add": ("+", 5), "sub": ("-", 5), "mul": ("*", 6), "div": ("/", 6)},
    **{"lt": ("<", 4), "gt": (">", 4), "le": ("<=", 4), "ge": (">=", 4)},
    **{"eq": ("==", 3), "ne": ("!=", 3), "and": ("&&", 2), "or": ("||", 1)},
}
"""C operators and their precedence, by their names in JAX."""
ARITHMETIC, ARITHMETIC_BINDS = ("add", "sub", "mul", "div"), 5
PREDICATES = ("lt", "gt", "le", "ge", "eq", "ne", "and", "or", "not", "is_finite")
FUNCTIONS = {
    **{
        name: name for name in ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "tanh")
    },
    **{"abs": "fabs", "floor": "floor", "round": "rint", "atan2": "atan2", "pow": "pow"},
}
"""Functions of `<math.h>` by their names in JAX; the C code calls them as `posegsa_NAME`."""
_ALLOWED = (
    "arithmetic, comparisons, choices and functions of <math.h>, of scalars that are real numbers "
    "or truths (a counter is a real number), lax.cond, lax.while_loop, and lax.scan over stacked "
    "scalars"
)
"""What can be written."""
_AS_IT_IS = ("broadcast_in_dim", "convert_element_type", "copy", "reshape", "squeeze")


class _Trace:
    """The operations of one jaxpr as values; equal operations share one value."""

    def __init__(self, dtype: Any) -> None:
        self._dtype = dtype
        self._made: dict[tuple[Any, ...], Value] = {}

    def argument(self, leaf: Argument) -> Value:
        if isinstance(leaf, Known):
            return self._once(("known", leaf.text), text=leaf.text, number=leaf.value, named=True)
        if isinstance(leaf, str):
            return self._once(("variable", leaf), text=leaf)
        return self.number(leaf)

    def number(self, value: float | bool) -> Value:
        if isinstance(value, bool | np.bool_):
            return self._once(("truth", bool(value)), number=bool(value))
        # The shortest decimal that rounds to this number in that type.
        exact = float(str(self._dtype(value)))
        return self._once(("number", exact), number=exact)

    def constants(self, values: Iterable[Any]) -> list[Value]:
        """The constants that a function closes over, as numbers.

        Raises:
            ArgumentError: One is an array, an integer, or not a number.
        """
        found = []
        for value in values:
            if np.ndim(value):
                refuse(f"a step that looks up an array of shape {np.shape(value)}", _ALLOWED)
            if not _is_real(value) and not _is_truth(value):
                refuse(f"a step with a constant of type {jnp.result_type(value)}", _ALLOWED)
            found.append(self.number(np.asarray(value).item()))
        return found

    def run(
        self, jaxpr: core.Jaxpr, values: Sequence[Value], constants: Sequence[Value] = ()
    ) -> list[Value]:
        """The results of a jaxpr for these arguments and for the constants that it closes over."""
        at = dict(zip(jaxpr.constvars, constants, strict=True))
        at.update(zip(jaxpr.invars, values, strict=True))

        def read(var: Any) -> Value:
            return self.number(var.val) if isinstance(var, core.Literal) else at[var]

        for equation in jaxpr.eqns:
            given, name = [read(var) for var in equation.invars], equation.primitive.name
            inner = equation.params.get("jaxpr") or equation.params.get("call_jaxpr")
            if name == "scan":
                made = self._loop(equation, given)
            elif name == "cond":
                made = self._branch(equation, given)
            elif name == "while":
                made = self._while(equation, given)
            elif inner is not None:
                closed = isinstance(inner, core.ClosedJaxpr)
                made = self.run(
                    inner.jaxpr if closed else inner,
                    given,
                    self.constants(inner.consts) if closed else (),
                )
            else:
                made = [_row(equation, given) or self._applied(equation, given)]
            at.update(zip(equation.outvars, made, strict=True))
        return [read(var) for var in jaxpr.outvars]

    def _loop(self, equation: core.JaxprEqn, given: list[Value]) -> list[Value]:
        """The results of a scan over rows of scalars."""
        params = equation.params
        first, carried = params["num_consts"], params["num_carry"]
        if params["reverse"]:
            refuse("a step with a scan that runs backwards", _ALLOWED)
        closed, turns = params["jaxpr"], params["length"]
        inputs = []
        for i, (var, operand) in enumerate(zip(closed.jaxpr.invars, given, strict=True)):
            if getattr(var.aval, "shape", ()) or _is_row(operand) != (i >= first + carried):
                refuse("a step with a scan over arrays", _ALLOWED)
            _check_kind("scan", var)
            plain = i < first and operand.number is not None and not operand.named
            inputs.append(operand if plain else Value(truth=_is_truth(var)))
        # A trace of its own: nothing in it is computed before the loop.
        trace = _Trace(self._dtype)
        results = trace.run(closed.jaxpr, inputs, trace.constants(closed.consts))
        results, stored = results[:carried], results[carried:]
        last, before = first + carried, list(given)
        for var, value in zip(equation.outvars[carried:], stored, strict=True):
            _check_kind("scan", var)
            moving = [Value(truth=_is_truth(var)) for _ in range(turns)]
            inputs[last:last] = moving
            before[last:last] = [self.number(False if _is_truth(var) else 0.0)] * turns
            results += [*moving[1:], value]
            last += turns
        loop = Loop(turns, tuple(inputs), first, tuple(results))
        after = _carried(loop, tuple(before))
        rows = [
            Value(operation=Operation("row", tuple(after[k : k + turns])))
            for k in range(carried, len(after), turns)
        ]
        return after[:carried] + rows

    def _branch(self, equation: core.JaxprEqn, given: list[Value]) -> list[Value]:
        """What comes out of a `lax.cond`.

        What it returns where the condition does not hold is computed in any case, and replaced
        where it holds. So that function should be short.
        """
        condition, *operands = given
        branches = equation.params["branches"]
        if len(branches) != 2:
            refuse("a step with lax.switch", _ALLOWED)
        if condition.number is not None:
            chosen = branches[bool(condition.number)]
            return self.run(chosen.jaxpr, operands, self.constants(chosen.consts))
        if any(map(_is_row, operands)):
            refuse("a step with lax.cond of arrays", _ALLOWED)
        for var in equation.outvars:
            if getattr(var.aval, "shape", ()):
                refuse("a step with lax.cond of arrays", _ALLOWED)
            _check_kind("cond", var)
        otherwise, then = branches
        kept = self.run(otherwise.jaxpr, operands, self.constants(otherwise.consts))
        carried = [Value(truth=_is_truth(var)) for var in equation.outvars]
        # An operand that may stay as it is is changed on the spot.
        places = {id(value): inside for value, inside in zip(kept, carried, strict=True)}
        inputs = []
        for operand, var in zip(operands, then.jaxpr.invars, strict=True):
            plain = operand.number is not None and not operand.named
            inside = Value(truth=_is_truth(var))
            inputs.append(operand if plain else places.get(id(operand), inside))
        trace = _Trace(self._dtype)
        results = trace.run(then.jaxpr, inputs, trace.constants(then.consts))
        every = (Value(truth=True), *inputs, *carried)
        loop = Loop(1, every, len(inputs) + 1, tuple(results), condition=0)
        return _carried(loop, (condition, *operands, *kept))

    def _while(self, equation: core.JaxprEqn, given: list[Value]) -> list[Value]:
        """What a `lax.while_loop` carries in the end."""
        params, counts = equation.params, ("cond_nconsts", "body_nconsts")
        for var in equation.invars:
            if getattr(var.aval, "shape", ()):
                refuse("a step with lax.while_loop over arrays", _ALLOWED)
            _check_kind("while", var)
        ask, body = params["cond_jaxpr"], params["body_jaxpr"]
        first = sum(params[count] for count in counts)

        def asked(trace: _Trace, values: list[Value]) -> Value:
            given = [*values[: params["cond_nconsts"]], *values[first:]]
            return trace.run(ask.jaxpr, given, trace.constants(ask.consts))[0]

        inputs = []
        for i, (operand, var) in enumerate(zip(given, equation.invars, strict=True)):
            plain = i < first and operand.number is not None and not operand.named
            inputs.append(operand if plain else Value(truth=_is_truth(var)))
        trace = _Trace(self._dtype)
        arguments = inputs[params["cond_nconsts"] :]
        results = trace.run(body.jaxpr, arguments, trace.constants(body.consts))
        condition = asked(trace, [*inputs[:first], *results])
        every = (*inputs, Value(truth=True))
        loop = Loop(0, every, first, (*results, condition), condition=len(inputs))
        return _carried(loop, (*given, asked(self, given)))[:-1]

    def _applied(self, equation: core.JaxprEqn, given: list[Value]) -> Value:
        name, params = equation.primitive.name, equation.params
        if len(equation.outvars) != 1:
            refuse(f"a step with the operation {name!r}", _ALLOWED)
        if any(map(_is_row, given)):
            refuse(f"a step with the operation {name!r} on arrays", _ALLOWED)
        (result,) = equation.outvars
        if getattr(result.aval, "shape", ()):
            refuse(f"a step with the operation {name!r} on arrays", _ALLOWED)
        if name == "convert_element_type" and not _is_real(equation.invars[0]):
            if not _is_real(result):
                return given[0]  # a truth, also as the integer that chooses a branch of `lax.cond`
            return self.made("select_n", given[0], self.number(0.0), self.number(1.0))
        _check_kind(name, result)
        if name == "convert_element_type" and _is_truth(result):
            return self.made("ne", given[0], self.number(0.0))
        if name in _AS_IT_IS:
            return given[0]
        if name == "integer_pow":
            power = self._power(given[0], abs(params["y"]))
            return power if params["y"] >= 0 else self.made("div", self.number(1.0), power)
        if name == "square":
            return self._power(given[0], 2)
        return self.made(name, *given, origin=_function_of(equation))

    def _power(self, value: Value, exponent: int) -> Value:
        """A value to a whole power >= 0, by repeated squaring."""
        if exponent < 2:
            return value if exponent else self.number(1.0)
        half = self._power(value, exponent // 2)
        square = self.made("mul", half, half)
        return self.made("mul", square, value) if exponent % 2 else square

    def made(self, name: str, *of: Value, origin: str = "") -> Value:
        """The value of an operation, simplified where possible."""
        if name == "rsqrt":
            return self.made("div", self.number(1.0), self.made("sqrt", *of, origin=origin))
        if name == "select_n":
            of = (of[0], _within(of[1], of[0], False), _within(of[2], of[0], True))
        simple = self._simplified(name, *of)
        if simple is not None:
            return simple
        if name == "select_n":
            compared, low, high = of[0].operation, of[1], of[2]
            if compared is not None and compared.of == (high, low):
                name = {"lt": "min", "gt": "max"}.get(compared.name, name)
        if name in ("min", "max"):
            of = of[-2:] if len(of) == 2 else (of[2], of[1])
        elif name not in (*INFIX, *FUNCTIONS, "select_n", "neg", "not"):
            refuse(f"a step with the operation {name!r}", _ALLOWED)
        return self._once(
            (name, *map(id, of)), operation=Operation(name=name, of=of, origin=origin)
        )

    def _simplified(self, name: str, *of: Value) -> Value | None:
        """The value of an operation that needs no code, or None."""
        numbers = [value.number for value in of]
        if name == "is_finite" and numbers[0] is not None:
            return self.number(math.isfinite(numbers[0]))
        if name == "select_n" and numbers[0] is not None:
            return of[2] if numbers[0] else of[1]
        if name == "select_n" and of[1] is of[2]:
            return of[1]
        if name in ("and", "or") and (True in numbers or False in numbers):
            known, other = of if isinstance(numbers[0], bool) else reversed(of)
            return known if known.number is (name == "or") else other
        plain = [None if value.named else value.number for value in of]
        if name in ("lt", "gt", "le", "ge", "eq", "ne") and None not in plain:
            return self.number(bool(getattr(np, _NUMPY[name])(*plain)))
        if name in ("add", "sub", "mul", "div", "neg") and None not in plain:
            with np.errstate(all="ignore"):
                return self.number(float(getattr(np, _NUMPY[name])(*map(np.float64, plain))))
        if name == "sqrt" and plain[0] is not None and plain[0] >= 0:
            return self.number(math.sqrt(plain[0]))
        match name, plain:
            case ("mul", [0.0, _] | [_, 0.0]) | ("div", [0.0, _]):
                return self.number(0.0)
            case ("add", [0.0, _]) | ("mul", [1.0, _]):
                return of[1]
            case ("add" | "sub", [_, 0.0]) | ("mul" | "div", [_, 1.0]):
                return of[0]
            case "sub", [0.0, _]:
                return self.made("neg", of[1])
        return None

    def _once(self, key: tuple[Any, ...], **fields: Any) -> Value:
        return self._made.setdefault(key, Value(**fields))


def _carried(loop: Loop, of: tuple[Value, ...]) -> list[Value]:
    """What a loop carries in the end, from its operands."""
    whole = Value(operation=Operation("loop", of, loop=loop))
    return [
        Value(operation=Operation("carried", (whole,), place=place))
        for place in range(len(loop.results))
    ]


def _within(value: Value, condition: Value, holds: bool) -> Value:
    """A value, given that a condition holds or not: choices by that condition are resolved."""
    chosen = value.operation
    while chosen is not None and chosen.name == "select_n" and chosen.of[0] is condition:
        value = chosen.of[2 if holds else 1]
        chosen = value.operation
    return value


def _row(equation: core.JaxprEqn, given: list[Value]) -> Value | None:
    """Scalars in a row, as `jnp.stack` puts them for a scan; None for any other operation."""
    name, aval = equation.primitive.name, equation.outvars[0].aval
    shape = getattr(aval, "shape", ())
    if name in ("slice", "squeeze", "reshape") and given and _is_row(given[0]):
        (row,) = [value.operation for value in given if value.operation]
        if name == "slice":
            (start,), (limit,) = equation.params["start_indices"], equation.params["limit_indices"]
            steps = equation.params["strides"] or (1,)
            return Value(operation=Operation("row", row.of[start : limit : steps[0]]))
        return row.of[0] if shape == () and len(row.of) == 1 else None
    if len(shape) != 1:
        return None
    if name == "stack" and not any(map(_is_row, given)):
        return Value(operation=Operation("row", tuple(given)))
    if name == "concatenate" and all(map(_is_row, given)):  # as older versions of JAX stack
        parts = [value.operation.of for value in given if value.operation]
        return Value(operation=Operation("row", tuple(v for part in parts for v in part)))
    one = name in ("broadcast_in_dim", "reshape") and shape == (1,) and not _is_row(given[0])
    return Value(operation=Operation("row", (given[0],))) if one else None


def _is_row(value: Value) -> bool:
    return value.operation is not None and value.operation.name == "row"


def _type_of(var: Any) -> Any:
    return getattr(var, "aval", var)


def _is_truth(var: Any) -> bool:
    """Whether a variable of a jaxpr, or a number, is true or false."""
    return jnp.issubdtype(jnp.result_type(_type_of(var)), jnp.bool_)


def _is_real(var: Any) -> bool:
    """Whether a variable of a jaxpr, or a number, is a real number."""
    return jnp.issubdtype(jnp.result_type(_type_of(var)), jnp.floating)


def _check_kind(name: str, var: Any) -> None:
    """Refuse integers and the like, in or out of the operation of that name."""
    if not _is_real(var) and not _is_truth(var):
        refuse(f"a step with the operation {name!r} on integers", _ALLOWED)


def _function_of(equation: core.JaxprEqn) -> str:
    """Name of the innermost function that an operation comes from; "" if JAX does not know it."""
    summary = source_info_util.summarize(equation.source_info)  # "file:line:column (a.<locals>.b)"
    names = summary.rpartition("(")[2].rstrip(")").split(".")
    return next((name.strip("_") for name in reversed(names) if name.isidentifier()), "")


_NUMPY = {
    **{"lt": "less", "gt": "greater", "le": "less_equal", "ge": "greater_equal"},
    **{"eq": "equal", "ne": "not_equal", "neg": "negative"},
    **{"add": "add", "sub": "subtract", "mul": "multiply", "div": "divide"},
}


def passed_on(function: Callable[..., Any], arguments: tuple[Any, ...]) -> list[str | None]:
    """The variable that each result of a function is, unchanged; None for results that it computes.

    Args:
        function: as for `written`.
        arguments: as for `written`.

    Raises:
        ArgumentError: As `written` does.
    """
    values, _ = traced(function, arguments, np.float64)
    return [value.text or None for value in values]


def traced(
    function: Callable[..., Any], arguments: tuple[Any, ...], dtype: Any
) -> tuple[list[Value], Any]:
    """The results of a function as values, and the records that it returns them in."""
    leaves, structure = jax.tree.flatten(arguments)
    shapes = [jax.ShapeDtypeStruct((), dtype)] * len(leaves)
    with jax.enable_x64(dtype == np.float64), kept_as_loops():
        try:
            closed, shape = jax.make_jaxpr(
                lambda *flat: function(*jax.tree.unflatten(structure, flat)), return_shape=True
            )(*shapes)
        except (jax.errors.JAXTypeError, TypeError, ValueError) as error:
            raise ArgumentError(f"the filter's step can't be written in C: {error}") from error
        trace = _Trace(dtype)
        given = [trace.argument(leaf) for leaf in leaves]
        values = trace.run(closed.jaxpr, given, trace.constants(closed.consts))
    return values, shape
