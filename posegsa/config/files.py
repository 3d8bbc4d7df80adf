"""Experiments as TOML files, as plain data, and with single values changed."""

import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from posegsa.arguments import check_type, several
from posegsa.config import shipped
from posegsa.config.changes import with_values
from posegsa.config.experiment import Experiment
from posegsa.config.tunable import with_numbers
from posegsa.errors import ConfigError
from posegsa.settings.violations import Violation, config_error, violations_error

MAX_BYTES = 2**20
"""Size up to which a configuration file is read: 1 MiB."""

_SHOWN = 100  # characters of a line that a message shows
_NAME = re.compile(r"[a-z_]+")
_BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_+/-]*")
_POSITION = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


def load(path: str | Path) -> Experiment:
    """Reads an experiment from a TOML file; what the file leaves out keeps its default.

    Args:
        path: The file, or the name of a configuration that comes with posegsa, such as "quick"
            (`posegsa configs` lists them).

    Raises:
        ConfigError: If the file cannot be read, is not TOML or is not a valid experiment.
    """
    allowed = "the path of a TOML file, or the name of a configuration"
    check_type("path", path, str, os.PathLike, allowed=allowed)
    if _NAME.fullmatch(str(path)) and not Path(path).exists():
        path = shipped.find(str(path))
    return _validated(read_toml(path), f"{path} is not a valid experiment")


def read_toml(path: str | Path) -> dict[str, Any]:
    """The data of a TOML file.

    Raises:
        ArgumentError: It is no path.
        ConfigError: The file cannot be read or is not TOML.
    """
    check_type("path", path, str, os.PathLike, allowed="the path of a TOML file")
    return _parse(_read(path), path)


def as_experiment(value: Experiment | str | Path | None) -> Experiment:
    """The experiment that a user means: one, that of a TOML file, or the recommended one for None.

    Raises:
        ArgumentError: It is something else.
        ConfigError: The file cannot be read, is not TOML or is not a valid experiment.
    """
    if value is None:
        return Experiment()
    if isinstance(value, str | os.PathLike):
        return load(value)
    allowed = (
        "an Experiment (posegsa.config.from_dict makes one of plain data) or a TOML file's path"
    )
    check_type("experiment", value, Experiment, allowed=allowed)
    return value


def from_dict(data: Mapping[str, Any]) -> Experiment:
    """Makes an experiment of plain data, sections by name, as `load` reads them from TOML.

    Raises:
        ConfigError: If the data are not a valid experiment.
    """
    return _validated(data, "not a valid experiment")


def to_toml(experiment: Experiment) -> str:
    """Writes an experiment as TOML, every value included; reading it gives an equal experiment."""
    check_type("experiment", experiment, Experiment)
    return tomli_w.dumps(experiment.model_dump(mode="json"))


def override(experiment: Experiment, settings: Iterable[str]) -> Experiment:
    """Changes single values of an experiment, as `--set` does on the command line.

    Args:
        experiment: Where the other values come from.
        settings: Texts like `filter.substeps=4`, `gain.signal=pose`, `scenario.vectors.0.noise=1`:
            a path of keys and array indices, and a value as TOML writes it; quotes around a word
            may be left out. All are applied before the result is checked. Where they name another
            optimiser, the settings of the one before go, and what is not named of the new one's has
            its default; it keeps agents and iterations or, if one of both descends by gradients,
            the number of evaluations. A number that they name is no longer tuned, unless they name
            parameters.also too.

    Raises:
        ConfigError: If a setting cannot be read, or the result is not a valid experiment.
    """
    check_type("experiment", experiment, Experiment)
    settings = several("settings", settings, str, "texts such as filter.substeps=4")
    parsed = [_parsed(text) for text in settings]
    violations = [one for one in parsed if isinstance(one, Violation)]
    values = [one for one in parsed if not isinstance(one, Violation)]
    data, refused = with_values(experiment.model_dump(mode="json"), experiment.search, values)
    if violations or refused:
        title = "settings that cannot be applied"
        raise violations_error(title, [*violations, *refused])
    return _validated(data, "not a valid experiment with these settings")


def with_tuned(experiment: Experiment, values: Mapping[str, float]) -> Experiment:
    """An experiment with the numbers in it that were tuned beside k1..k22, by key.

    Each stays within its bounds, which rounding to the run's precision may have passed.
    """
    bounds = {one.key: (one.lower, one.upper) for one in experiment.also}
    within = {
        key: min(max(value, bounds[key][0]), bounds[key][1]) if key in bounds else value
        for key, value in values.items()
    }
    data = with_numbers(experiment.model_dump(mode="json"), within)
    return _validated(data, "not a valid experiment with the tuned numbers")


def _validated(data: object, title: str) -> Experiment:
    try:
        return Experiment.model_validate(data)
    except ValidationError as error:
        raise config_error(title, error, Experiment) from None


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
    """The data in a TOML document; a mistake is shown in its line."""
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


def _parsed(text: str) -> tuple[str, Any] | Violation:
    """The path and the value that a setting names, or what is wrong with it."""
    path, _, written = (part.strip() for part in text.partition("="))
    keys = path.split(".")
    if not written or len(keys) < 2 or not all(keys):
        return Violation(text, "allowed: section.key=value, such as filter.substeps=4")
    try:
        return path, _value(written)
    except (ValueError, RecursionError):
        return Violation(path, "allowed: a value as TOML writes it", written)


def _value(written: str) -> Any:
    """The value of a TOML expression; a bare word is a string."""
    try:
        data = tomllib.loads(f"value = {written}")
    except ValueError:
        if _BARE_WORD.fullmatch(written):
            return written
        raise
    if list(data) != ["value"]:
        raise ValueError("more than one value")
    return data["value"]
