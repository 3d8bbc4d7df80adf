"""Translates a JAX function of scalars to C statements, from its trace.

The model computes with one array for each coordinate, so that the trace (jaxpr) of one of its
functions for one agent is scalar arithmetic: sums, products, comparisons, choices. Each operation
becomes a C expression. If its value is used several times, it becomes a local constant named after
the function of the model that it comes from; if it is used once, it is written in place. Operations
on numbers that are known at export (0, 1, an infinite limit) are computed here. Operations that no
result needs are omitted.
"""

import math
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.extend import core, source_info_util

from posegsa.arguments import refuse
from posegsa.errors import ArgumentError

WIDTH = 96
"""Width of a line of C."""
_LONGEST = 64
"""Largest length of an expression that is written in place."""


@dataclass(frozen=True)
class Known:
    """A number that has a name in C: a setting."""

    text: str
    value: float


Argument = str | float | Known
"""A leaf of an argument: the text of a C variable, a number, or a number with a name."""


@dataclass(frozen=True)
class _Operation:
    """An operation and its operands."""

    name: str
    of: tuple["_Value", ...]
    origin: str
    """The function of the model that it comes from."""


@dataclass(frozen=True, eq=False)
class _Value:
    """A value: an operation, or a leaf with a text or a number. Equality is identity."""

    operation: _Operation | None = None
    text: str = ""
    number: float | bool | None = None
    named: bool = False
    """Whether the code has the number's name, not its value."""


_INFIX = {
    **{"add": ("+", 5), "sub": ("-", 5), "mul": ("*", 6), "div": ("/", 6)},
    **{"lt": ("<", 4), "gt": (">", 4), "le": ("<=", 4), "ge": (">=", 4)},
    **{"eq": ("==", 3), "ne": ("!=", 3), "and": ("&&", 2), "or": ("||", 1)},
}
"""C operators and their precedence, by their names in JAX."""
_ARITHMETIC, _ARITHMETIC_BINDS = ("add", "sub", "mul", "div"), 5
_PREDICATES = ("lt", "gt", "le", "ge", "eq", "ne", "and", "or", "not", "is_finite")
FUNCTIONS = {
    **{
        name: name for name in ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "tanh")
    },
    **{"abs": "fabs", "floor": "floor", "round": "rint"},
}
"""Functions of `<math.h>` by their names in JAX; the C code calls them as `posegsa_NAME`."""
_AS_IT_IS = ("broadcast_in_dim", "convert_element_type", "copy", "reshape", "squeeze")


