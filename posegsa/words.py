"""Formatting of text output: counts with nouns, similar names, tables, values as TOML."""

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest


def counted(number: int, noun: str, plural: str = "") -> str:
    """A count with its noun: "1 agent", "2 agents"."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def meant(given: str, allowed: Iterable[str]) -> str:
    """The end of a message about an unknown name: "; did you mean NAME?", or "".

    The dashes before an option make no two of them similar.
    """
    names = {name.lstrip("-"): name for name in allowed}
    near = difflib.get_close_matches(given.lstrip("-"), names, 1)
    return f"; did you mean {names[near[0]]}?" if near else ""


def text_table(rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells as text: the first column left-aligned, the others right-aligned.

    A cell may have several lines.
    """
    lines = [line for row in rows for line in zip_longest(*map(str.splitlines, row), fillvalue="")]
    first, *others = (max(map(len, column)) for column in zip(*lines, strict=True))
    padded = ([head.ljust(first), *map(str.rjust, cells, others)] for head, *cells in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def toml(value: object) -> str:
    """A value as TOML writes it, on one line."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False)
        case list() | tuple():
            return f"[{', '.join(map(toml, value))}]"
        case Mapping():
            return f"{{{', '.join(f'{key} = {toml(each)}' for key, each in value.items())}}}"
        case _:
            return str(value)
