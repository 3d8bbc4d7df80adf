"""A tuned schedule out of Python, in one of `FORMATS`."""

from posegsa.errors import PosegsaError
from posegsa.export.c import export_c
from posegsa.export.recorded import recorded_json
from posegsa.export.tables import SCHEMA, export_csv, export_json
from posegsa.judging.recorded import RecordingResult
from posegsa.judging.result import TuneResult

__all__ = ["FORMATS", "SCHEMA", "export", "export_c", "export_csv", "export_json"]

FORMATS = {"json": export_json, "csv": export_csv, "c": export_c}
"""What `export` writes, by name; the name is also the file's usual extension."""


def export(result: TuneResult | RecordingResult, format: str) -> str:
    """The text of a tuned schedule in one of `FORMATS`.

    Raises:
        PosegsaError: There is no such format.
    """
    if not isinstance(format, str) or format not in FORMATS:
        raise PosegsaError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    if isinstance(result, RecordingResult):
        if format != "json":
            raise PosegsaError(f"format = {format!r} of a result on recordings; allowed: 'json'")
        return recorded_json(result)
    return FORMATS[format](result)
