"""The history of a search as a table."""

import csv
import io

import numpy as np

from posegsa.optimisers import History


def history_csv(history: History) -> str:
    """A history as CSV, a row an iteration; reading it back gives the same numbers."""
    lines = ["iteration,best,mean,worst,non_finite"]
    columns = (np.asarray(column).tolist() for column in history)
    for i, (best, mean, worst, bad) in enumerate(zip(*columns, strict=True), start=1):
        lines.append(f"{i},{best!r},{mean!r},{worst!r},{bad}")
    return "\n".join(lines) + "\n"


def read_history(text: str) -> History:
    """Read what `history_csv` wrote.

    Raises:
        ValueError: Its columns are not a history's.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(text)))
        columns = {
            name: np.array([float(row[name]) for row in rows]) for name in ("best", "mean", "worst")
        }
        bad = np.array([int(row["non_finite"]) for row in rows])
    except (csv.Error, KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"history.csv: cannot be read as a history: {error}") from None
    return History._make([columns["best"], columns["mean"], columns["worst"], bad])
