"""Whether Kalman filters are as sure of a pose as they may be: NEES at four times.

Each starts from its sensors, on scenarios from any start with drawn biases and the noise that the
filters assume. Prints the mean NEES over scenarios, 6 for a covariance that is right, and the share
of scenarios in which it is up to the 95 % quantile of chi-squared with 6 degrees of freedom.

    python benchmarks/consistency.py --write   # docs/kalman.md; ten minutes on one core
"""

import numpy as np
from families import DRAWN, parser_of, with_family, with_scenarios
from readme import write_block

import posegsa
from posegsa import config
from posegsa.judging.description import candidate_of, configured_filter
from posegsa.judging.metrics import CONSISTENT_NEES, error_tracks
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys

FILTERS: dict[str, tuple[str, list[str]]] = {
    "`kalman`, not tuned": ("kalman", []),
    "the same, one linearisation": ("kalman", ["filter.iterations=1"]),
    "the same, one linearisation, reset in two frames": (
        "kalman",
        ["filter.iterations=1", 'filter.reset="two frames"'],
    ),
    "`recommended`": ("recommended", []),
}
"""By name: the configuration and its changes."""
TIMES = (1.0, 10.0, 30.0, 60.0)
"""[s]; of the samples that are nearest."""
TOGETHER = 1000
"""Scenarios in memory at a time: 3 GB."""


def nees_of(
    shipped: config.Experiment, family: config.Experiment, scenarios: int, held_out_set: int
) -> np.ndarray:
    """(scenarios, len(TIMES)) the NEES of a configuration's filter."""
    one = with_scenarios(shipped, family, "sensors")
    candidate = candidate_of(configured_filter(shipped), shipped)
    keys = held_out_keys(0, scenarios, held_out_set)
    found = []
    for begin in range(0, scenarios, TOGETHER):
        batch = scenario_batch(one, keys[begin : begin + TOGETHER], filter_of(one))
        nees = error_tracks(candidate, batch).nees
        assert nees is not None  # a Kalman filter has a covariance
        time = np.asarray(batch.samples.time[0], np.float64)
        found.append(nees[:, [np.argmin(np.abs(time - t)) for t in TIMES]])
    return np.concatenate(found)


def main() -> None:
    """Judge all filters."""
    options = parser_of("The NEES of Kalman filters.", 52, "docs/kalman.md", 6000).parse_args()
    posegsa.enable_fast_path()
    family = with_family("observer", DRAWN)
    times = " | ".join(f"at {t:g} s" for t in TIMES)
    lines = [f"| NEES of the pose, from the sensors | {times} |", f"| --- |{' --: |' * len(TIMES)}"]
    for name, (file, changes) in FILTERS.items():
        shipped = config.override(config.load(file), changes)
        nees = nees_of(shipped, family, options.scenarios, options.set)
        means, inside = np.mean(nees, axis=0), 100 * np.mean(nees <= CONSISTENT_NEES, axis=0)
        cells = " | ".join(f"{m:.2f} ({i:.1f} %)" for m, i in zip(means, inside, strict=True))
        lines.append(f"| {name} | {cells} |")
        print(lines[-1], flush=True)
    if options.write:
        write_block("consistency", "\n".join(lines), "docs/kalman.md")


if __name__ == "__main__":
    main()
