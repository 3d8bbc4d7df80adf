"""Experiments from and to TOML files and plain data, and changes of single values."""

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
from posegsa.config.experiment import Experiment
from posegsa.config.reading import read_toml
from posegsa.config.tunable import with_numbers
from posegsa.settings.violations import Violation, config_error, violations_error

_BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_+/-]*")


def load(path: str | Path) -> Experiment:
    """Read an experiment from a TOML file; keys that the file leaves out keep their defaults.

    Args:
        path: The file, or the name of a configuration that comes with posegsa, such as "quick"
            (`posegsa configs` lists them).

    Raises:
        ConfigError: If the file cannot be read, is not TOML or is not a valid experiment.
    """
    allowed = "the path of a TOML file, or the name of a configuration"
    check_type("path", path, str, os.PathLike, allowed=allowed)
    path = shipped.path_of(path)
    return _validated(read_toml(path), f"{path} is not a valid experiment")


load_config = load  # its name in the package `posegsa`


def as_experiment(value: Experiment | str | Path | None) -> Experiment:
    """The experiment for an argument: itself, from a TOML file, or for None recommended.toml.

    Raises:
        ArgumentError: It is of another type.
        ConfigError: The file cannot be read, is not TOML or is not a valid experiment.
    """
    if value is None:
        value = "recommended"
    if isinstance(value, str | os.PathLike):
        return load(value)
    allowed = (
        "an Experiment (posegsa.config.from_dict makes one of plain data) or a TOML file's path"
    )
    check_type("experiment", value, Experiment, allowed=allowed)
    return value


def from_dict(data: Mapping[str, Any]) -> Experiment:
    """Make an experiment from plain data with sections by name, as in a TOML file.

    Raises:
        ConfigError: If the data are not a valid experiment.
    """
    return _validated(data, "not a valid experiment")


def to_toml(experiment: Experiment) -> str:
    """Write an experiment as TOML with all values; reading it gives an equal experiment."""
    check_type("experiment", experiment, Experiment)
    return tomli_w.dumps(experiment.model_dump(mode="json"))


def override(experiment: Experiment, settings: Iterable[str]) -> Experiment:
    """Change single values of an experiment, like `--set` on the command line.

    Args:
        experiment: The source of all other values.
        settings: Texts like `filter.substeps=4`, `gain.signal=pose`, `scenario.vectors.0.noise=1`:
            a path of keys and array indices, and a value in TOML; quotes around a word may be left
            out. The result is checked after all are applied. If they name another optimiser, it
            gets default settings except for those given; agents and iterations are kept or, if one
            of the two optimisers uses gradients, the number of evaluations. A number that is set
            is no longer tuned, unless parameters.also is set too.

    Raises:
        ConfigError: If a setting cannot be read, or the result is not a valid experiment.
    """
    check_type("experiment", experiment, Experiment)
    settings = several("settings", settings, str, "texts such as filter.substeps=4")
    parsed = [_parsed(text) for text in settings]
    unread = [one for one in parsed if isinstance(one, Violation)]
    changes = [one for one in parsed if not isinstance(one, Violation)]
    titles = "settings that cannot be applied", "not a valid experiment with these settings"
    return experiment.with_changes(changes, titles, unread)


def values_of(text: str) -> tuple[str, list[Any]]:
    """Read a key and several values, as for `--vary` on the command line.

    Args:
        text: A path of keys and array indices, and values in TOML, separated by commas:
            `filter.gamma=1,5,10` or `search.optimiser=gsa,de`.

    Raises:
        ConfigError: The text cannot be read.
    """
    path, _, written = (part.strip() for part in text.partition("="))
    parsed = [_parsed(f"{path}={part}") for part in _parts(written)]
    if violations := [one for one in parsed if isinstance(one, Violation)]:
        raise violations_error("values that cannot be read", violations)
    return path, [one[1] for one in parsed if not isinstance(one, Violation)]


def _parts(written: str) -> list[str]:
    """A text split at its commas, except those inside brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for character in written:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        else:
            depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0 and not quote:
            parts.append("")
        else:
            parts[-1] += character
    return parts


def with_tuned(experiment: Experiment, values: Mapping[str, float]) -> Experiment:
    """An experiment with the tuned numbers other than k1..k22, by key.

    Each is clipped to its bounds, which it may exceed by rounding to the run's precision.
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


def _parsed(text: str) -> tuple[str, Any] | Violation:
    """The path and the value of a setting, or what is wrong with it."""
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
