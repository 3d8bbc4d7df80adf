"""Faulty input: hostile configurations and arguments are refused with a message or work."""

import sys
import tempfile
from collections import Counter

import numpy as np
from readme import ROOT

import posegsa
from posegsa import config
from posegsa.saving.result_files import load

sys.path.insert(0, str(ROOT / "tests"))  # it is generated as the tests do

STRUCTURES = (
    (),
    ("search.random=agent", "search.bounds=clip", "search.force_power=2.0"),
    ("search.optimiser=random_search", "objective.name=worst", "filter.gain_limit=off"),
    ("filter.law=printed", "gain.signal=pose", "fuzzy.no_rule=midrange"),
    ("fuzzy.centroid=sampled", "fuzzy.ordering=false", "fuzzy.coverage=false"),
    ("run.dtype=float64", "objective.name=cvar", "search.bounds=reflect"),
    ("search.optimiser=pso", "objective.name=mean_std"),
    ("search.optimiser=de", "search.agents=4"),
)
"""Choices that determine the compiled program; for each, hundreds of numbers are drawn."""
TUNED_STRUCTURES = 12
"""Number of structures that are tuned completely in one part of the campaign: the first ones, with
most configurations. Compiling a complete tune takes about ten seconds, a search alone three."""
WRITTEN = 10
"""Every WRITTEN-th complete tune is written to a folder and read back, which takes seconds too."""


def inputs(wanted: int, rng: np.random.Generator) -> Counter:
    """Configurations: each is refused with a message, or gives a result without NaN.

    Any other exception ends the campaign.
    """
    import jax
    from helpers import generated

    from posegsa.errors import PosegsaError
    from posegsa.search.problem import tuning_problem
    from posegsa.search.run_search import run_search

    names = ("configurations tuned whole", "of these written and read back")
    names += ("configurations searched only", "results with NaN")
    counts: Counter = Counter(dict.fromkeys(names, 0))
    tiny = [
        *("scenario.duration=0.3", "cost.steady_window=[10, 29]", "cost.transient_window=[0, 5]"),
        *("search.agents=3", "search.iterations=2", "run.training_scenarios=2"),
        "run.held_out_scenarios=3",
    ]
    bases = [config.override(config.Experiment(), [*tiny, *s]) for s in STRUCTURES]
    whole: dict[tuple, bool] = {}
    while counts["configurations"] < wanted:
        base = bases[rng.integers(len(bases))]
        counts["configurations"] += 1
        try:
            experiment = config.from_dict(generated.configuration(rng, base))
        except PosegsaError:
            counts["configurations refused by name"] += 1
            continue
        try:
            with jax.enable_x64(experiment.run.dtype == "float64"):
                task = tuning_problem(experiment)
                kind = generated.structure(task)
                found = None
                if not whole.setdefault(kind, len(whole) < TUNED_STRUCTURES):
                    found = run_search(task).search
            if found is None:
                nan, best = tuned_whole(experiment, counts)
            else:
                counts["configurations searched only"] += 1
                best = float(found.best_cost)
                numbers = (best, found.best_position, found.history.best)
                nan = any(np.isnan(a).any() for a in numbers)
        except PosegsaError:
            counts["configurations refused by name"] += 1
            continue
        counts["configurations run"] += 1
        counts["results with NaN"] += nan
        counts["configurations run, no agent with a finite cost"] += int(np.isinf(best))
    return counts


def tuned_whole(experiment: config.Experiment, counts: Counter) -> tuple[bool, float]:
    """Tune, sometimes with a folder; returns whether anything is NaN, and the best cost."""
    from helpers import generated

    count = "configurations tuned whole"
    if counts[count] % WRITTEN == 0:
        with tempfile.TemporaryDirectory() as folder:
            posegsa.tune(experiment, out=folder)
            result = load(folder)
        counts["of these written and read back"] += 1
    else:
        result = posegsa.tune(experiment)
    counts[count] += 1
    assert result.best_cost is not None  # it was searched
    return bool(generated.not_numbers(result)), result.best_cost


def calls(wanted: int, rng: np.random.Generator) -> Counter:
    """Calls of public functions: each is refused with a message, or returns."""
    from helpers import generated

    from posegsa.errors import PosegsaError

    counts: Counter = Counter()
    result = generated.some_result()
    while counts["calls"] < wanted:
        counts["calls"] += 1
        try:
            generated.call(rng, result).make()
            counts["calls answered"] += 1
        except PosegsaError:
            counts["calls refused by name"] += 1
    return counts
