"""Whether Kalman filters are as sure of a pose as they may be: NEES at three times.

Each starts from its sensors, on scenarios from any start with drawn biases and the noise that the
filters assume. Prints the mean NEES over scenarios, 6 for a covariance that is right, and the share
of scenarios in which it is up to the 95 % quantile of chi-squared with 6 degrees of freedom.

    python benchmarks/consistency.py --write   # docs/kalman.md; two minutes on two cores
"""

import numpy as np
from families import DRAWN, options_of, with_family, with_scenarios
from readme import write_block

import posegsa
from posegsa import config
from posegsa.judging.description import candidate_of, configured_filter
from posegsa.judging.metrics import CONSISTENT_NEES, error_tracks
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys

FILTERS = {"`kalman`, not tuned": "kalman", "`recommended`": "recommended"}
TIMES = (10.0, 30.0, 60.0)
"""[s]; of the samples that are nearest."""


def main() -> None:
    """Judge all filters."""
    options = options_of("The NEES of Kalman filters.", 44, "docs/kalman.md")
    posegsa.enable_fast_path()
    family = with_family("observer", DRAWN)
    keys = held_out_keys(0, options.scenarios, options.set)
    lines = [
        "| NEES of the pose, from the sensors | at 10 s | at 30 s | at 60 s |",
        "| --- | --: | --: | --: |",
    ]
    for name, file in FILTERS.items():
        shipped = config.load(file)
        one = with_scenarios(shipped, family, "sensors")
        batch = scenario_batch(one, keys, filter_of(one))
        nees = error_tracks(candidate_of(configured_filter(shipped), shipped), batch).nees
        assert nees is not None  # a Kalman filter has a covariance
        time = np.asarray(batch.samples.time[0], np.float64)
        samples = [np.argmin(np.abs(time - t)) for t in TIMES]
        cells = [
            f"{np.mean(nees[:, k]):.2f} ({100 * np.mean(nees[:, k] <= CONSISTENT_NEES):.1f} %)"
            for k in samples
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    if options.write:
        write_block("consistency", "\n".join(lines), "docs/kalman.md")


if __name__ == "__main__":
    main()
