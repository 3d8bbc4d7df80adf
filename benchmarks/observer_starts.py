"""The observer from every kind of start: how configs/observer.toml was tuned, and its cost.

A family has one kind of start. This search has scenarios of three: from the sensors, from any pose,
and from an attitude that is 150 to 180 deg off. It is otherwise that of observer.toml.

    python benchmarks/observer_starts.py --search 0     seed 0; judged on validation; prints [tuned]
    python benchmarks/observer_starts.py --held-out 33  judges observer.toml as it is
    python benchmarks/observer_starts.py --rivals 3     the effect of each setting, and a clock,
                                                        with 3 seeds each; --write: into the docs
"""

import argparse
import warnings
from collections.abc import Iterable

import jax
import numpy as np
from jax import Array
from readme import ROOT, write_block

import posegsa
from posegsa import config
from posegsa.judging.description import candidate_of, configured_filter, describe
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import held_out_keys, scenario_keys, training_keys
from posegsa.search.keys import keys as keys_of
from posegsa.search.population import ScenarioBatch, costs_by_scenario
from posegsa.search.problem import tuning_problem
from posegsa.search.run_search import run_search
from posegsa.search.schedule_spaces import KNOTS, schedule_space
from posegsa.search.search_spaces import search_space

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
"""The first of these kinds, which the search uses."""
EACH = 16
"""Training scenarios of each."""
VALIDATION, VALIDATION_SEED = 256, 1000
"""Validation scenarios of each kind, and their seed, which no search uses."""
CLOCK = f"a gain by the clock, {KNOTS} knots, with the last two"
RIVALS: dict[str, tuple[str, ...]] = {
    "the observer": (),
    "without `gain.unknown`": ("gain.unknown=off",),
    "without `filter.bias_wait`": ("filter.bias_wait=off",),
    "without `filter.length_growth`": ("filter.length_growth=off",),
    "without all three": ("gain.unknown=off", "filter.bias_wait=off", "filter.length_growth=off"),
    CLOCK: ("filter.schedule=constant",),  # searched in the clock's space instead
    "a smooth function of the error, with all three": ("filter.schedule=smooth",),
    "a constant gain, with the last two": ("filter.schedule=constant",),
}
"""Variants that are searched like the observer, to see what explains its success, by settings."""
PAGE = "docs/observer.md"


def drawn(experiment: config.Experiment, start: str, keys: Array) -> ScenarioBatch:
    """Scenarios with one kind of start, for the experiment's own filter."""
    changed = config.override(experiment, STARTS[start])
    return scenario_batch(changed, keys, filter_of(experiment))


def joined(batches: Iterable[ScenarioBatch]) -> ScenarioBatch:
    """One batch of all, with a start time for each scenario's estimate."""
    each_start = [
        one._replace(begin=np.zeros(len(one.bias), one.dtype)) if one.begin is None else one
        for one in batches
    ]
    names = ("samples", "initial", "bias", "vector_bias", "begin")
    together = {
        name: jax.tree.map(
            lambda *leaves: np.concatenate(leaves), *(getattr(one, name) for one in each_start)
        )
        for name in names
    }
    return each_start[0]._replace(**together)


def searched(experiment: config.Experiment, by_clock: bool = False) -> tuple[Candidate, float]:
    """The best candidate of the search on all three starts, and its training cost.

    Args:
        experiment: The experiment that is searched.
        by_clock: Whether a gain at knots of the time takes the place of its schedule.
    """
    run = experiment.run
    problem = tuning_problem(experiment.replace(**{"run.held_out_scenarios": 1}))
    if by_clock:
        space = search_space(experiment, schedule_space("open loop", experiment))
        problem = problem._replace(space=space)
    keys = training_keys(run.seed, TRAINED * EACH)
    each = [keys[first : first + EACH] for first in range(0, len(keys), EACH)]
    batches = [drawn(experiment, *pair) for pair in zip(STARTS, each, strict=False)]
    found = run_search(problem._replace(training=joined(batches))).search
    return problem.space.candidate(found.best_position), float(found.best_cost)


def judged(experiment: config.Experiment, candidate: Candidate, keys: Array) -> list[np.ndarray]:
    """Costs (scenarios,) from each kind of start."""
    one = jax.tree.map(lambda leaf: leaf[None], candidate)
    return [
        np.asarray(costs_by_scenario(one, drawn(experiment, start, keys)))[:, 0] for start in STARTS
    ]


def say(each: list[np.ndarray]) -> None:
    """Print mean cost, 99th percentile and worst for each kind of start."""
    for start, costs in zip(STARTS, each, strict=True):
        ends = f"{np.quantile(costs, 0.99):.1f} {costs.max():.1f}"
        print(f"{start}: {costs.mean():.2f} {ends}", flush=True)


def for_seed(experiment: config.Experiment, seed: int) -> config.Experiment:
    """The experiment as it is searched here with a seed."""
    return experiment.replace(**{"run.seed": seed, "run.training_scenarios": TRAINED * EACH})


def rivals(experiment: config.Experiment, seeds: int, keys: Array) -> str:
    """A table of the mean costs of all rivals, by the seeds of their searches."""
    lines = [
        f"| searched | training | {' | '.join(STARTS)} |",
        "| --- |" + " --- |" * (1 + len(STARTS)),
    ]
    for name, changes in RIVALS.items():
        changed = config.override(experiment, changes)
        rows = []
        for seed in range(seeds):
            one = for_seed(changed, seed)
            found, training = searched(one, by_clock=name == CLOCK)
            rows.append([training, *(costs.mean() for costs in judged(one, found, keys))])
        cells = [
            ", ".join(f"{value:.1f}" for value in column) for column in zip(*rows, strict=True)
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


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
    which.add_argument("--rivals", type=int, metavar="SEEDS", help="search all rivals")
    parser.add_argument("--scenarios", type=int, default=1000, help="how many held-out ones")
    parser.add_argument("--config", default=FILE, help="another observer to judge, or to search")
    parser.add_argument("--write", action="store_true", help=f"put the rivals into {PAGE}")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    experiment = config.load(options.config)
    validation = scenario_keys(keys_of(VALIDATION_SEED).validation, VALIDATION)
    if options.rivals:
        table = rivals(experiment, options.rivals, validation)
        if options.write:
            write_block("rivals", table, PAGE)
    elif options.held_out is not None:
        found = candidate_of(configured_filter(experiment), experiment)
        say(judged(experiment, found, held_out_keys(0, options.scenarios, options.held_out)))
    else:
        experiment = for_seed(experiment, options.search)
        found, training = searched(experiment)
        print(f"training {training:.2f}", flush=True)
        say(judged(experiment, found, validation))
        print(tuned_table(found, experiment))


if __name__ == "__main__":
    main()
