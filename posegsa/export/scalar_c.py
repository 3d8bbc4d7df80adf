"""A JAX function of scalars as C statements, from its trace (`scalar_trace`).

Each operation becomes a C expression. If its value is used several times, it becomes a local
constant named after the function of the model that it comes from; if it is used once, it is written
in place. Operations that no result needs are omitted. A `lax.scan` over stacked scalars, such as
one over the landmarks, becomes a `for` loop, which is written once for any number of them, a
`lax.while_loop` a `while` loop, and a `lax.cond` an `if`.
"""

import math
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from posegsa.export.scalar_trace import (
    ARITHMETIC,
    ARITHMETIC_BINDS,
    FUNCTIONS,
    INFIX,
    PREDICATES,
    Loop,
    Operation,
    Value,
    traced,
)

WIDTH = 96
"""Width of a line of C."""
_LONGEST = 64
"""Largest length of an expression that is written in place."""


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
    """The variables to set, each with its value.

    Args:
        results: As for `written`.
        values: The results of the function.
        shape: The records that hold them.
    """
    # None marks a result that is not wanted; it counts as a leaf here, so that the pairs match.
    wanted, _ = jax.tree.flatten(results, is_leaf=lambda leaf: leaf is None)
    assert len(wanted) == len(jax.tree.leaves(shape)), "a variable, or None, for each result"
    return [(name, v) for name, v in zip(wanted, values, strict=True) if name is not None]


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
            results: The variables to set, each with its value.
            single: Numbers that differ in float32, by the identity of their value in float64.
            names: Names of the inputs, if this is the body of a loop.
            count: How often each name has been used already in the enclosing code.
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
        """Copies of arguments that a result is set to after they have been overwritten."""
        statements, set_already = [], set[str]()
        for name, value in self._results:
            text, _ = self._text(value)
            if text in set_already and text != name:
                statements.append(self._constant(self._numbered("kept"), value))
            set_already.add(name)
        return statements

    def _constant(self, name: str, value: Value) -> str:
        """The statement that gives a value a name."""
        statement = f"const {kind_of(value)} {name} = {self._text(value)[0]};"
        self._names[id(value)] = name
        return statement

    def _fresh(self, value: Value) -> str:
        assert value.operation is not None
        return self._numbered(value.operation.origin or value.operation.name)

    def _numbered(self, base: str) -> str:
        self._count[base] = self._count.get(base, 0) + 1
        return f"{base}_{self._count[base]}"

    def _loop(self, value: Value, operation: Operation) -> list[str]:
        """The statements of a loop, after which its variables hold the last carried values."""
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
        outside = dict(self._names)
        writer = type(self)(results, single=self._single, names=self._names, count=self._count)
        body = writer.code()
        self._names |= outside  # a copy that the body has kept of an input ends with it
        self._functions |= body.functions
        if loop.condition is not None:
            word = "while" if loop.again else "if"
            statements.append(f"{word} ({self._names[id(loop.inputs[loop.condition])]}) {{")
        else:
            statements.append(f"for (int {index} = 0; {index} < {loop.turns}; ++{index}) {{")
        statements += [f"    {statement}" for statement in body.statements]
        statements.append("}")
        return statements

    def _carry(self, loop: Loop, of: tuple[Value, ...], places: list[int]) -> list[str]:
        """Variables for the values that a loop carries, set to their initial values.

        Args:
            loop: The loop.
            of: Its operands.
            places: Indices of the inputs that are both carried and needed.
        """
        statements = []
        for i in places:
            text, taken = self._text(of[i])[0], of[i].operation
            # The variable of the loop before is used again if nothing else needs it.
            if not (taken and taken.name == "carried" and self._uses[id(of[i])] == 1):
                kind = "int" if loop.inputs[i].truth else "posegsa_real"
                name = self._numbered("carried")
                statements.append(f"{kind} {name} = {text};")
                text = name
            self._names[id(loop.inputs[i])] = text
        return statements

    def _by_turn(self, row: Value, index: str) -> str:
        """A row's element at a loop index, if the row is an array in C; "" otherwise."""
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
        if name in INFIX:
            sign, strength = INFIX[name]
            # C's operators are left-associative: the right operand needs a higher precedence.
            # Compilers warn of nested comparisons and logic without parentheses.
            arithmetic = name in ARITHMETIC
            least = strength if arithmetic else ARITHMETIC_BINDS
            left, right = self._bound(of[0], least), self._bound(of[1], least + arithmetic)
            if name == "div" and all(map(_is_integer_in_c, of)):
                left = f"POSEGSA_C({self._text(of[0])[0]})"  # C would divide integers
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

    A loop may carry values that are not used after it, and a carried value may need few inputs.
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
            if id(whole) not in needed:
                needed[id(whole)] = set() if loop.condition is None else {loop.condition}
                if loop.condition is not None:
                    todo.append(whole.operation.of[loop.condition])
                if loop.again:
                    todo.append(loop.results[-1])
            within |= {
                id(one): (whole, i)
                for i, one in enumerate(loop.inputs)
                if one.text == "" and one.number is None
            }
            # The initial value of a carried one is an input too, even if no turn reads it.
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


def kind_of(value: Value) -> str:
    """The type of a value in C."""
    return "int" if _is_predicate(value) else "posegsa_real"


def _is_integer_in_c(value: Value) -> bool:
    """Whether the text of a value, written in place, has the type int."""
    operation, number = value.operation, value.number
    if operation is None:
        return number is not None and literal(number).strip("(-)").isdigit()
    if operation.name == "select_n":
        return all(map(_is_integer_in_c, operation.of[1:]))
    whole = operation.name in ("add", "sub", "mul", "neg")
    return whole and all(map(_is_integer_in_c, operation.of))


def _is_predicate(value: Value) -> bool:
    operation = value.operation
    if operation is None:
        return value.truth or isinstance(value.number, bool)
    if operation.name == "carried":
        loop = operation.of[0].operation.loop if operation.of[0].operation else None
        return loop is not None and loop.inputs[loop.first + operation.place].truth
    if operation.name == "select_n":
        return _is_predicate(operation.of[1])
    return operation.name in PREDICATES
