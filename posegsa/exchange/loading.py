"""Read a fuzzy controller from a file of another tool."""

import os
from pathlib import Path
from typing import get_args

from posegsa.arguments import check_type, refuse
from posegsa.errors import FuzzyError
from posegsa.exchange.fis import from_fis
from posegsa.exchange.fll import from_fll
from posegsa.exchange.system import controller_of
from posegsa.model.fuzzy import Centroid, FuzzyController, NoRule

READERS = {".fis": from_fis, ".fll": from_fll}
MAX_BYTES = 2**20
"""Maximum size of a file: 1 MiB."""


def load_controller(
    path: str | Path, *, no_rule: NoRule | None = None, centroid: Centroid = "exact"
) -> FuzzyController:
    """Read a `.fis` (MATLAB) or `.fll` (fuzzylite) file with the structure of our controller.

    The structure: two inputs named error and rate, from 0 to 1, with the same triangular terms; one
    output, whose centroid is the gain minus its offset (1 if it is named `gain_minus_1`); one rule
    for each pair of terms, evaluated with min and max.

    Args:
        path: The file; its suffix selects the format.
        no_rule: What happens where no rule fires, "hold" or "midrange"; None to follow the file. A
            .fis file always means "midrange", because MATLAB does that; a .fll file states it.
        centroid: "exact", or "sampled" for terms that are not in order.

    Returns:
        The controller, at JAX's default precision.

    Raises:
        ArgumentError: An argument has the wrong type, or the suffix is neither of these.
        FuzzyError: The file can't be read, or has another structure; names the file and the
            problem.
    """
    check_type("path", path, str, os.PathLike)
    for name, value, kind in (("no_rule", no_rule, NoRule), ("centroid", centroid, Centroid)):
        if value is not None and value not in get_args(kind):
            refuse(f"{name} = {value!r}", " or ".join(map(repr, get_args(kind))))
    path = Path(path)
    if path.suffix not in READERS:
        refuse(f"path = {str(path)!r}", f"a file that ends in {' or '.join(READERS)}")
    try:
        if not path.is_file():
            raise FuzzyError("does not exist, or is not a file")
        if path.stat().st_size > MAX_BYTES:
            raise FuzzyError(f"has more than {MAX_BYTES} bytes")
        system = READERS[path.suffix](path.read_text(encoding="utf-8"))
        return controller_of(system, no_rule=no_rule, centroid=centroid)
    except FuzzyError as error:
        raise FuzzyError(f"{path}: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FuzzyError(f"{path}: cannot be read: {error}") from None
