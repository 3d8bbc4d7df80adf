"""Scalar code in less text: numbers that are computed the same way become arrays in loops.

A Kalman filter's covariance is traced as 171 scalars, and a measurement changes all of them in the
same way. `scalar_c` would write a statement for each. Here, aligned results are traced back:

1. Results that are elements of one array are a list. If all of a list's members are computed by the
   same operation, their first operands are a list again, and so on. A list whose members are used
   several times becomes an array in C; others are written in place.
2. An array is computed as a whole, before what needs any part of it. (One that depends on itself
   stays scalars.)
3. Neighbours whose statements differ only in an index that grows by 1 become one `for` loop.
4. An array that no one needs any more is overwritten by the next one, where the order allows.

Each number is computed by the same operations as before, so rounding is the same too.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from posegsa.export.scalar_c import Code, Writer, kind_of, margin, wanted_of
from posegsa.export.scalar_trace import Loop, Value, traced

MIN_MEMBERS = 8
"""Minimum number of members of a list that becomes an array."""
_SHORTEST = 3
"""Minimum number of turns of a loop."""
_INDEX = re.compile(r"\[(\d+)\]")
_CARRIED = re.compile(r"x_\d+")
"""Name of an array that a loop carries: short, because it occurs so often in the text."""
_LONGEST = 400
"""Maximum number of characters of an expression that is written in place."""


def written_in_loops(
    function: Callable[..., Any], arguments: tuple[Any, ...], results: Any
) -> Code:
    """A function as C like `scalar_c.written`, with arrays and loops where it can.

    Numbers that depend on the floating type, such as a unit of rounding, are written for both
    types; that of `posegsa_real` chooses.

    Args:
        function: as for `written`.
        arguments: as for `written`.
        results: as for `written`.

    Raises:
        ArgumentError: As `written` does.
    """
    doubles, shape = traced(function, arguments, np.float64)
    singles, _ = traced(function, arguments, np.float32)
    single = _numbers_of_float32(doubles, singles)
    return _packed(_LoopWriter(wanted_of(results, doubles, shape), single=single).code())


@dataclass(eq=False)
class _Array:
    """Values that are an array in C."""

    members: dict[int, Value]
    """By their index."""
    target: str = ""
    """The array of results whose elements they are, at the same indices."""

    @property
    def size(self) -> int:
        return max(self.members) + 1


_Home = tuple[Any, int]
"""What a value is stored in (an `_Array`, a loop's value, the name of an array), and its index."""


class _LoopWriter(Writer):
    """Values as statements, many of them in loops."""

    def code(self) -> Code:
        self._results_at = [(*_element(name), value) for name, value in self._results]
        self._arrays: dict[int, _Array] = {}
        """By the identity of each member."""
        self._stored: dict[int, str] = {}
        """The name in C, by the identity of what is stored."""
        self._find_arrays()
        order = self._ordered()
        while isinstance(order, _Array):  # it depends on itself
            for member in order.members.values():
                del self._arrays[id(member)]
            order = self._ordered()
        last = self._last_uses(order)
        statements: list[str] = []
        results = {id(value) for _, value in self._results}
        texts = {self._text(leaf)[0] for leaf in self._leaves}
        # If a result is also an argument, all results are computed before any is set.
        before = any(name in texts for name, _ in self._results)
        for at, unit in enumerate(order):
            if isinstance(unit, _Array):
                statements += self._array(unit, at, last)
                continue
            assert unit.operation is not None
            if unit.operation.name == "loop":
                statements += self._loop(unit, unit.operation)
            elif unit.operation.name not in ("row", "carried") and (
                self._uses[id(unit)] > 1
                or len(self._text(unit)[0]) > _LONGEST
                or (before and id(unit) in results)
            ):
                statements.append(self._constant(self._fresh(unit), unit))
        return Code(tuple(statements + self._set()), frozenset(self._functions))

    # --- which values are arrays ---

    def _find_arrays(self) -> None:
        """Traces the results' arrays back to lists of operands."""
        todo: list[tuple[dict[int, Value], str]] = []
        targets = {id(value) for head, _, value in self._results_at if head}
        groups: dict[str, dict[int, Value]] = {}
        for head, index, value in self._results_at:
            groups.setdefault(head, {})[index] = value
        for head, group in groups.items():
            if head and len(group) >= MIN_MEMBERS:
                todo.append((group, head))
        while todo:
            group, target = todo.pop(0)
            natural = self._in_order_of_leaves(group)
            if natural and natural != group:
                group, target = natural, ""
            members = {
                i: value
                for i, value in _once_each(group).items()
                if value.operation
                and value.operation.name not in ("row", "carried", "loop")
                and id(value) not in self._arrays
            }
            if len(members) < MIN_MEMBERS:
                continue
            if targets.intersection(map(id, members.values())) or any(
                self._uses[id(value)] > 1 for value in members.values()
            ):
                array = _Array(members, target)
                self._arrays |= {id(value): array for value in members.values()}
            alike: dict[tuple[str, int], dict[int, Value]] = {}
            for i, value in members.items():
                assert value.operation is not None
                alike.setdefault((value.operation.name, len(value.operation.of)), {})[i] = value
            # Operands at the same place of operations of one kind form a list; those of several
            # kinds too, because a covariance and a correction use the same gain.
            widest = max((count for _, count in alike), default=0)
            for place in range(widest):
                every = {
                    i: value.operation.of[place]
                    for i, value in members.items()
                    if value.operation and place < len(value.operation.of)
                }
                todo.append((every, ""))

    def _in_order_of_leaves(self, group: dict[int, Value]) -> dict[int, Value] | None:
        """A list at the indices of the array of arguments that it comes from, if it does.

        So a list keeps its order until the end, also where the results are in another one.
        """
        found: dict[int, Value] = {}
        heads = set[str]()
        for value in group.values():
            leaf = value
            while leaf.operation and leaf.operation.of and leaf.operation.name in ("add", "sub"):
                leaf = leaf.operation.of[0]
            head, index = _element(self._text(leaf)[0]) if not leaf.operation else ("", -1)
            if not head or index in found:
                return None
            found[index] = value
            heads.add(head)
        return dict(sorted(found.items())) if len(heads) == 1 else None

    def _ordered(self) -> "list[Value | _Array] | _Array":
        """Arrays and other values, each after its operands; or an array that needs itself."""
        order: list[Value | _Array] = []
        state: dict[int, int] = {}  # 1 started, 2 done
        for _, result in self._results:
            todo = [(self._unit(result), False)]
            while todo:
                unit, done = todo.pop()
                if done:
                    state[id(unit)] = 2
                    order.append(unit)
                    continue
                if state.get(id(unit)) == 1:
                    return self._one_of_circle(unit, todo)
                if id(unit) in state:
                    continue
                if isinstance(unit, Value) and unit.operation is None:
                    continue
                state[id(unit)] = 1
                todo.append((unit, True))
                todo += [
                    (operand, False)
                    for operand in map(self._unit, self._operands(unit))
                    if operand is not unit and state.get(id(operand)) != 2
                ]
                if isinstance(unit, _Array) and self._needs_itself(unit):
                    return unit
        return order

    def _one_of_circle(self, unit: "Value | _Array", todo: Any) -> _Array:
        """The last array that was started, on the cycle back to a unit that is started already."""
        if isinstance(unit, _Array):
            return unit
        return next(one for one, done in reversed(todo) if done and isinstance(one, _Array))

    def _needs_itself(self, array: _Array) -> bool:
        return any(self._arrays.get(id(value)) is array for value in self._operands(array))

    def _unit(self, value: Value) -> "Value | _Array":
        return self._arrays.get(id(value), value)

    def _operands(self, unit: "Value | _Array") -> list[Value]:
        if isinstance(unit, _Array):
            return [v for one in unit.members.values() if one.operation for v in one.operation.of]
        assert unit.operation is not None
        of = unit.operation.of
        if unit.operation.loop:
            return [of[i] for i in sorted(self._needed[id(unit)])]
        return list(of)

    # --- where they are stored ---

    def _home(self, value: Value) -> _Home | None:
        """What a value is an element of."""
        array = self._arrays.get(id(value))
        if array is not None:
            return array, next(i for i, one in array.members.items() if one is value)
        if value.operation is None:  # what the loop around this carries
            name = self._names.get(id(value), "")
            head, index = _element(name)
            return (head, index) if _CARRIED.fullmatch(head) else None
        if value.operation.name == "carried":
            return value.operation.of[0], value.operation.place
        return None

    def _homes(self, values: Iterable[Value]) -> list[_Home]:
        """The stored elements that values depend on, also through expressions written in place."""
        found, todo, done = [], list(values), set[int]()
        while todo:
            value = todo.pop()
            if id(value) in done:
                continue
            done.add(id(value))
            home = self._home(value)
            if home:
                found.append(home)
            elif value.operation and (self._uses[id(value)] == 1 or value.operation.name == "row"):
                todo += self._operands(value)
        return found

    def _last_uses(self, order: "list[Value | _Array]") -> dict[Any, int]:
        """Index of the last use of each stored value, by its identity or its array's name."""
        last: dict[Any, int] = {}
        for at, unit in enumerate(order):
            if isinstance(unit, _Array) or (unit.operation and self._is_named(unit)):
                last |= {_key(one): at for one, _ in self._homes(self._operands(unit))}
        return last | {
            _key(one): len(order) for one, _ in self._homes(value for _, value in self._results)
        }

    def _is_named(self, value: Value) -> bool:
        assert value.operation is not None
        return self._uses[id(value)] > 1 or value.operation.name == "loop"

    def _array(self, array: _Array, at: int, last: dict[Any, int]) -> list[str]:
        """The statements that compute an array."""
        statements: list[str] = []
        arguments = {_element(self._text(leaf)[0])[0] for leaf in self._leaves}
        name = ""
        if array.target and array.target not in arguments:
            name = array.target
        else:
            name = self._overwritten(array, at, last)
        if not name:
            first = next(iter(array.members.values()))
            name = self._fresh(first)
            statements.append(f"posegsa_real {name}[{array.size}];")
        self._stored[id(array)] = name
        statements += _looped(
            [self._changed(f"{name}[{i}]", value) for i, value in sorted(array.members.items())]
        )
        for i, value in array.members.items():
            self._names[id(value)] = f"{name}[{i}]"
        return statements

    def _changed(self, name: str, value: Value) -> str:
        """The assignment of a value, with `+=` or `-=` if the old value is one operand."""
        operation = value.operation
        assert operation is not None
        if operation.name in ("add", "sub") and self._text(operation.of[0])[0] == name:
            sign = "+" if operation.name == "add" else "-"
            return f"{name} {sign}= {self._text(operation.of[1])[0]}"
        return f"{name} = {self._text(value)[0]}"

    def _overwritten(self, array: _Array, at: int, last: dict[Any, int]) -> str:
        """The name of an array that this one can overwrite; "" if there is none."""
        found: dict[Any, tuple[str, bool]] = {}
        targets = {head for head, _, _ in self._results_at}
        for i, value in array.members.items():
            assert value.operation is not None
            for home, index in self._homes(value.operation.of):
                if isinstance(home, Value):
                    name = ""  # a loop's: it may be longer than what is needed
                    loop = home.operation.loop if home.operation else None
                    if loop is not None:
                        name, index = _element(self._names[id(loop.inputs[loop.first + index])])
                elif isinstance(home, str):  # not what a loop further out carries
                    name = home if home in targets else ""
                else:
                    name = self._stored[id(home)]
                fits = index >= i and found.get(_key(home), ("", True))[1]
                found[_key(home)] = name, fits
        for key, (name, fits) in found.items():
            if fits and name and last[key] == at and "->" not in name:
                size = self._sizes.get(name, 0)
                if size >= array.size:
                    return name
        return ""

    # --- statements ---

    @property
    def _sizes(self) -> dict[str, int]:
        """How many elements local arrays have at least, by what has a name in them."""
        sizes: dict[str, int] = {}
        for name in self._names.values():
            head, index = _element(name)
            sizes[head] = max(sizes.get(head, 0), index + 1)
        return sizes

    def _set(self) -> list[str]:
        """The statements that set the results, all of which have been computed."""
        statements: list[str] = []
        kinds = {name: kind_of(value) for name, value in self._results}
        pairs = [(name, self._text(value)[0]) for name, value in self._results]
        pairs = [(name, text) for name, text in pairs if name != text]
        for head in dict.fromkeys(_element(name)[0] for name, _ in pairs):
            # If an element is read after it is set, all are copied first.
            done, early = set[str](), False
            for name, text in pairs:
                early |= text in done
                done.add(name) if _element(name)[0] == head else None
            if early and head:
                read = [_element(text) for _, text in pairs]
                size = 1 + max(index for array, index in read if array == head)
                copy = self._numbered("kept")
                statements.append(f"posegsa_real {copy}[{size}];")
                statements += _assignments([(f"{copy}[{i}]", f"{head}[{i}]") for i in range(size)])
                pairs = [
                    (name, f"{copy}[{_element(text)[1]}]" if _element(text)[0] == head else text)
                    for name, text in pairs
                ]
        scalars, done = [], set[str]()
        for name, text in pairs:
            if text in done and not _element(text)[0]:
                kept = self._numbered("kept")
                statements.append(f"const {kinds[name]} {kept} = {text};")
                text = kept
            done.add(name)
            scalars.append((name, text))
        return statements + _assignments(scalars)

    def _carry(self, loop: Loop, of: tuple[Value, ...], places: list[int]) -> list[str]:
        """An array for the real numbers that a loop carries, with their first values."""
        real = [i for i in places if not loop.inputs[i].truth]
        statements = super()._carry(loop, of, [i for i in places if loop.inputs[i].truth])
        if not real:
            return statements
        texts = [self._text(of[i])[0] for i in real]
        head, _ = _element(texts[0])
        once = all(of[i].operation and self._uses[id(of[i])] == 1 for i in real)
        same = texts == [f"{head}[{i}]" for i in range(len(texts))]
        if not (once and same and _CARRIED.fullmatch(head) and self._sizes[head] == len(texts)):
            head = self._numbered("x")
            statements.append(f"posegsa_real {head}[{len(texts)}];")
            pairs = [(f"{head}[{k}]", text) for k, text in enumerate(texts)]
            statements += _assignments(pairs)
        for k, i in enumerate(real):
            self._names[id(loop.inputs[i])] = f"{head}[{k}]"
        return statements


def _key(stored: Any) -> Any:
    return stored if isinstance(stored, str) else id(stored)


def _element(text: str) -> tuple[str, int]:
    """The array and the index of an element in C; "" and -1 of what is none."""
    match = re.fullmatch(r"([\w>-]+)\[(\d+)\]", text)
    return (match[1], int(match[2])) if match else ("", -1)


def _once_each(group: dict[int, Value]) -> dict[int, Value]:
    """The same list without repetitions, renumbered if there were some."""
    found = {id(value): value for value in group.values()}
    return group if len(found) == len(group) else dict(enumerate(found.values()))


def _assignments(pairs: list[tuple[str, str]]) -> list[str]:
    """Statements that set variables to expressions, one after the other."""
    return _looped([f"{name} = {text}" for name, text in pairs])


def _looped(given: list[str]) -> list[str]:
    """Statements, without their semicolons, and loops of those that follow each other."""
    statements, i = [], 0
    parts = [_INDEX.split(statement) for statement in given]
    while i < len(parts):
        end, steps = i + 1, []
        while end < len(parts) and parts[end][::2] == parts[i][::2]:
            now = [
                int(b) - int(a) for a, b in zip(parts[end - 1][1::2], parts[end][1::2], strict=True)
            ]
            if not set(now) <= {0, 1} or not any(now) or (steps and now != steps):
                break
            steps, end = now, end + 1
        if end - i >= _SHORTEST:
            text = parts[i][0]
            for place, step in enumerate(steps):
                first, after = parts[i][2 * place + 1 : 2 * place + 3]
                index = first if not step else "k" if first == "0" else f"k + {first}"
                text += f"[{index}]{after}"
            statements.append(f"for (int k = 0; k < {end - i}; ++k) {{ {text}; }}")
            i = end
        else:
            statements.append(f"{given[i]};")
            i += 1
    return statements


_DEFINES = (
    "const posegsa_real ",
    "const int ",
    "posegsa_real ",
    "int ",
    "for ",
    "if ",
    "while ",
    "}",
)
"""Begins of statements that assign to nothing that is there already."""


def _packed(code: Code) -> Code:
    """The same code in fewer lines: neighbouring definitions, or assignments, share a line."""
    found: list[str] = []
    for statement in code.statements:
        before, body = found[-1] if found else "", statement.lstrip()
        kind = next((kind for kind in _DEFINES if body.startswith(kind)), "")
        if not before.endswith(";") or margin(before) != margin(statement):
            found.append(statement)
        elif kind and before.lstrip().startswith(kind):
            found[-1] = f"{before[:-1]}, {body.removeprefix(kind)}"
        elif not kind and not before.lstrip().startswith(_DEFINES):
            found[-1] = f"{before} {body}"
        else:
            found.append(statement)
    return Code(tuple(found), code.functions)


def _numbers_of_float32(doubles: list[Value], singles: list[Value]) -> dict[int, float]:
    """The numbers that differ in float32, by the identity of the value in float64.

    Both are walked side by side as long as their operations agree: where a series has fewer
    terms in float32, the series of float64 serves both.
    """
    found: dict[int, float] = {}
    todo, done = list(zip(doubles, singles, strict=True)), set[tuple[int, int]]()
    while todo:
        double, single = todo.pop()
        if (id(double), id(single)) in done:
            continue
        done.add((id(double), id(single)))
        a, b = double.operation, single.operation
        if a is None or b is None:
            x, y = double.number, single.number
            if not isinstance(x, float) or not isinstance(y, float) or double.named:
                continue
            if not (np.float32(x) == np.float32(y) or np.isnan([x, y]).all()):
                found[id(double)] = y
        elif (a.name, a.place, len(a.of)) == (b.name, b.place, len(b.of)):
            todo += zip(a.of, b.of, strict=True)
            if a.loop and b.loop:
                todo += zip(a.loop.results, b.loop.results, strict=True)
    return found
