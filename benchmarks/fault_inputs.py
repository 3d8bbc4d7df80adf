"""Faults of whoever calls: hostile configurations and arguments, refused in words or answered."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
from readme import ROOT

from posegsa import config

sys.path.insert(0, str(ROOT / "tests"))  # it is generated as the tests do

STRUCTURES = (
    (),
    ("gsa.random=agent", "gsa.bounds=clip", "gsa.force_power=2.0"),
    ("search.optimiser=random_search", "objective.name=worst", "filter.gain_limit=off"),
    ("filter.law=printed", "gain.signal=pose", "fuzzy.no_rule=midrange"),
    ("fuzzy.centroid=sampled", "fuzzy.ordering=false", "fuzzy.coverage=false"),
    ("run.dtype=float64", "objective.name=cvar", "gsa.bounds=reflect"),
)
"""What is compiled; the numbers in it are drawn by the hundred."""
MOST_STRUCTURES = 14
"""Programs compiled in one piece of the campaign, for seconds each."""


def inputs(wanted: int, rng: np.random.Generator) -> Counter:
    """Configurations: refused in words, or run to a result without NaN."""
    import generated
    import jax

    from posegsa.errors import PosegsaError
    from posegsa.search import make_ready, run_search

    counts: Counter = Counter()
    tiny = [
        *("scenario.duration=0.3", "cost.steady_window=[10, 29]", "cost.transient_window=[0, 5]"),
        *("search.agents=3", "search.iterations=2", "run.training_scenarios=2"),
    ]
    bases = [config.override(config.Experiment(), [*tiny, *s]) for s in STRUCTURES]
    shape = jax.tree.structure
    known = {}
    while counts["configurations"] < wanted:
        base = bases[rng.integers(len(bases))]
        counts["configurations"] += 1
        try:
            experiment = config.from_dict(generated.configuration(rng, base))
        except PosegsaError:
            counts["configurations refused by name"] += 1
            continue
        # A new structure compiles for seconds: the first ones are run, and all of what has the
        # structure of one that has been.
        try:
            with jax.enable_x64(experiment.run.dtype == "float64"):
                task = make_ready(experiment)
                arrays = (task.training, task.space)
                shapes = tuple((a.shape, a.dtype) for a in jax.tree.leaves(arrays))
                key = (shape(arrays), shapes, task.optimiser, experiment.objective)
                if key not in known and len(known) >= MOST_STRUCTURES:
                    counts["configurations accepted, not compiled"] += 1
                    continue
                known[key] = True
                search = run_search(task).search
        except PosegsaError:
            counts["configurations refused by name"] += 1
            continue
        counts["configurations run"] += 1
        best = np.asarray(search.best_position)
        nan = np.isnan(float(search.best_cost)) or not np.isfinite(best).all()
        counts["results with NaN"] += bool(nan or np.isnan(search.history.best).any())
        counts["configurations run, no agent with a finite cost"] += bool(
            np.isinf(float(search.best_cost))
        )
    counts["other exceptions"] += 0  # they would have ended the campaign
    return counts


def calls(wanted: int, rng: np.random.Generator, folder: Path) -> Counter:
    """Calls of public functions: refused in words, or answered."""
    import generated
    from test_bad_input import some_result

    from posegsa.errors import PosegsaError

    counts: Counter = Counter()
    result = some_result()
    while counts["calls"] < wanted:
        counts["calls"] += 1
        try:
            generated.call(rng, result).make()
            counts["calls answered"] += 1
        except PosegsaError:
            counts["calls refused by name"] += 1
    return counts
