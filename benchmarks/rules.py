"""Whether it helps to search the rule table in addition to k1 to k22.

Compares the paper's table, that table with a reversed error axis, and searched tables, with the
same number of evaluations. The first test uses short simulated scenarios from any start
(`configs/quick.toml` with a larger search). The second uses recordings of inertial sensors,
prepared as in `posegsa replay imu`, tuned on three trials and judged on the others. The table has
medians (minimum to maximum) over seeds.

    python benchmarks/rules.py DATA_FOLDER [--seeds 3]

DATA_FOLDER holds trials of BROAD as published (https://github.com/dlaidig/broad).
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

import posegsa
from posegsa import config
from posegsa.judging.evaluation import TUNED
from posegsa.judging.on_recordings import mean_errors
from posegsa.recordings.recording import Recording
from posegsa.words import text_table

TABLES = "paper", "reversed", "searched"
SIMULATED = {"search.agents": 64, "search.iterations": 80}
TRAINING = "02", "14", "33"
"""Trials for tuning: slow, with breaks, and with a magnet on the body."""
SECONDS = 90.0
"""Duration used of each trial [s]."""
INERTIAL = {
    "filter": {"vector_bias": "off", "cross_vector": False, "normalise_vectors": False},
    "fuzzy": {"offset": 0.0},
    "parameters": {
        "gain_range": [0.0, 20.0],
        "also": [
            {"key": key, "lower": lower, "upper": upper, "scale": "logarithmic"}
            for key, lower, upper in (
                ("filter.gamma", 0.1, 10.0),
                ("scenario.vectors.1.weight", 0.01, 1.0),
                ("gain.smoothing", 0.05, 5.0),
                ("gain.error_scale", 0.003, 1.0),
            )
        ],
    },
    "search": {
        "optimiser": "de",
        "agents": 48,
        "iterations": 40,
        "strategy": "best/1/bin",
        "factor": 0.6,
    },
}


def simulated(table: str, seed: int) -> tuple[float, float]:
    """Mean training and held-out costs."""
    experiment = posegsa.load_config("quick").replace(**SIMULATED, **{"fuzzy.rules": table})
    result = posegsa.tune(experiment, seed=seed)
    judged = result.on_scenarios
    assert result.best_cost is not None
    assert judged is not None
    return result.best_cost, judged.evaluation.cost(TUNED).mean


def inertial(trials: dict[str, Recording]) -> Callable[[str, int], tuple[float, float]]:
    """A function like `simulated` for recordings; costs in [deg]."""
    training = [trials[name] for name in TRAINING]
    held_out = [one for name, one in trials.items() if name not in TRAINING]

    def tuned(table: str, seed: int) -> tuple[float, float]:
        experiment = config.from_dict(INERTIAL).replace(**{"fuzzy.rules": table})
        result = posegsa.tune(experiment, seed=seed, recordings=training, held_out=held_out)
        on = result.on_recordings
        assert on is not None
        return mean_errors(on.training).total, mean_errors(on.held_out).total

    return tuned


def main() -> None:
    """Search, and print the table."""
    posegsa.enable_fast_path()  # before anything uses JAX
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", choices=("simulated", "recordings"))
    options = parser.parse_args()
    trials = {
        path.name[:2]: Recording.read(path).window(0, SECONDS)
        for path in sorted(options.folder.glob("*.mat"))
    }
    rows = [["", "rules", "trained on", "held out"]]
    kinds = {
        "simulated": ("simulated, cost", simulated),
        "recordings": ("BROAD, deg", inertial(trials)),
    }
    for kind, (name, tune) in kinds.items():
        if options.only not in (None, kind):
            continue
        for table in TABLES:
            costs = np.array([tune(table, seed) for seed in range(options.seeds)])
            low, middle, high = np.min(costs, 0), np.median(costs, 0), np.max(costs, 0)
            cells = [f"{middle[i]:.3g} ({low[i]:.3g} to {high[i]:.3g})" for i in range(2)]
            rows.append([name, table, *cells])
            print(rows[-1], flush=True)
    print(text_table(rows))


if __name__ == "__main__":
    main()
