"""The history of a search as a table."""

import csv
from pathlib import Path

import numpy as np

from posegsa.errors import RunFolderError
from posegsa.optimisers import History


def history_csv(history: History) -> str:
    """A history as CSV, a row an iteration; reading it back gives the same numbers."""
    lines = ["iteration,best,mean,worst,non_finite"]
    columns = (np.asarray(column).tolist() for column in history)
    for i, (best, mean, worst, bad) in enumerate(zip(*columns, strict=True), start=1):
        lines.append(f"{i},{best!r},{mean!r},{worst!r},{bad}")
    return "\n".join(lines) + "\n"


def read_history(path: Path) -> History:
    """Read what `history_csv` wrote.

    Raises:
        RunFolderError: The file is missing, or its columns are not a history's.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        columns = {
            name: np.array([float(row[name]) for row in rows]) for name in ("best", "mean", "worst")
        }
        bad = np.array([int(row["non_finite"]) for row in rows])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RunFolderError(f"{path}: cannot be read as a history: {error}") from None
    return History._make([columns["best"], columns["mean"], columns["worst"], bad])
