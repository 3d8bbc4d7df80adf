"""The observer from every kind of start: how configs/observer.toml was tuned, and what it is worth.

A family has one kind of start. This search has scenarios of three: from the sensors, from any pose,
and from an attitude that is 150 to 180 deg off. It is otherwise that of observer.toml.

    python benchmarks/observer_starts.py --search 0     seed 0; judged on validation; prints [tuned]
    python benchmarks/observer_starts.py --held-out 33  judges observer.toml as it is
"""

import argparse
import warnings
from collections.abc import Iterable

import jax
import numpy as np
from jax import Array
from readme import ROOT

import posegsa
from posegsa import config
from posegsa.judging.description import candidate_of, configured_filter, describe
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario, scenario_batch
from posegsa.search.keys import held_out_keys, scenario_keys, training_keys
from posegsa.search.keys import keys as keys_of
from posegsa.search.population import ScenarioBatch, costs_by_scenario
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import run_search

FILE = ROOT / "configs" / "observer.toml"
STARTS: dict[str, tuple[str, ...]] = {
    "from the sensors": ("scenario.start=sensors",),
    "any": (),
    "150 to 180 deg": ("family.attitude_error=[150.0, 180.0]",),
    "0 to 10 deg at the true position": (
        "family.attitude_error=[0.0, 10.0]",
        "family.position_error=[0.0, 0.0]",
    ),
    "0 to 10 deg, 0 to 10 m": ("family.attitude_error=[0.0, 10.0]",),
    "any, with jumps": ("family.jumps={rate = 0.05}",),
}
"""Settings of the scenarios with each kind of start."""
TRAINED = 3
"""How many of them are tuned on, the first."""
EACH = 16
"""Training scenarios of each."""
VALIDATION, VALIDATION_SEED = 256, 1000
"""How many validation scenarios of each, and whose: those of no search."""


def drawn(experiment: config.Experiment, start: str, keys: Array) -> ScenarioBatch:
    """Scenarios with one kind of start, for the experiment's own filter."""
    changed = config.override(experiment, STARTS[start])
    return scenario_batch(changed, scenario(changed), keys, filter_of(experiment))


def joined(batches: Iterable[ScenarioBatch]) -> ScenarioBatch:
    """One batch of all, in which every scenario says when its estimate begins."""
    begun = [
        one._replace(begin=np.zeros(len(one.bias), one.dtype)) if one.begin is None else one
        for one in batches
    ]
    names = ("samples", "initial", "bias", "vector_bias", "begin")
    together = {
        name: jax.tree.map(
            lambda *leaves: np.concatenate(leaves), *(getattr(one, name) for one in begun)
        )
        for name in names
    }
    return begun[0]._replace(**together)


def searched(experiment: config.Experiment) -> Candidate:
    """The best candidate of the search on all three starts."""
    run = experiment.run
    problem = tuning_problem(experiment.replace(**{"run.held_out_scenarios": 1}))
    keys = training_keys(run.seed, TRAINED * EACH)
    each = [keys[first : first + EACH] for first in range(0, len(keys), EACH)]
    batches = [drawn(experiment, *pair) for pair in zip(STARTS, each, strict=False)]
    found = run_search(problem._replace(training=joined(batches))).search
    print(f"training {float(found.best_cost):.2f}", flush=True)
    return problem.space.candidate(found.best_position)


def judge(experiment: config.Experiment, candidate: Candidate, keys: Array) -> None:
    """Print mean cost, 99th percentile and worst for each kind of start."""
    one = jax.tree.map(lambda leaf: leaf[None], candidate)
    for start in STARTS:
        costs = np.asarray(costs_by_scenario(one, drawn(experiment, start, keys)))[:, 0]
        ends = f"{np.quantile(costs, 0.99):.1f} {costs.max():.1f}"
        print(f"{start}: {costs.mean():.2f} {ends}", flush=True)


def tuned_table(found: Candidate, experiment: config.Experiment) -> str:
    """The numbers of a search as [tuned] of a configuration."""
    said = describe(found, experiment, 0)
    lines = ["[tuned]", "numbers = [  # k1 to k22"]
    k = [f"{number:.7g}" for number in said.numbers["k"]]
    lines += [f"  {', '.join(k[first : first + 6])}," for first in range(0, len(k), 6)]
    also = [f'"{key}" = {value:.7g}' for key, value in said.also.items()]
    return "\n".join([*lines, "]", "", "[tuned.also]", *also])


def main() -> None:
    parser = argparse.ArgumentParser(description="The observer from every kind of start.")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--search", type=int, metavar="SEED", help="search with a seed")
    which.add_argument("--held-out", type=int, metavar="SET", help="judge on a held-out set")
    parser.add_argument("--scenarios", type=int, default=1000, help="how many held-out ones")
    parser.add_argument("--config", default=FILE, help="another observer to judge, or to search")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    experiment = config.load(options.config)
    if options.held_out is not None:
        found = candidate_of(configured_filter(experiment), experiment)
        judge(experiment, found, held_out_keys(0, options.scenarios, options.held_out))
        return
    experiment = experiment.replace(
        **{"run.seed": options.search, "run.training_scenarios": TRAINED * EACH}
    )
    found = searched(experiment)
    judge(experiment, found, scenario_keys(keys_of(VALIDATION_SEED).validation, VALIDATION))
    print(tuned_table(found, experiment))


if __name__ == "__main__":
    main()
