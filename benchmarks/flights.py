"""Which filter to take for a recording: eight flights, two of each kind, tuned on the other one.

Each filter starts from the sensors. A tuned one was tuned on the other flight of the kind, the
others were not tuned; RMSEs count from the first sample on. Then EuRoC V1_02 with a velocity and
landmarks made from its truth, tuned on its first 40 s and judged on the rest.

DATA_FOLDER has the folders `flights`, with car_1.csv and so on, and `euroc`.

    python benchmarks/flights.py DATA_FOLDER [--write]
"""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

from readme import ROOT, write_block

import posegsa
from posegsa.judging.on_recordings import mean_errors
from posegsa.judging.result import Result
from posegsa.recordings.recording import Recording

KINDS = "car", "eight", "handheld", "hover"
PAGE = "docs/recordings.md"
SENSORS = ROOT / "examples" / "data" / "sensors.toml"
SPLIT = 40.0
"""Time that separates the tuning part of EuRoC from the judged part [s]."""
Made = Callable[[Recording, Recording], Result]


def as_it_is(name: str | Path) -> Made:
    """The filter of a configuration, not tuned."""
    return lambda _, judged: posegsa.configured(name, recordings=[judged])


def tuned(name: str | None) -> Made:
    """The filter of a configuration, or of none, tuned on the other flight."""
    return lambda other, judged: posegsa.tune(name, recordings=[other], held_out=[judged])


FILTERS: dict[str, Made] = {
    "`tune`": tuned(None),
    "`sensors.toml`": as_it_is(SENSORS),
    "`kalman`": as_it_is("kalman"),
    "`recommended`": as_it_is("recommended"),
    "`tune kalman`": tuned("kalman"),
    "`tune recommended`": tuned("recommended"),
    "`tune landmarks`": tuned("landmarks"),
}
ON_EUROC = "`tune`", "`kalman`", "`tune kalman`"
"""Filters that need no vectors, or know their sensors."""


def row(name: str, other: Recording, judged: Recording, columns: Iterable[str]) -> list[str]:
    """Errors of filters on one recording, each in its column."""
    cells = [name]
    for column, made in FILTERS.items():
        if column not in columns:
            cells.append("-")
            continue
        on = made(other, judged).on_recordings
        assert on is not None
        errors = mean_errors(on.held_out)
        cells.append(f"{errors.total:.2f}, {100 * (errors.position or 0.0):.1f}")
    print(" | ".join(cells), flush=True)
    return cells


def rows(data: Path) -> list[list[str]]:
    """All rows of the table."""
    found = []
    for kind in KINDS:
        pair = [Recording.read(data / "flights" / f"{kind}_{i}.csv") for i in (1, 2)]
        for judged, other in (pair, pair[::-1]):
            found.append(row(judged.name, other, judged, FILTERS))
    for rate in (200.0, 20.0):
        whole = Recording.from_euroc(data / "euroc", landmark_rate=rate)
        parts = whole.window(0, SPLIT), whole.window(SPLIT)
        found.append(row(f"EuRoC, {rate:g} Hz", *parts, ON_EUROC))
    return found


def main() -> None:
    """Measure, print the table and write it into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("data", metavar="DATA_FOLDER", type=Path)
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    heads = ["RMSE [deg], [cm]", *FILTERS]
    table = [heads, ["---", *["--:"] * (len(heads) - 1)], *rows(options.data)]
    text = "\n".join(f"| {' | '.join(cells)} |" for cells in table)
    print(text)
    if options.write:
        write_block("flights", text, PAGE)


if __name__ == "__main__":
    main()
