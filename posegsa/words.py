"""Words for a person."""

import json
from collections.abc import Mapping


def counted(number: int, noun: str) -> str:
    """A count with its noun: "1 agent", "2 agents"."""
    return f"{number} {noun}" + "s" * (number != 1)


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
