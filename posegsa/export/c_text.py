"""Text that all C files share: templates, comments, names, and the accuracy of a result."""

import re
import textwrap
from collections.abc import Collection, Iterable
from functools import cache, partial
from typing import TYPE_CHECKING

from posegsa.arguments import refuse
from posegsa.export.tables import costs
from posegsa.judging.on_scenarios import OnScenarios
from posegsa.judging.result import Result
from posegsa.settings.fields import Section
from posegsa.version import VERSION
from posegsa.words import counted, text_table, toml

if TYPE_CHECKING:
    from jinja2 import Environment

wrapped = partial(textwrap.wrap, width=96, break_long_words=False, break_on_hyphens=False)
"""Wraps text into the lines of a comment."""

NAME = "posegsa"
"""Prefix of the names in the templates, and in a file by default."""
KEYWORDS = frozenset(
    {
        *("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else"),
        *("enum", "extern", "float", "for", "goto", "if", "inline", "int", "long", "register"),
        *("restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch"),
        *("typedef", "union", "unsigned", "void", "volatile", "while"),
        *("class", "new", "delete", "this", "public", "private", "template", "namespace", "using"),
        *("bool", "true", "false", "try", "catch", "throw", "operator", "friend", "virtual"),
    }
)
"""Those of C, then those of C++."""


def check_name(name: object) -> None:
    """Refuse a name that can't be a prefix of names in C.

    Raises:
        ArgumentError: It is not an identifier, a keyword, or longer than 32 characters.
    """
    fits = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", name)
    if not fits or name in KEYWORDS:
        refuse(
            f"name = {name!r}",
            "a letter, then letters, digits and underscores, at most 32 in all; no keyword of C",
        )


def renamed(text: str, name: str) -> str:
    """A C file with the prefixes of its names replaced by `name_` and `NAME_`, also after -D."""
    text = re.sub(rf"\b{NAME}_", f"{name}_", text)
    return re.sub(rf"(\b|(?<=-D)){NAME.upper()}_", f"{name.upper()}_", text)


@cache
def templates() -> "Environment":
    """The templates of this folder; an undefined name is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # not by `import posegsa`

    return Environment(
        loader=PackageLoader("posegsa", "export"),
        autoescape=False,  # C, not HTML
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def comment(lines: Iterable[str]) -> str:
    """Lines of a block comment; comment marks within them are broken up."""
    safe = (line.replace("*/", "* /").replace("/*", "/ *") for line in lines)
    return "\n".join(f" * {line}".rstrip() for line in safe)


def sensors_in_words(vectors: int, landmarks: int) -> str:
    """How many sensors a filter knows, such as "2 vectors and 1 landmark"."""
    each = [(vectors, "vector"), (landmarks, "landmark")]
    return " and ".join(counted(count, name) for count, name in each if count)


def origin(result: Result) -> list[str]:
    """The version and the search that a file comes from."""
    run, search = result.tuned.run, result.tuned.search
    if result.search is None:
        return wrapped(
            f"Written by posegsa {VERSION}. A {result.filter.title} with the numbers of its "
            f"configuration, made with posegsa {result.version}."
        )
    return wrapped(
        f"Written by posegsa {VERSION}. Tuned with posegsa {result.version} in {run.dtype}: "
        f"{search.optimiser}, {search.size_in_words()}, seed {run.seed}."
    )


def whose_sensors(result: Result) -> list[str]:
    """Where the vectors and landmarks that a filter knows come from."""
    if result.filter.kind == "imu":
        return []
    if result.knows_scenario:
        return wrapped(
            "The vectors and landmarks that it knows are those of the configuration's [scenario], "
            "NOT of your sensors: `posegsa export RUN --recording FILE` takes those of a recording."
        )
    return ["The vectors and landmarks that it knows are those of recordings."]


def worth(result: Result) -> list[str]:
    """What a filter is worth: its costs on scenarios, its errors on recordings, its warnings."""
    lines = []
    if result.on_scenarios is not None:
        lines += _on_scenarios(result, result.on_scenarios)
    if (on := result.on_recordings) is not None and (on.training or on.held_out):
        lines += ["Root mean square errors on recordings:", *on.table().splitlines(), ""]
        if not on.held_out:
            lines += wrapped("WARNING: no recording was held out.")
    lines = lines or wrapped(
        "It was not judged for this file. What the configurations that posegsa brings are worth is "
        "in its documentation, docs/which_filter.md and docs/imu.md."
    )
    lines += [line for one in result.warnings() for line in wrapped(f"WARNING: {one}.")]
    origins = [] if on is None else on.origins().splitlines()
    return lines + [part for line in origins for part in wrapped(line)]


def _on_scenarios(result: Result, judged: OnScenarios) -> list[str]:
    rows = [["Cost", "training", "held out", "95 % interval", "worst"]]
    for name, found in costs(result).items():
        gain = found["numbers"].get("gain", [])
        label = f"  {name} {gain[0]:.4g}/s" if gain else f"  {name}"
        keys = ("training_mean", "held_out_mean", "held_out_worst")
        training, held_out, worst = (f"{found[key]:.5g}" for key in keys)
        interval = "[{:.5g}, {:.5g}]".format(*found["held_out_interval"])
        rows.append([label, training, held_out, interval, worst])
    scenarios = len(judged.training[judged.evaluation.own])
    words = (
        f"Means over {counted(scenarios, 'training scenario')} and over "
        f"{judged.evaluation.scenarios} held-out ones, which the search did not use; the worst is "
        "over the held-out ones."
    )
    return [*text_table(rows).splitlines(), *wrapped(words), *wrapped(judged.too_sure())]


def settings_of(section: Section, without: Collection[str] = ()) -> list[str]:
    """The settings of a section of the configuration, each with its description."""
    return [
        line
        for name, value, description in section.described()
        if name not in without
        for line in wrapped(
            f"{name} = {toml(value)}. {description}",
            initial_indent="  ",
            subsequent_indent="      ",
        )
    ]