class _Trace:
    """The operations of one jaxpr as values; equal operations share one value."""

    def __init__(self, dtype: Any) -> None:
        self._dtype = dtype
        self._made: dict[tuple[Any, ...], _Value] = {}

    def argument(self, leaf: Argument) -> _Value:
        if isinstance(leaf, Known):
            return self._once(("known", leaf.text), text=leaf.text, number=leaf.value, named=True)
        if isinstance(leaf, str):
            return self._once(("variable", leaf), text=leaf)
        return self.number(leaf)

    def number(self, value: float | bool) -> _Value:
        if isinstance(value, bool | np.bool_):
            return self._once(("truth", bool(value)), number=bool(value))
        # The shortest decimal that rounds to this number in that type.
        exact = float(str(self._dtype(value)))
        return self._once(("number", exact), number=exact)

    def run(self, jaxpr: core.Jaxpr, values: list[_Value]) -> list[_Value]:
        """The results of a jaxpr for these arguments."""
        at = dict(zip(jaxpr.invars, values, strict=True))

        def read(var: Any) -> _Value:
            return self.number(var.val) if isinstance(var, core.Literal) else at[var]

        for equation in jaxpr.eqns:
            given = [read(var) for var in equation.invars]
            inner = equation.params.get("jaxpr") or equation.params.get("call_jaxpr")
            if inner is not None and equation.primitive.name not in ("scan", "while", "cond"):
                closed = isinstance(inner, core.ClosedJaxpr)
                constants = (
                    [self.number(np.asarray(c).item()) for c in inner.consts] if closed else []
                )
                made = self.run(inner.jaxpr if closed else inner, constants + given)
            else:
                made = [self._applied(equation, given)]
            at.update(zip(equation.outvars, made, strict=True))
        return [read(var) for var in jaxpr.outvars]

    def _applied(self, equation: core.JaxprEqn, given: list[_Value]) -> _Value:
        name, params = equation.primitive.name, equation.params
        for var in equation.outvars:
            if getattr(var.aval, "shape", ()):
                refuse(f"a step with the operation {name!r} on arrays", "operations on scalars")
            if not _is_real(var) and not _is_truth(var):
                refuse(f"a step with the operation {name!r} on integers", "real numbers and truths")
        if name == "convert_element_type":
            before, after = map(_is_truth, (equation.invars[0], equation.outvars[0]))
            if before and not after:
                return self.made("select_n", given[0], self.number(0.0), self.number(1.0))
            if after and not before:
                return self.made("ne", given[0], self.number(0.0))
        if name in _AS_IT_IS:
            return given[0]
        if name == "integer_pow":
            power = self._power(given[0], abs(params["y"]))
            return power if params["y"] >= 0 else self.made("div", self.number(1.0), power)
        if name == "square":
            return self._power(given[0], 2)
        return self.made(name, *given, origin=_function_of(equation))

    def _power(self, value: _Value, exponent: int) -> _Value:
        """A value to a whole power >= 0, by repeated squaring."""
        if exponent < 2:
            return value if exponent else self.number(1.0)
        half = self._power(value, exponent // 2)
        square = self.made("mul", half, half)
        return self.made("mul", square, value) if exponent % 2 else square

    def made(self, name: str, *of: _Value, origin: str = "") -> _Value:
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
        elif name not in (*_INFIX, *FUNCTIONS, "select_n", "neg", "not"):
            allowed = "arithmetic, comparisons, choices and functions of <math.h>"
            refuse(f"a step with the operation {name!r}", allowed)
        return self._once(
            (name, *map(id, of)), operation=_Operation(name=name, of=of, origin=origin)
        )

    def _simplified(self, name: str, *of: _Value) -> _Value | None:
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

    def _once(self, key: tuple[Any, ...], **fields: Any) -> _Value:
        return self._made.setdefault(key, _Value(**fields))


def _within(value: _Value, condition: _Value, holds: bool) -> _Value:
    """A value, given that a condition holds or not: choices by that condition are resolved."""
    chosen = value.operation
    while chosen is not None and chosen.name == "select_n" and chosen.of[0] is condition:
        value = chosen.of[2 if holds else 1]
        chosen = value.operation
    return value


def _is_truth(var: Any) -> bool:
    return var.aval.dtype == bool


def _is_real(var: Any) -> bool:
    return np.issubdtype(var.aval.dtype, np.floating)


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


@dataclass(frozen=True)
class Code:
    """C statements and the functions that they call."""

    statements: tuple[str, ...]
    functions: frozenset[str]
    """The functions of `<math.h>` that they call, by their names there."""

    def text(self, indent: int) -> str:
        """The statements as lines."""
        return "\n".join(
            textwrap.fill(
                statement,
                width=WIDTH,
                initial_indent=indent * " ",
                subsequent_indent=(indent + 4) * " ",
                break_long_words=False,
                break_on_hyphens=False,
            )
            for statement in self.statements
        )

    def mentions(self, name: str) -> bool:
        """Whether a C name occurs in the statements."""
        return any(re.search(rf"\b{name}\b", statement) for statement in self.statements)


def written(
    function: Callable[..., Any], arguments: tuple[Any, ...], results: Any, dtype: Any = np.float64
) -> Code:
    """C code that sets variables to the results of a function.

    All results are computed before the first variable is set, so a variable may also be an
    argument.

    Args:
        function: Pure function of scalars in any records (pytrees). It is traced, not run.
        arguments: Its arguments, with an `Argument` for each scalar.
        results: Records with the structure of its results. Each leaf is the text of the C variable
            for that scalar, or None if it is not wanted.
        dtype: Floating type of the scalars in the trace.

    Raises:
        ArgumentError: The function has an operation that can't be written in C.
    """
    leaves, structure = jax.tree.flatten(arguments)
    shapes = [jax.ShapeDtypeStruct((), dtype)] * len(leaves)
    with jax.enable_x64(dtype == np.float64):
        try:
            closed, shape = jax.make_jaxpr(
                lambda *flat: function(*jax.tree.unflatten(structure, flat)), return_shape=True
            )(*shapes)
        except (jax.errors.JAXTypeError, TypeError, ValueError) as error:
            raise ArgumentError(f"the filter's step can't be written in C: {error}") from error
    trace = _Trace(dtype)
    constants = []
    for constant in closed.consts:
        if np.ndim(constant):
            refuse("a step that looks up arrays", "arithmetic of scalars")
        constants.append(trace.number(np.asarray(constant).item()))
    values = trace.run(closed.jaxpr, constants + [trace.argument(leaf) for leaf in leaves])
    # None marks a result that is not wanted; it counts as a leaf here, so that the pairs match.
    wanted, _ = jax.tree.flatten(results, is_leaf=lambda leaf: leaf is None)
    assert len(wanted) == len(jax.tree.leaves(shape)), "a variable, or None, for each result"
    pairs = [(name, v) for name, v in zip(wanted, values, strict=True) if name is not None]
    return _Writer(pairs).code()


class _Writer:
    """Writes values as statements; a value that is used several times gets a name."""

    def __init__(self, results: list[tuple[str, _Value]]) -> None:
        self._results = results
        self._uses: dict[int, int] = {}
        self._order: list[_Value] = []
        self._leaves: list[_Value] = []
        self._names: dict[int, str] = {}
        self._count: dict[str, int] = {}
        self._functions: set[str] = set()
        for _, value in results:
            self._visit(value)

    def _visit(self, value: _Value) -> None:
        """Order operands before their results; without recursion, because chains are long."""
        todo = [(value, False)]
        while todo:
            current, done = todo.pop()
            if done:
                self._order.append(current)
                continue
            self._uses[id(current)] = self._uses.get(id(current), 0) + 1
            if self._uses[id(current)] > 1:
                continue
            if current.operation is None:
                self._leaves.append(current)
            else:
                todo.append((current, True))
                todo += [(operand, False) for operand in reversed(current.operation.of)]

    def code(self) -> Code:
        statements: list[str] = []
        results = {id(value) for _, value in self._results}
        # If a result is also an argument, all results are computed before any is set.
        before = any(value.text in dict(self._results) for value in self._leaves)
        for value in self._order:
            text, _ = self._text(value)
            result = id(value) in results
            if self._uses[id(value)] > 1 or (before if result else len(text) > _LONGEST):
                name = self._fresh(value)
                kind = "int" if _is_predicate(value) else "posegsa_real"
                statements.append(f"const {kind} {name} = {text};")
                self._names[id(value)] = name
        for name, value in self._results:
            text, _ = self._text(value)
            if text != name:
                statements.append(f"{name} = {text};")
        return Code(tuple(statements), frozenset(self._functions))

    def _fresh(self, value: _Value) -> str:
        assert value.operation is not None
        base = value.operation.origin or value.operation.name
        self._count[base] = self._count.get(base, 0) + 1
        return f"{base}_{self._count[base]}"

    def _text(self, value: _Value) -> tuple[str, int]:
        """An expression and the precedence of its last operation."""
        if id(value) in self._names:
            return self._names[id(value)], 9
        if value.operation is None:
            return (value.text, 9) if value.text else (literal(value.number), 9)
        name, of = value.operation.name, value.operation.of
        if name in _INFIX:
            sign, strength = _INFIX[name]
            # C's operators are left-associative: the right operand needs a higher precedence.
            # Compilers warn of nested comparisons and logic without parentheses.
            arithmetic = name in _ARITHMETIC
            least = strength if arithmetic else _ARITHMETIC_BINDS
            left, right = self._bound(of[0], least), self._bound(of[1], least + arithmetic)
            return f"{left} {sign} {right}", strength
        if name in ("neg", "not"):
            return f"{'-' if name == 'neg' else '!'}{self._bound(of[0], 8)}", 7
        if name == "select_n":
            condition, low, high = (self._bound(operand, 1) for operand in of)
            return f"{condition} ? {high} : {low}", 0
        call = FUNCTIONS.get(name, name)
        if name in FUNCTIONS:
            self._functions.add(call)
        return f"posegsa_{call}({', '.join(self._text(operand)[0] for operand in of)})", 9

    def _bound(self, value: _Value, strength: int) -> str:
        text, own = self._text(value)
        return text if own >= strength else f"({text})"


def literal(number: float | bool | None) -> str:
    """A number in C, of type `posegsa_real` unless it is a small integer."""
    if isinstance(number, bool):
        return str(int(number))
    assert number is not None
    if math.isinf(number) or math.isnan(number):
        name = "NAN" if math.isnan(number) else "INFINITY"
        return f"{'-' if number < 0 else ''}POSEGSA_C({name})"
    if number == int(number) and abs(number) < 1000:
        return str(int(number)) if number >= 0 else f"({int(number)})"
    return f"POSEGSA_C({number!r})"


def _is_predicate(value: _Value) -> bool:
    operation = value.operation
    if operation is None:
        return isinstance(value.number, bool)
    if operation.name == "select_n":
        return _is_predicate(operation.of[1])
    return operation.name in _PREDICATES
