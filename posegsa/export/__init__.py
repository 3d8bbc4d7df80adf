"""A tuned filter, or its schedule, out of Python, in one of `FORMATS`."""

from posegsa.errors import PosegsaError
from posegsa.export.c import export_c, filter_to_c
from posegsa.export.c_gain import export_c_gain
from posegsa.export.controllers import export_fcl, export_fis, export_fll, export_fml
from posegsa.export.tables import SCHEMA, export_csv, export_json
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult

__all__ = [
    "FORMATS",
    "SCHEMA",
    "export",
    "export_c",
    "export_c_gain",
    "export_csv",
    "export_fcl",
    "export_fis",
    "export_fll",
    "export_fml",
    "export_json",
    "filter_to_c",
]

FORMATS = {
    "json": export_json,
    "csv": export_csv,
    "c": export_c,
    "c-gain": export_c_gain,
    "fis": export_fis,
    "fll": export_fll,
    "fcl": export_fcl,
    "fml": export_fml,
}
"""What `export` writes, by name."""
CONTROLLERS = ("csv", "c-gain", "fis", "fll", "fcl", "fml")
"""Formats of a fuzzy controller; other gains have none."""
NAMED = ("c", "c-gain")
"""Formats whose names begin with one that can be chosen."""


def export(result: TuneResult | RecordingResult, format: str, name: str | None = None) -> str:
    """The text of a tuned filter or of its schedule in one of `FORMATS`.

    Args:
        result: what was tuned, on scenarios or on recordings.
        format: of `FORMATS`.
        name: what the names in a file of C begin with; default "posegsa".

    Raises:
        PosegsaError: There is no such format, it has no names that could begin with one, or it is
            of fuzzy controllers and the gain is none.
    """
    if not isinstance(format, str) or format not in FORMATS:
        raise PosegsaError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    if name is not None and format not in NAMED:
        raise PosegsaError(f"name = {name!r}; allowed: only with {' or '.join(NAMED)}")
    if isinstance(result, RecordingResult) and format in CONTROLLERS:
        kind = result.filter.kind
        if kind != "fuzzy":
            raise PosegsaError(
                f"format = {format!r} of a {kind} gain; allowed: "
                f"{', '.join(name for name in FORMATS if name not in CONTROLLERS)}, or a fuzzy gain"
            )
    return FORMATS[format](result) if name is None else FORMATS[format](result, name=name)
