"""Text that all C files share: templates, comments, names, and the accuracy of a result."""

import re
import textwrap
from collections.abc import Collection, Iterable
from functools import cache, partial
from typing import TYPE_CHECKING

from posegsa.arguments import refuse
from posegsa.export.tables import costs
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult
from posegsa.settings.fields import Section
from posegsa.version import VERSION
from posegsa.words import counted, text_table, toml

if TYPE_CHECKING:
    from jinja2 import Environment

wrapped = partial(textwrap.wrap, width=96, break_long_words=False, break_on_hyphens=False)
"""Lines of a comment's text."""

NAME = "posegsa"
"""Prefix of the names in the templates, and in a file by default."""
_KEYWORDS = frozenset(
    [
        "auto",
        "break",
        "case",
        "char",
        "const",
        "continue",
        "default",
        "do",
        "double",
        "else",
        "enum",
        "extern",
        "float",
        "for",
        "goto",
        "if",
        "inline",
        "int",
        "long",
        "register",
        "restrict",
        "return",
        "short",
        "signed",
        "sizeof",
        "static",
        "struct",
        "switch",
        "typedef",
        "union",
        "unsigned",
        "void",
        "volatile",
        "while",
        "class",
        "new",
        "delete",
        "this",
        "public",
        "private",
        "template",
        "namespace",
        "using",
        "bool",
        "true",
        "false",
        "try",
        "catch",
        "throw",
        "operator",
        "friend",
        "virtual",
    ]
)


def check_name(name: object) -> None:
    """Refuse a name that can't be a prefix of names in C.

    Raises:
        ArgumentError: It is not an identifier, a keyword, or longer than 32 characters.
    """
    fits = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", name)
    if not fits or name in _KEYWORDS:
        refuse(
            f"name = {name!r}",
            "a letter, then letters, digits and underscores, at most 32 in all; no keyword of C",
        )


def renamed(text: str, name: str) -> str:
    """A C file with the prefixes of its names replaced by `name_` and `NAME_`."""
    text = re.sub(rf"\b{NAME}_", f"{name}_", text)
    return re.sub(rf"\b{NAME.upper()}_", f"{name.upper()}_", text)


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


def origin(result: TuneResult | RecordingResult) -> list[str]:
    """The version and the search that a file comes from."""
    run, search = result.tuned.run, result.tuned.search
    if isinstance(result, RecordingResult) and result.best_cost is None:
        return wrapped(
            f"Written by posegsa {VERSION}. A {result.filter.kind} gain made by hand with posegsa "
            f"{result.version}."
        )
    return wrapped(
        f"Written by posegsa {VERSION}. Tuned with posegsa {result.version} in {run.dtype}: "
        f"{search.optimiser}, {search.size_in_words()}, seed {run.seed}."
    )


def worth(result: TuneResult | RecordingResult) -> list[str]:
    """Costs of a tuned filter and of the best constant gain, and the result's warnings.

    For a result on recordings, its errors on them, and which data are measured or synthetic.
    """
    if isinstance(result, RecordingResult):
        return _on_recordings(result)
    names = {
        "tuned": "  this schedule",
        "constant": f"  best constant gain {result.constant_gain:.4g}/s",
    }
    found, rows = costs(result), [["Cost", "training", "held out", "95 % interval", "worst"]]
    for key, name in names.items():
        numbers = (found[key][of] for of in ("training_mean", "held_out_mean", "held_out_worst"))
        training, held_out, worst = (f"{number:.5g}" for number in numbers)
        interval = "[{:.5g}, {:.5g}]".format(*found[key]["held_out_interval"])
        rows.append([name, training, held_out, interval, worst])
    lines = text_table(rows).splitlines()
    lines += wrapped(
        f"Means over {counted(len(result.training_costs), 'training scenario')} and over "
        f"{result.evaluation.scenarios} held-out ones, which the search did not use; the worst is "
        "over the held-out ones."
    )
    return lines + _warnings(result)


def _warnings(result: TuneResult | RecordingResult) -> list[str]:
    return [line for one in result.warnings() for line in wrapped(f"WARNING: {one}.")]


def _on_recordings(result: RecordingResult) -> list[str]:
    """The errors of a filter on recordings, and which data are measured or synthetic."""
    if not (result.training or result.held_out):
        return ["Unknown: it was not evaluated on any recording.", *_warnings(result)]
    lines = ["Root mean square errors on recordings:", *result.table().splitlines(), ""]
    if not result.held_out:
        lines += wrapped("WARNING: no recording was held out.")
    lines += _warnings(result)
    return lines + [part for line in result.origins().splitlines() for part in wrapped(line)]


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
