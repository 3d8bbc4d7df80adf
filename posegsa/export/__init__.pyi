"""The names of this package, and where they are (`posegsa.lazy`)."""

from posegsa.export.c import export_c as export_c
from posegsa.export.c import filter_to_c as filter_to_c
from posegsa.export.c_gain import export_c_gain as export_c_gain
from posegsa.export.controllers import export_fis as export_fis
from posegsa.export.controllers import export_fll as export_fll
from posegsa.export.formats import FORMATS as FORMATS
from posegsa.export.formats import export as export
from posegsa.export.tables import SCHEMA as SCHEMA
from posegsa.export.tables import export_csv as export_csv
from posegsa.export.tables import export_json as export_json
