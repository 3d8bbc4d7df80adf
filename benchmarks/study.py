"""How the default observer was chosen: one change at a time, judged on validation.

Each variant is tuned on its training scenarios and judged on validation scenarios, which have other
keys than the training and held-out scenarios; the latter are not used here. Two variants keep the
filter and change its schedule: the best time switch and the best constant gain, searched with the
same optimiser, budget and other tuned numbers.

    python benchmarks/study.py [--seeds 3] [--write]
"""

import argparse
import warnings

import jax
import numpy as np
from readme import write_block
from tqdm import tqdm

import posegsa
from posegsa import config
from posegsa.judging.baselines import search_baseline
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import keys, scenario_keys
from posegsa.search.population import ScenarioBatch, costs_by_scenario
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.run_search import run_search

VALIDATION_SCENARIOS = 256
ALSO = [one.key for one in config.Experiment().parameters.also]
_RATE = {"key": "gain.rate_scale", "lower": 0.01, "upper": 1000.0, "scale": "logarithmic"}
_OF_VECTORS = (
    {"key": "scenario.vectors.0.weight", "lower": 0.2, "upper": 2.0, "scale": "logarithmic"},
    {"key": "filter.cross_vector_weight", "lower": 0.003, "upper": 2.0, "scale": "logarithmic"},
)


def without(*keys: str) -> str:
    """A setting: the numbers tuned in addition to k1 to k22, without some keys."""
    return tuned_too(key for key in ALSO if key not in keys)


def tuned_too(keys, *more: dict) -> str:
    """A setting: the numbers tuned in addition to k1 to k22."""
    known = {one.key: one.model_dump() for one in config.Experiment().parameters.also}
    tables = [known[key] for key in keys] + list(more)
    rows = (
        ", ".join(f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in t.items())
        for t in tables
    )
    return f"parameters.also=[{', '.join('{ ' + row + ' }' for row in rows)}]"


VARIANTS: dict[str, tuple[str, ...]] = {
    "the defaults": (),
    "vectors' biases ignored": ("filter.vector_bias=off", without("filter.vector_bias_gain")),
    "gamma fixed": ("filter.gamma_law=fixed",),
    "gamma linear in K": ("filter.gamma_law=linear",),
    "gain of the vectors' biases fixed": ("filter.vector_bias_law=fixed",),
    "nothing tuned beside k1 to k22": ("parameters.also=[]",),
    "unit of length not tuned": (without("filter.length"),),
    "weight of the landmarks not tuned": (without("scenario.landmarks.0.weight"),),
    "weights of the vectors tuned too": (tuned_too(ALSO, *_OF_VECTORS),),
    "no rate input": ("gain.rate_scale=0.0",),
    "rate per second, scale tuned": ("gain.rate=per_second", tuned_too(ALSO, _RATE)),
    "gravitational search, G0 1": ("search.optimiser=gsa", "search.g0=1.0"),
}
SCHEDULES = {"time switch": "switch", "constant gain": "constant"}
"""Schedules without feedback in that filter, by the kind of baseline."""


def mean_cost(candidate: Candidate, scenarios: ScenarioBatch) -> float:
    """Mean cost of one candidate."""
    return float(np.mean(costs_by_scenario(jax.tree.map(lambda a: a[None], candidate), scenarios)))


def judge(problem: TuningProblem, candidate: Candidate) -> tuple[float, float]:
    """Training and validation cost of a candidate."""
    experiment = problem.experiment
    chosen = scenario_keys(keys(experiment.run.seed).validation, VALIDATION_SCENARIOS)
    validation = scenario_batch(experiment, chosen)
    return mean_cost(candidate, problem.training), mean_cost(candidate, validation)


def tuned(problem: TuningProblem) -> Candidate:
    """The best candidate of a problem's own search."""
    return problem.space.candidate(run_search(problem).search.best_position)


def table(seeds: int) -> str:
    """The study as a Markdown table."""
    lines = ["| changed | training | validation | of each seed |", "| --- | --- | --- | --- |"]
    for name in tqdm([*VARIANTS, *SCHEDULES], desc="variants"):
        found = []
        for seed in range(seeds):
            settings = [*VARIANTS.get(name, ()), f"run.seed={seed}", "run.held_out_scenarios=1"]
            problem = tuning_problem(config.override(config.Experiment(), settings))
            kind = SCHEDULES.get(name)
            best = tuned(problem) if kind is None else search_baseline(problem, kind)
            found.append(judge(problem, best))
        training, validation = np.mean(found, axis=0)
        each = ", ".join(f"{cost:.1f}" for _, cost in found)
        lines.append(f"| {name} | {training:.2f} | {validation:.2f} | {each} |")
        print(lines[-1], flush=True)
    lines += [
        "",
        f"Means over {seeds} seeds of scenarios and search, {VALIDATION_SCENARIOS} validation "
        "scenarios each; held-out ones were not read. Made by "
        f"`python benchmarks/study.py --seeds {seeds} --write`.",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Study behind configs/observer.toml.")
    parser.add_argument("--seeds", type=int, default=3, help="searches for each variant")
    parser.add_argument("--write", action="store_true", help="write the table into docs/")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    text = table(options.seeds)
    if options.write:
        write_block("study", text, "docs/observer.md")


if __name__ == "__main__":
    main()
