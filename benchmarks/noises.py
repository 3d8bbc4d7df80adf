"""What it costs to believe the wrong noises: all three times too small, and three times too large.

Each filter as shipped, on scenarios whose sensors have the noise that it believes, three times that
noise, and a third of it, with velocity, vector and landmark biases as they are. Prints mean cost
(99th percentile). With DATA_FOLDER, which has the folder `flights`, also the errors after 5 s of
`examples/data/sensors.toml` on the eight flights, its noises multiplied instead of theirs.

    python benchmarks/noises.py [--flights DATA_FOLDER] --write   # half an hour on two cores
"""

from pathlib import Path
from typing import Any

import numpy as np
from families import STARTS, judged, parser_of, with_family, with_scenarios, words
from flights import KINDS, SENSORS, once_settled
from readme import write_block

import posegsa
from posegsa import config
from posegsa.judging.clairvoyance import clairvoyant_costs
from posegsa.judging.on_recordings import mean_errors
from posegsa.recordings.recording import Recording
from posegsa.search.keys import held_out_keys

TIMES = {"as believed": 1.0, "3 times that": 3.0, "a third of it": 1 / 3}
"""The sensors' noise as a multiple of what a filter believes."""
KALMAN = ("kalman", "sensors")
RECOMMENDED, SPARSE = ("recommended", "given"), ("sparse", "sensors")
ADAPTED = "filter.noise_adaptation=100.0"
FILTERS: dict[str, tuple[str, list[tuple[str, ...]]]] = {
    "any start": (
        "observer",
        [KALMAN, RECOMMENDED, (*RECOMMENDED, ADAPTED), ("observer", "given")],
    ),
    "as in the field": ("field", [KALMAN, ("field", "given")]),
    "disturbed sensors": ("disturbed", [KALMAN, ("disturbed", "sensors")]),
    "sparse sensors": (
        "sparse",
        [KALMAN, SPARSE, (*SPARSE, ADAPTED), ("sparse", "given")],
    ),
}
"""By kind of scenario: its configuration, and the filters with their starts and settings."""
SENSOR_NOISES = "angular_velocity", "velocity", "vector", "landmark"


def on_scenarios(scenarios: int, which: int) -> list[str]:
    """The rows of the table on scenarios."""
    keys, lines = held_out_keys(0, scenarios, which), []
    for kind, (file, filters) in FILTERS.items():
        families = [with_family(file, {"noise_scale": [x, x]}) for x in TIMES.values()]
        for name, start, *settings in filters:
            own = config.override(config.load(name), settings)
            cells = [words(judged(own, family, keys, start).cost) for family in families]
            take = " --set ".join((name, *settings))
            lines.append(f"| {kind} | `{take}`, {STARTS[start]} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
        known = [with_scenarios(config.load("kalman"), family) for family in families]
        cells = [words(np.asarray(clairvoyant_costs(one, keys))) for one in known]
        lines.append(f"| {kind} | clairvoyant | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def on_flights(data: Path) -> str:
    """The row of the table on flights: mean errors over all."""
    stated = config.load(SENSORS)
    recordings = [
        once_settled(Recording.read(data / "flights" / f"{kind}_{i}.csv"))
        for kind in KINDS
        for i in (1, 2)
    ]
    cells = []
    for times in TIMES.values():
        believed: dict[str, Any] = {
            f"filter.{name}": getattr(stated.filter, name) / times for name in SENSOR_NOISES
        }
        on = posegsa.configured(stated.replace(**believed), recordings=recordings).on_recordings
        assert on is not None
        errors = mean_errors(on.held_out)
        cells.append(f"{errors.total:.2f}°, {100 * (errors.position or 0.0):.1f} cm")
    return f"| the eight flights | `sensors.toml` | {' | '.join(cells)} |"


def main() -> None:
    """Judge all filters."""
    parser = parser_of("Filters that believe the wrong noises.", 49, "docs/which_filter.md")
    parser.add_argument("--flights", metavar="DATA_FOLDER", type=Path)
    options = parser.parse_args()
    posegsa.enable_fast_path()
    lines = [
        f"| scenarios | filter | {' | '.join(f'noise {which}' for which in TIMES)} |",
        "| --- | --- | --: | --: | --: |",
        *on_scenarios(options.scenarios, options.set),
    ]
    if options.flights is not None:
        lines.append(on_flights(options.flights))
        print(lines[-1])
    if options.write:
        write_block("noises", "\n".join(lines), "docs/which_filter.md")


if __name__ == "__main__":
    main()
