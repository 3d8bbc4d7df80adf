"""A tuned schedule out of Python, in one of `FORMATS`."""

from posegsa.errors import PosegsaError
from posegsa.export.c import export_c
from posegsa.export.controllers import export_fcl, export_fis, export_fll, export_fml
from posegsa.export.tables import SCHEMA, export_csv, export_json
from posegsa.judging.result import TuneResult

__all__ = [
    "FORMATS",
    "SCHEMA",
    "export",
    "export_c",
    "export_csv",
    "export_fcl",
    "export_fis",
    "export_fll",
    "export_fml",
    "export_json",
]

FORMATS = {
    "json": export_json,
    "csv": export_csv,
    "c": export_c,
    "fis": export_fis,
    "fll": export_fll,
    "fcl": export_fcl,
    "fml": export_fml,
}
"""What `export` writes, by name; the name is also the file's usual extension."""


def export(result: TuneResult, format: str) -> str:
    """The text of a tuned schedule in one of `FORMATS`.

    Raises:
        PosegsaError: There is no such format.
    """
    if not isinstance(format, str) or format not in FORMATS:
        raise PosegsaError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    return FORMATS[format](result)
