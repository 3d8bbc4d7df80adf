"""Which filter to take for a recording: eight flights, two of each kind, tuned on the other one.

Each filter starts from the sensors. A tuned one was tuned on the other flight of the kind, the
others were not tuned; RMSEs leave out the first 5 s. Then EuRoC V1_02 with a velocity and landmarks
made from its truth, tuned on its first 40 s and judged on the rest.

DATA_FOLDER has the folders `flights`, with car_1.csv and so on, and `euroc`.

    python benchmarks/flights.py DATA_FOLDER [--write] [--only "tune landmarks"]
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
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
SETTLED = 5.0
"""Time after which errors count [s]."""
Made = Callable[[Recording, Recording], Result]


def once_settled(recording: Recording) -> Recording:
    """The recording, its first SETTLED seconds not judged."""
    settled = recording.time >= recording.time[0] + SETTLED
    return replace(recording, judged=recording.judged & settled)


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
    "`tune kalman`": tuned("kalman"),
    "`tune landmarks`": tuned("landmarks"),
}
ON_EUROC = "`tune`", "`kalman`", "`tune kalman`", "`tune landmarks`"
"""Filters that need no vectors, or know their sensors."""
Cells = dict[tuple[str, str], str]
"""The cells of the table by row and column."""


def row(
    name: str, other: Recording, judged: Recording, columns: Iterable[str], held: Cells
) -> list[str]:
    """Errors of filters on one recording, each in its column; the rest as held, or "-"."""
    judged, cells = once_settled(judged), [name]
    for column, made in FILTERS.items():
        if column not in columns:
            cells.append(held.get((name, column), "-"))
            continue
        on = made(other, judged).on_recordings
        assert on is not None
        errors = mean_errors(on.held_out)
        cells.append(f"{errors.total:.3f}, {100 * (errors.position or 0.0):.2f}")
    print(" | ".join(cells), flush=True)
    return cells


def rows(data: Path, columns: Iterable[str], held: Cells) -> list[list[str]]:
    """All rows of the table, these columns of them made anew."""
    found = []
    for kind in KINDS:
        pair = [Recording.read(data / "flights" / f"{kind}_{i}.csv") for i in (1, 2)]
        for judged, other in (pair, pair[::-1]):
            found.append(row(judged.name, other, judged, columns, held))
    for rate in (200.0, 20.0):
        whole = Recording.from_euroc(data / "euroc", landmark_rate=rate)
        parts = whole.window(0, SPLIT), whole.window(SPLIT)
        some = [column for column in columns if column in ON_EUROC]
        found.append(row(f"EuRoC, {rate:g} Hz", *parts, some, held))
    return found


def held_cells() -> Cells:
    """The cells of the page's table."""
    text = (ROOT / PAGE).read_text("utf-8")
    block = text.split("<!-- flights: begin -->")[1].split("<!-- flights: end -->")[0]
    heads, _, *lines = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in block.strip().splitlines()
    )
    return {
        (line[0], head): cell
        for line in lines
        for head, cell in zip(heads[1:], line[1:], strict=True)
    }


def main() -> None:
    """Measure, print the table and write it into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("data", metavar="DATA_FOLDER", type=Path)
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    parser.add_argument("--only", action="append", help="a column to make anew, the rest as held")
    options = parser.parse_args()
    posegsa.enable_fast_path()
    columns, held = list(FILTERS), {}
    if options.only:
        columns, held = [f"`{name}`" for name in options.only], held_cells()
        if unknown := set(columns) - set(FILTERS):
            parser.error(f"--only: {', '.join(unknown)}; allowed: {', '.join(FILTERS)}")
    heads = [f"RMSE after {SETTLED:g} s [deg], [cm]", *FILTERS]
    table = [heads, ["---", *["--:"] * (len(heads) - 1)], *rows(options.data, columns, held)]
    text = "\n".join(f"| {' | '.join(cells)} |" for cells in table)
    print(text)
    if options.write:
        write_block("flights", text, PAGE)


if __name__ == "__main__":
    main()
