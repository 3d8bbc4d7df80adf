"""Export of a tuned filter or its schedule, in one of `FORMATS`.

Writers are imported when they are used, so that importing the list of formats is fast.
"""

import re
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple

from posegsa.errors import PosegsaError

if TYPE_CHECKING:
    from posegsa.judging.result import Result


class Format(NamedTuple):
    """A format that a result can be written in."""

    writer: str
    """The function that maps a result to text, as module:name."""
    about: str
    named: bool = False
    """Whether the user can choose the prefix of the names in it."""
    controller: bool = False
    """Whether it needs a fuzzy gain."""
    references: bool = False
    """Whether it holds the references of vectors and landmarks."""


FORMATS = {
    "json": Format(
        "posegsa.export.tables:export_json",
        "the schedule, its settings and its costs, for other programs",
    ),
    "csv": Format(
        "posegsa.export.tables:export_csv",
        "the control surface as a table: error, rate, gain",
        controller=True,
    ),
    "c": Format(
        "posegsa.export.c_header:export_c",
        "the whole filter, from measurements to pose, as one C99 header",
        named=True,
        references=True,
    ),
    "c-gain": Format(
        "posegsa.export.c_gain:export_c_gain",
        "only the gain's controller, for your own filter, as one C99 file",
        named=True,
        controller=True,
    ),
    "fis": Format(
        "posegsa.export.controllers:export_fis",
        "the gain's controller for MATLAB's Fuzzy Logic Toolbox",
        controller=True,
    ),
    "fll": Format(
        "posegsa.export.controllers:export_fll",
        "the gain's controller for fuzzylite",
        controller=True,
    ),
}
"""The formats of `export`, by name."""


def export(result: "Result", format: str, name: str | None = None, file: str | None = None) -> str:
    """The text of a tuned filter or of its schedule in one of `FORMATS`.

    Args:
        result: The tuned result, on scenarios or on recordings.
        format: A name in `FORMATS`.
        name: Prefix of the names in a C file; default "posegsa".
        file: Name of the file that the text is written to, for the comment and the example in a C
            header; default NAME.h.

    Raises:
        PosegsaError: The format is unknown, takes no name, or needs a fuzzy gain that the result
            does not have.
    """
    if not isinstance(format, str) or format not in FORMATS:
        raise PosegsaError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    if name is not None and not FORMATS[format].named:
        named = (other for other, about in FORMATS.items() if about.named)
        raise PosegsaError(f"name = {name!r}; allowed: only with {' or '.join(named)}")
    if FORMATS[format].controller and result.filter.kind != "fuzzy":
        others = (other for other, about in FORMATS.items() if not about.controller)
        raise PosegsaError(
            f"format = {format!r} of a {result.filter.title}; allowed: {', '.join(others)}, or a "
            "fuzzy gain"
        )
    write = resolve_name(FORMATS[format].writer)
    text = write(result) if name is None else write(result, name=name)
    if FORMATS[format].named and file is not None and re.fullmatch(r"[\w.+ -]+", file):
        from posegsa.export.c_text import NAME  # slow, as the writers

        text = text.replace(f"{name or NAME}.h", file)
    return text
