"""Translates a JAX function of scalars to C statements, from its trace.

The model computes with one array for each coordinate, so that the trace (jaxpr) of one of its
functions for one agent is scalar arithmetic: sums, products, comparisons, choices. Each operation
becomes a C expression. If its value is used several times, it becomes a local constant named after
the function of the model that it comes from; if it is used once, it is written in place. Operations
on numbers that are known at export (0, 1, an infinite limit) are computed here. Operations that no
result needs are omitted.

A `lax.scan` over stacked scalars, such as one over the landmarks, becomes a `for` loop, which is
written once for any number of them.
"""

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
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
class Operation:
    """An operation and its operands."""

    name: str
    of: tuple["Value", ...]
    origin: str = ""
    """The function of the model that it comes from."""
    loop: "Loop | None" = None
    """Of an operation "loop"."""
    place: int = 0
    """Of an operation "carried": which of the values that the loop carries."""


@dataclass(frozen=True, eq=False)
class Value:
    """A value: an operation, or a leaf with a text or a number. Equality is identity."""

    operation: Operation | None = None
    text: str = ""
    number: float | bool | None = None
    named: bool = False
    """Whether the code has the number's name, not its value."""
    truth: bool = False
    """Whether an input of a loop's body is a truth, no real number."""


@dataclass(frozen=True, eq=False)
class Loop:
    """A `lax.scan` that stores nothing. Its operation is of one operand for each input."""

    turns: int
    inputs: tuple[Value, ...]
    """What the body is made of: values that stay the same, carried ones, one's of each turn."""
    first: int
    """Index of the first carried input. Those before it stay the same."""
    results: tuple[Value, ...]
    """What the body hands on to the next turn, one for each carried input."""

    @property
    def last(self) -> int:
        """Index after the last carried input. Those from it on have a value for each turn."""
        return self.first + len(self.results)


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
_ALLOWED = (
    "arithmetic, comparisons, choices (jnp.where, not lax.cond) and functions of <math.h>, of "
    "scalars that are real numbers or truths (a counter is a real number), and lax.scan over "
    "stacked scalars that stores nothing"
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
        """What a function has closed over, as numbers.

        Raises:
            ArgumentError: An array, an integer, or no number at all.
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
        """The results of a jaxpr for these arguments and for what it has closed over."""
        at = dict(zip(jaxpr.constvars, constants, strict=True))
        at.update(zip(jaxpr.invars, values, strict=True))

        def read(var: Any) -> Value:
            return self.number(var.val) if isinstance(var, core.Literal) else at[var]

        for equation in jaxpr.eqns:
            given, name = [read(var) for var in equation.invars], equation.primitive.name
            inner = equation.params.get("jaxpr") or equation.params.get("call_jaxpr")
            if name == "scan":
                made = self._loop(equation, given)
            elif inner is not None and name not in ("while", "cond"):
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
        """What comes out of a scan over rows of scalars."""
        params = equation.params
        first, carried = params["num_consts"], params["num_carry"]
        if len(equation.outvars) > carried or params["reverse"]:
            refuse("a step with a scan that stores something, or runs backwards", _ALLOWED)
        closed = params["jaxpr"]
        inputs = []
        for i, (var, operand) in enumerate(zip(closed.jaxpr.invars, given, strict=True)):
            if getattr(var.aval, "shape", ()) or _is_row(operand) != (i >= first + carried):
                refuse("a step with a scan over arrays", _ALLOWED)
            _check_kind("scan", var)
            plain = i < first and operand.number is not None and not operand.named
            inputs.append(operand if plain else Value(truth=_is_truth(var)))
        # Of its own: nothing in it is computed before the loop.
        trace = _Trace(self._dtype)
        results = trace.run(closed.jaxpr, inputs, trace.constants(closed.consts))
        loop = Loop(params["length"], tuple(inputs), first, tuple(results))
        whole = Value(operation=Operation("loop", tuple(given), loop=loop))
        return [
            Value(operation=Operation("carried", (whole,), place=place)) for place in range(carried)
        ]

    def _applied(self, equation: core.JaxprEqn, given: list[Value]) -> Value:
        name, params = equation.primitive.name, equation.params
        if len(equation.outvars) != 1:
            refuse(f"a step with the operation {name!r}", _ALLOWED)
        if any(map(_is_row, given)):
            refuse(f"a step with the operation {name!r} on arrays", _ALLOWED)
        for var in equation.outvars:
            if getattr(var.aval, "shape", ()):
                refuse(f"a step with the operation {name!r} on arrays", _ALLOWED)
            _check_kind(name, var)
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
        elif name not in (*_INFIX, *FUNCTIONS, "select_n", "neg", "not"):
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
    """Likewise a real number."""
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


def margin(statement: str) -> int:
    """How far a statement is indented within others."""
    return len(statement) - len(statement.lstrip())


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
                statement.lstrip(),
                width=WIDTH,
                initial_indent=(indent + margin(statement)) * " ",
                subsequent_indent=(indent + 4 + margin(statement)) * " ",
                break_long_words=False,
                break_on_hyphens=False,
            )
            for statement in self.statements
        )

    def mentions(self, name: str) -> bool:
        """Whether a C name occurs in the statements."""
        return any(re.search(rf"\b{name}\b", statement) for statement in self.statements)


def written(
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    results: Any,
    dtype: Any = np.float64,
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
    values, shape = traced(function, arguments, dtype)
    return Writer(wanted_of(results, values, shape)).code()


def wanted_of(results: Any, values: list[Value], shape: Any) -> list[tuple[str, Value]]:
    """The variables to set, and to which values.

    Args:
        results: As for `written`.
        values: The results of the function.
        shape: The records that they stand in.
    """
    # None marks a result that is not wanted; it counts as a leaf here, so that the pairs match.
    wanted, _ = jax.tree.flatten(results, is_leaf=lambda leaf: leaf is None)
    assert len(wanted) == len(jax.tree.leaves(shape)), "a variable, or None, for each result"
    return [(name, v) for name, v in zip(wanted, values, strict=True) if name is not None]


def passed_on(function: Callable[..., Any], arguments: tuple[Any, ...]) -> list[str | None]:
    """Which variable each result of a function is, unchanged; None of what it computes.

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
    with jax.enable_x64(dtype == np.float64):
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


class Writer:
    """Writes values as statements; a value that is used several times gets a name."""

    def __init__(
        self,
        results: list[tuple[str, Value]],
        *,
        single: dict[int, float] | None = None,
        names: dict[int, str] | None = None,
        count: dict[str, int] | None = None,
    ) -> None:
        """Finds what the results need.

        Args:
            results: What is to be set, and to which values.
            single: Numbers in float32, by the identity of that in float64, where they differ.
            names: Of the inputs, where this is the body of a loop.
            count: How often a name was given already, in what this stands within.
        """
        self._results, self._single = results, single or {}
        self._uses: dict[int, int] = {}
        self._order: list[Value] = []
        self._leaves: list[Value] = []
        self._names = {} if names is None else names
        self._count = {} if count is None else count
        self._functions: set[str] = set()
        self._needed = needed_inputs([value for _, value in results])
        for _, value in results:
            self._visit(value)

    def _visit(self, value: Value) -> None:
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
                of = current.operation.of
                if current.operation.loop:
                    of = tuple(of[i] for i in sorted(self._needed[id(current)]))
                todo.append((current, True))
                todo += [(operand, False) for operand in reversed(of)]

    def code(self) -> Code:
        """The statements."""
        statements: list[str] = []
        results = {id(value) for _, value in self._results}
        texts = [self._text(leaf)[0] for leaf in self._leaves]
        # If a result is also an argument, all results are computed before any is set.
        before = any(text in dict(self._results) for text in texts)
        for value in self._order:
            assert value.operation is not None
            if value.operation.name == "loop":
                statements += self._loop(value, value.operation)
                continue
            if value.operation.name in ("row", "carried"):
                continue
            text, _ = self._text(value)
            result = id(value) in results
            if self._uses[id(value)] > 1 or (before if result else len(text) > _LONGEST):
                statements.append(self._constant(self._fresh(value), value))
        statements += self._kept()
        for name, value in self._results:
            text, _ = self._text(value)
            if text != name:
                statements.append(f"{name} = {text};")
        return Code(tuple(statements), frozenset(self._functions))

    def _kept(self) -> list[str]:
        """Copies of the arguments that a result is set to after they have got another value."""
        statements, set_already = [], set[str]()
        for name, value in self._results:
            text, _ = self._text(value)
            if text in set_already and text != name:
                statements.append(self._constant(self._numbered("kept"), value))
            set_already.add(name)
        return statements

    def _constant(self, name: str, value: Value) -> str:
        """The statement that gives a value a name."""
        kind = "int" if _is_predicate(value) else "posegsa_real"
        statement = f"const {kind} {name} = {self._text(value)[0]};"
        self._names[id(value)] = name
        return statement

    def _fresh(self, value: Value) -> str:
        assert value.operation is not None
        return self._numbered(value.operation.origin or value.operation.name)

    def _numbered(self, base: str) -> str:
        self._count[base] = self._count.get(base, 0) + 1
        return f"{base}_{self._count[base]}"

    def _loop(self, value: Value, operation: Operation) -> list[str]:
        """The statements of a loop, after which its variables hold what it has carried."""
        loop, of = operation.loop, operation.of
        assert loop is not None
        needed, index, statements = self._needed[id(value)], self._numbered("turn"), list[str]()
        for i in sorted(needed):
            inside, operand = loop.inputs[i], of[i]
            kind = "int" if inside.truth else "posegsa_real"
            if i >= loop.last:
                text = self._by_turn(operand, index)
                if not text:
                    text = self._numbered("each")
                    row = operand.operation.of if operand.operation else ()
                    each = ", ".join(self._text(one)[0] for one in row)
                    statements.append(f"const {kind} {text}[{loop.turns}] = {{{each}}};")
                    text = f"{text}[{index}]"
            elif i >= loop.first:
                continue
            else:
                made = operand.operation
                if made and made.name != "carried" and id(operand) not in self._names:
                    statements.append(self._constant(self._numbered("constant"), operand))
                text = self._text(operand)[0]
            self._names[id(inside)] = text
        places = [i for i in sorted(needed) if loop.first <= i < loop.last]
        statements += self._carry(loop, of, places)
        results = [(self._names[id(loop.inputs[i])], loop.results[i - loop.first]) for i in places]
        writer = type(self)(results, single=self._single, names=self._names, count=self._count)
        body = writer.code()
        self._functions |= body.functions
        statements.append(f"for (int {index} = 0; {index} < {loop.turns}; ++{index}) {{")
        statements += [f"    {statement}" for statement in body.statements]
        statements.append("}")
        return statements

    def _carry(self, loop: Loop, of: tuple[Value, ...], places: list[int]) -> list[str]:
        """Variables for what a loop carries, with their first values.

        Args:
            loop: The loop.
            of: Its operands.
            places: Which of its inputs are carried, and needed.
        """
        statements = []
        for i in places:
            text, taken = self._text(of[i])[0], of[i].operation
            # The variable of the loop before goes on where no one else needs it.
            if not (taken and taken.name == "carried" and self._uses[id(of[i])] == 1):
                kind = "int" if loop.inputs[i].truth else "posegsa_real"
                name = self._numbered("carried")
                statements.append(f"{kind} {name} = {text};")
                text = name
            self._names[id(loop.inputs[i])] = text
        return statements

    def _by_turn(self, row: Value, index: str) -> str:
        """A row's element of a turn, if its elements are those of an array of C; "" otherwise."""
        assert row.operation is not None
        texts = [self._text(one)[0] for one in row.operation.of]
        if any(one.operation for one in row.operation.of):
            return ""
        if len(set(texts)) == 1:
            return texts[0]
        for match in re.finditer(r"\[0\]", texts[0]):
            head, tail = texts[0][: match.start()], texts[0][match.end() :]
            if texts == [f"{head}[{i}]{tail}" for i in range(len(texts))]:
                return f"{head}[{index}]{tail}"
        return ""

    def _text(self, value: Value) -> tuple[str, int]:
        """An expression and the precedence of its last operation."""
        if id(value) in self._names:
            return self._names[id(value)], 9
        if value.operation is None and id(value) in self._single:
            one, two = literal(self._single[id(value)]), literal(value.number)
            return f"(sizeof(posegsa_real) < sizeof(double) ? {one} : {two})", 9
        if value.operation is None:
            return (value.text, 9) if value.text else (literal(value.number), 9)
        name, of = value.operation.name, value.operation.of
        if name == "carried":
            loop = of[0].operation.loop if of[0].operation else None
            assert loop is not None
            return self._names[id(loop.inputs[loop.first + value.operation.place])], 9
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

    def _bound(self, value: Value, strength: int) -> str:
        text, own = self._text(value)
        return text if own >= strength else f"({text})"


def needed_inputs(results: list[Value]) -> dict[int, set[int]]:
    """Which inputs of each loop the results depend on, by the identity of the loop's value.

    A loop may carry what no one wants after it, and what it carries may need some of its inputs.
    """
    needed: dict[int, set[int]] = {}
    todo, done = list(results), set[int]()
    within: dict[int, tuple[Value, int]] = {}
    while todo:
        value = todo.pop()
        if id(value) in done:
            continue
        done.add(id(value))
        if id(value) in within:  # an input of a loop's body
            whole, i = within[id(value)]
            operation = whole.operation
            assert operation is not None
            assert operation.loop is not None
            if i not in needed[id(whole)]:
                needed[id(whole)].add(i)
                todo.append(operation.of[i])
                if operation.loop.first <= i < operation.loop.last:
                    todo.append(operation.loop.results[i - operation.loop.first])
        elif value.operation is not None and value.operation.name == "carried":
            (whole,) = value.operation.of
            assert whole.operation is not None
            assert whole.operation.loop is not None
            loop = whole.operation.loop
            needed.setdefault(id(whole), set())
            within |= {
                id(one): (whole, i)
                for i, one in enumerate(loop.inputs)
                if one.text == "" and one.number is None
            }
            # What is carried there is an input too, also where no turn reads it.
            todo.append(loop.inputs[loop.first + value.operation.place])
        elif value.operation is not None:
            todo += value.operation.of
    return needed


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


def _is_predicate(value: Value) -> bool:
    operation = value.operation
    if operation is None:
        return value.truth or isinstance(value.number, bool)
    if operation.name == "carried":
        loop = operation.of[0].operation.loop if operation.of[0].operation else None
        return loop is not None and loop.inputs[loop.first + operation.place].truth
    if operation.name == "select_n":
        return _is_predicate(operation.of[1])
    return operation.name in _PREDICATES
