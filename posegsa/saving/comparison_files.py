"""The files of a comparison of optimisers: its searches, table and figure."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from posegsa.errors import RunFolderError
from posegsa.figures.comparison_figures import plot_comparison
from posegsa.figures.style import png
from posegsa.judging.comparison import OptimiserComparison
from posegsa.saving.atomic_files import write_atomically
from posegsa.saving.folder import as_path, read_text, replace_files, write_errors
from posegsa.saving.records import from_json, to_json

SCHEMA = 3
"""Version of the format of comparison.json."""
DATA, TABLE, FIGURE = "comparison.json", "comparison.txt", "comparison.png"


def load_comparison(folder: str | Path) -> OptimiserComparison:
    """The comparison in a folder.

    Raises:
        RunFolderError: There is none, or it is damaged or has another format; names the file and
            the field.
    """
    folder = as_path("folder", folder)
    text = read_text(folder, DATA, of="comparison")
    comparison = from_json(OptimiserComparison, text, SCHEMA, folder / DATA)
    for problem in comparison.disagreements():
        raise RunFolderError(f"{folder / DATA}: {problem}")
    return comparison


def continued(
    comparison: OptimiserComparison, folder: Path, *, overwrite: bool = False
) -> OptimiserComparison:
    """A comparison, with the searches that are already in its locked folder.

    Raises:
        RunFolderError: The folder has another comparison, or one that cannot be read; with
            `overwrite` that is removed instead.
    """
    if not (folder / DATA).exists():
        return comparison
    try:
        stored = load_comparison(folder)
        if (stored.budget, stored.settings) != (comparison.budget, comparison.settings):
            raise RunFolderError(
                f"{folder}: holds a comparison with another problem, budget or settings "
                f"({stored.subject}, {stored.budget} evaluations); choose another folder, or "
                "replace it (--overwrite; overwrite=True)"
            )
    except RunFolderError:
        if not overwrite:
            raise
        # Otherwise the old table and figure would stay with the new searches until the end.
        replace_files(folder, {}, remove=(DATA, TABLE, FIGURE))
        return comparison
    return replace(
        comparison,
        repeats=comparison.repeats | stored.repeats,
        gradients=comparison.gradients | stored.gradients,
    )


def write_searches(comparison: OptimiserComparison, folder: Path) -> None:
    """Write the searches so far to a folder that the caller has locked."""
    with write_errors(folder):
        write_atomically(folder / DATA, _json(comparison))


def write_comparison(
    comparison: OptimiserComparison,
    folder: Path,
    levels: Sequence[float] | None,
    *,
    figure: bool = True,
) -> None:
    """Write JSON, table (with `levels` as costs to reach) and figure to a locked folder."""
    files = {
        DATA: _json(comparison),
        TABLE: f"{comparison.table(levels)}\n".encode(),
    }
    if figure:
        files[FIGURE] = png(plot_comparison(comparison))
    replace_files(folder, files, remove=[FIGURE])


def _json(comparison: OptimiserComparison) -> bytes:
    searched = [name for name, repeats in comparison.repeats.items() if repeats]
    return to_json(comparison.only(searched), SCHEMA).encode()
