"""Reads TOML files as plain data; errors show the line."""

import os
import re
import tomllib
from pathlib import Path
from typing import Any

from posegsa.arguments import check_type
from posegsa.errors import ConfigError

MAX_BYTES = 2**20
"""Maximum size of a configuration file: 1 MiB."""

_SHOWN = 100  # characters of a line that a message shows
_POSITION = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


def read_toml(path: str | Path) -> dict[str, Any]:
    """The data of a TOML file.

    Raises:
        ArgumentError: It is not a path.
        ConfigError: The file cannot be read or is not TOML.
    """
    check_type("path", path, str, os.PathLike, allowed="the path of a TOML file")
    return _parse(_read(path), path)


def _read(path: str | Path) -> str:
    """The text of a file."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # a ValueError is a path that no file can have
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: cannot be read as a TOML file: {reason}") from None
    if len(content) > MAX_BYTES:
        raise ConfigError(f"{path}: too large; allowed: at most 1 MiB")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}, line {line}: not UTF-8 text, as TOML has to be") from None


def _parse(text: str, path: str | Path) -> dict[str, Any]:
    """The data of a TOML document; an error shows the line."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
    except (ValueError, RecursionError):  # a number of thousands of digits, a thousand brackets
        raise ConfigError(f"{path}: not valid TOML: a number too long or arrays too deep") from None
    lines = text.replace("\r\n", "\n").split("\n")
    line, column = len(lines), len(lines[-1]) + 1
    if found := _POSITION.search(message):
        message = message[: found.start()]
        if found[1]:
            line, column = int(found[1]), int(found[2])
    start = max(0, column - _SHOWN // 2)
    shown = lines[line - 1][start : start + _SHOWN]
    shown = "".join(c if c.isprintable() else " " for c in shown)
    raise ConfigError(
        f"{path}, line {line}, column {column}: not valid TOML: {message}\n\n"
        f"  {shown}\n  {' ' * (column - 1 - start)}^"
    )
