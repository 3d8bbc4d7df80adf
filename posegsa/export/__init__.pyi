"""The names of this package, and where they are (`lazy_loader`)."""

from .c_gain import export_c_gain as export_c_gain
from .c_header import export_c as export_c
from .c_header import filter_to_c as filter_to_c
from .controllers import export_fis as export_fis
from .controllers import export_fll as export_fll
from .formats import FORMATS as FORMATS
from .formats import export as export
from .tables import SCHEMA as SCHEMA
from .tables import export_csv as export_csv
from .tables import export_json as export_json
